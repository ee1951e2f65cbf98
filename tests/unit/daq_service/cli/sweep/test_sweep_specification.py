"""Sweep specifications: every text is a list of values or is rejected with a remedy."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from daq_service.cli.sweep.specification import parse_axis, read_sweep_file
from daq_service.errors import UsageError

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("chain.drop_height_m=0.003:0.008:6", (0.003, 0.004, 0.005, 0.006, 0.007, 0.008)),
        ("plate.thickness_m=log:1e-3:1e-1:3", (1e-3, 1e-2, 1e-1)),
        ("chain.sensor=sphere,disk", ("sphere", "disk")),
        ("chain.spheres_below = 2, 4", (2, 4)),
        ("corrosion.depth_fraction=0:0.4:3,.6", (0.0, 0.2, 0.4, 0.6)),
        ("corrosion.depth_fraction=0:0.8:9", (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)),
        ("a.b=5:5:1", (5.0,)),
        ("a.b=null,true", (None, True)),
        ('a.b=[1, 2],[3],"x,y"', ([1, 2], [3], "x,y")),
        ('a.b={"size_m": 0.01, "x": [1, 2]},null', ({"size_m": 0.01, "x": [1, 2]}, None)),
    ],
)
def test_an_axis_is_read_as_written(text, values):
    axis = parse_axis(text)
    assert axis.key == text.partition("=")[0].strip()
    assert axis.values == values  # to the last bit: ranges are rounded to 15 digits


@given(st.lists(NUMBERS, min_size=1, max_size=20))
def test_listed_numbers_keep_every_bit(numbers):
    axis = parse_axis("chain.mass_kg=" + ",".join(repr(number) for number in numbers))
    assert [float(value).hex() for value in axis.values] == [number.hex() for number in numbers]


@given(st.floats(-1e300, 1e300), st.floats(-1e300, 1e300), st.integers(2, 200))
def test_a_range_has_its_ends_its_count_and_even_steps(first, last, count):
    values = np.array(parse_axis(f"a.b={first!r}:{last!r}:{count}").values)
    assert len(values) == count
    assert (values[0], values[-1]) == (first, last)
    # Two values of 15 digits each, half of 1e-14 of the larger end at the most, and rounding:
    # next to zero each value and the step are whole numbers of 5e-324, up to half of it off; the last step
    # makes up for all before it.
    rounding = 1.1e-14 * max(abs(first), abs(last)) + (2 + count / 2) * 5e-324
    assert np.allclose(np.diff(values), (last - first) / (count - 1), rtol=0.0, atol=rounding)


@given(st.floats(1e-200, 1e200), st.floats(1e-200, 1e200), st.integers(2, 200))
def test_a_log_range_has_its_ends_and_a_constant_ratio(first, last, count):
    assume(first != last)
    values = np.array(parse_axis(f"a.b=log:{first!r}:{last!r}:{count}").values)
    assert (values[0], values[-1]) == (first, last)
    # The logarithm itself is known to 1e-16 of its size, up to 461.
    step = (np.log(last) - np.log(first)) / (count - 1)
    assert np.allclose(np.diff(np.log(values)), step, rtol=1e-9, atol=2e-13)


@given(st.text() | st.from_regex(r"[a-z.]*=[log:0-9e.,\[\]\"-]*", fullmatch=True))
def test_any_text_is_read_or_refused_with_the_text_itself(text):
    refusal = ""
    try:
        axis = parse_axis(text)
    except UsageError as error:
        refusal = str(error)
    assert repr(text) in refusal if refusal else axis.key and axis.values


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("chain.mass_kg", "KEY=first:last:count"),
        ("=1,2", "KEY=first:last:count"),
        ("a.b=", "KEY=first:last:count"),
        ("a.b=1,,2", "is empty"),
        ("a.b=0:1", "is no range"),
        ("a.b=0:1:x", "is no range"),
        ("a.b=0:1:2:3", "is no range"),
        ("a.b=lin:0:1:2", "is no range"),
        ("a.b=0:1:0", "at least 1"),
        ("a.b=0:1:1", "its ends differ"),
        ("a.b=0:nan:3", "not finite"),
        ("a.b=log:0:1:3", "greater than 0"),
        ("a.b=-1.7e308:1.7e308:3", "wider than"),
        ("a.b=0:1:200001", "coarser"),
        ("a.b=0:1:150000,2:3:150000", "coarser"),
    ],
)
def test_an_impossible_specification_is_rejected_with_a_remedy(text, message):
    with pytest.raises(UsageError, match=message):
        parse_axis(text)


def test_a_sweep_file_has_one_axis_per_column(tmp_path):
    path = tmp_path / "shots.csv"
    path.write_bytes(b'\xef\xbb\xbfchain.sensor,chain.drop_height_m\r\ndisk,0.005\r\nsphere,"3e-3"\r\n\r\n')
    sensor, height = read_sweep_file(path)
    assert (sensor.key, sensor.values) == ("chain.sensor", ("disk", "sphere"))
    assert (height.key, height.values) == ("chain.drop_height_m", (0.005, 0.003))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "holds no shots"),
        (b"chain.mass_kg\n", "holds no shots"),
        (b"a,b\n1,2\n1\n", "shot 2 has 1 cells, the header 2"),
        (b"a,b\n1, \n", "shot 1 has an empty cell"),
        (b"a\n\xff\n", "UTF-8"),
        (b'a\n"1\n', "not a CSV"),
    ],
)
def test_an_invalid_sweep_file_is_rejected(content, message, tmp_path):
    path = tmp_path / "shots.csv"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=message):
        read_sweep_file(path)
    with pytest.raises(UsageError, match="cannot read"):
        read_sweep_file(tmp_path / "absent.csv")
