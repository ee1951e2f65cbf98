"""Metadata of a record."""

import numpy as np
import pytest

from hardware_drivers.measurement import MOST_UNSCHEDULED, Calibration, SetKey, ShotKey, Waveform


def record(*codes, bits):
    return Waveform(
        counts=np.array(codes, dtype=np.int16 if bits <= 16 else np.int32),
        sample_rate_hz=10e6,
        pretrigger_samples=0,
        calibration=Calibration(
            coefficients_v=np.array([0.0, 1e-3]), resolution_bits=bits, range_v=2.0 ** (bits - 1) * 1e-3
        ),
    )


@pytest.mark.parametrize("bits", [12, 14, 16, 18])
def test_either_end_of_the_range_is_clipped_and_nothing_inside(bits):
    end = 1 << (bits - 1)
    assert record(0, end - 1, bits=bits).clipped
    assert record(0, -end, bits=bits).clipped
    # A board that clips at the same code on both sides, as 12-bit ones do at +-2047.
    assert record(0, -end + 1, bits=bits).clipped
    assert not record(0, end - 2, -end + 2, bits=bits).clipped


def test_an_empty_record_is_not_clipped():
    assert not record(bits=16).clipped


def test_the_key_of_a_set_sorts_by_time_and_has_one_text_and_number():
    keys = [SetKey(2), SetKey(12), SetKey(12, 1), SetKey(12, 2), SetKey(12, 10), SetKey(13)]
    assert sorted(set(keys)) == keys
    assert [str(key) for key in keys] == ["2", "12", "12.1", "12.2", "12.10", "13"]
    assert [SetKey.parse(str(key)) for key in keys] == keys
    assert [key.number for key in keys[1:4]] == [12, 10_000_012, 20_000_012]
    assert [SetKey.from_number(key.number) for key in keys] == keys
    assert [key.purpose for key in keys[1:3]] == ["planned", "confirmation"]
    assert SetKey(0, MOST_UNSCHEDULED).number < 2**31
    for text in ("", "12.", "1.2.3", "x"):
        with pytest.raises(ValueError, match="invalid literal"):
            SetKey.parse(text)


def test_the_key_of_a_shot_contains_that_of_its_set():
    key = ShotKey.from_set(SetKey(12, 1), "B", 3, 1)
    assert key == ShotKey(position="B", set_index=12, unscheduled_index=1, shot_index=3, attempt=1)
    assert key.set_key == SetKey(12, 1)
    with pytest.raises(ValueError, match="unscheduled_index is -1"):
        ShotKey.from_set(SetKey(12, -1), "B", 3)
