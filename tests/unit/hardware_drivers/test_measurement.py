"""Metadata of a record."""

import numpy as np
import pytest

from hardware_drivers.measurement import Calibration, Waveform


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
