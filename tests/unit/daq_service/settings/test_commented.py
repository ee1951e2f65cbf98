"""A commented configuration has exactly the given values."""

import math
import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq_service.settings.commented import format_commented_toml, uncomment_tables
from daq_service.settings.file import find_config_file
from daq_service.settings.schema import describe_key

SCALARS = st.one_of(
    st.text(st.characters(exclude_categories=["Cs"])),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(),
    st.booleans(),
)
NAMES = st.text(st.characters(exclude_categories=["Cs"]))
VALUES = st.recursive(
    SCALARS,
    lambda below: st.lists(below, max_size=3) | st.dictionaries(NAMES, below, max_size=3),
    max_leaves=6,
)


def same(one, other):
    """Return whether values and types are equal; NaN equals itself, -0.0 is not 0.0."""
    if isinstance(one, dict) and isinstance(other, dict):
        return list(one.keys() ^ other.keys()) == [] and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return (math.isnan(one) and math.isnan(other)) or (one, math.copysign(1, one)) == (
            other,
            math.copysign(1, other),
        )
    return type(one) is type(other) and bool(one == other)


@settings(max_examples=100, deadline=None)
@given(values=st.dictionaries(NAMES, VALUES, max_size=4))
def test_a_written_configuration_reads_back_equal(values):
    assert same(tomllib.loads(format_commented_toml(values, head="Some words\n\nand more")), values)


@pytest.mark.parametrize("name", ["laboratory.toml", "simulated.toml"])
def test_the_shipped_values_are_written_and_read_again(name):
    values = tomllib.loads(uncomment_tables(find_config_file(name).read_text(encoding="utf-8")))
    text = format_commented_toml(values)
    assert same(tomllib.loads(text), values)
    assert max(map(len, text.splitlines())) <= 120


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (10e6, "10e6"),
        (200e9, "200e9"),
        (75.0, "75.0"),
        (1e-05, "1e-05"),
        (0.00635, "0.00635"),
        (True, "true"),
    ],
)
def test_numbers_are_short(value, text):
    assert f"\nread_timeout_s = {text} " in format_commented_toml({"rig": {"read_timeout_s": value}})


def test_each_key_has_its_description_once():
    places = {name: {"method": "solitary_wave", "label": name} for name in "BC"}
    text = format_commented_toml({"positions": places, "alarms": {"k": 3}})
    assert describe_key(["alarms", "k"]) == "Outliers among the last `n` assessed sets that raise the alarm."
    assert text.count(f"k = 3{'':<35}# {describe_key(['alarms', 'k'])}\n") == 1
    assert text.count("# When an outlier becomes an alarm.\n[alarms]\n") == 1
    assert text.count(describe_key(["positions", "B", "label"])) == 1
    assert '[positions.C]\nmethod = "solitary_wave"\nlabel = "C"\n' in text


def test_a_table_that_is_switched_off_is_no_value_until_it_is_switched_on():
    values = {"rig": {"kind": "simulated", "climate": {"identity": "X", "line": {"port": "COM4"}}}}
    text = format_commented_toml(values, switched_off={("rig", "climate")})
    assert tomllib.loads(text) == {"rig": {"kind": "simulated"}}
    assert tomllib.loads(uncomment_tables(text)) == values
