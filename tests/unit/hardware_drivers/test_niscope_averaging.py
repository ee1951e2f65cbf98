"""Averages are exact sums, and what single records showed is not lost in them."""

import math

import numpy as np
import pytest

from hardware_drivers.errors import ConfigurationError, ConnectionLostError
from hardware_drivers.niscope.averaging import Codes, compute_code_scale, require_32_bit_sum, sum_records

PADDED_14_BITS = Codes(width_bits=16, step=4)
GAIN_V = 2.04 / 65_536  # +-1 V with 2 % over-range on a 16-bit scale


def averaged(records, **changes):
    given = {
        "gain_v": GAIN_V,
        "offset_v": 1e-3,
        "codes": PADDED_14_BITS,
        "range_v": 1.0,
        "calibration_date": "2026-05-01",
    }
    return sum_records(np.asarray(records, dtype=np.int16), **(given | changes))


@pytest.fixture
def records():
    return np.random.default_rng(5).integers(-8000, 8000, size=(16, 300)).astype(np.int16) * 4


def test_counts_are_the_sum_to_the_last_one(records):
    record = averaged(records)
    assert record.counts.dtype == np.int32
    assert record.counts.tolist() == [sum(map(int, column)) for column in records.T]


def test_volts_of_the_sum_are_the_mean_of_the_records_volts(records):
    record = averaged(records)
    # 16 is a power of two: dividing the gain by it loses nothing, so the numbers are equal to the last bit.
    exact = 1e-3 + GAIN_V * records.astype(np.float64).mean(axis=0)
    np.testing.assert_array_equal(record.calibration.volts(record.counts), exact)


def test_three_records_are_averaged_to_the_last_digits_of_a_double(records):
    record = averaged(records[:3])
    exact = 1e-3 + GAIN_V * records[:3].astype(np.float64).sum(axis=0) / 3.0
    # Three roundings of numbers below 1 V, half a unit in the last place of 1 V each.
    np.testing.assert_allclose(record.calibration.volts(record.counts), exact, rtol=0.0, atol=3 * 2**-53)


@pytest.mark.parametrize(
    ("code", "clips"), [(-32_768, True), (32_764, True), (-32_764, False), (32_760, False)]
)
def test_clipping_is_seen_on_single_records(records, code, clips):
    records = np.clip(records, -32_000, 32_000)
    records[3, 7] = code
    record = averaged(records)
    assert record.clipped_records == int(clips)
    assert not any(abs(int(count)) >= 16 * 32_764 for count in record.counts)


def test_the_scale_of_the_sum_holds_the_largest_sum():
    record = averaged(np.full((16, 20), -32_768))
    low, high = record.calibration.full_scale_counts
    assert record.counts.min() == low == -16 * 32_768
    assert averaged(np.full((5, 20), 32_764)).counts.max() == 5 * 32_764 <= high


@pytest.mark.parametrize(
    ("gain_v", "bits", "expected"),
    [
        (2.04 / 65_536, 14, PADDED_14_BITS),
        (0.999 * 2.0 / 65_536, 14, PADDED_14_BITS),
        (2.04 / 16_384, 14, Codes(width_bits=14, step=1)),
        (2.0 / 256, 8, Codes(width_bits=8, step=1)),
        (2.0 / 65_536, 8, Codes(width_bits=16, step=256)),
        (2.0 / 2**32, 24, Codes(width_bits=32, step=256)),
    ],
)
def test_the_gain_shows_how_codes_are_padded(gain_v, bits, expected):
    assert compute_code_scale(gain_v=gain_v, range_v=1.0, resolution_bits=bits) == expected


@pytest.mark.parametrize("gain_v", [0.0, -1e-5, math.nan, math.inf, 1e-3, 1e-12])
def test_a_gain_that_cannot_be_this_range_and_resolution_is_refused(gain_v):
    with pytest.raises(ConnectionLostError, match="reports"):
        compute_code_scale(gain_v=gain_v, range_v=1.0, resolution_bits=14)


def test_a_sum_that_may_leave_32_bits_is_refused():
    require_32_bit_sum(65_536, 16)
    with pytest.raises(ConfigurationError, match="at most 65536"):
        require_32_bit_sum(65_537, 16)
    with pytest.raises(ConfigurationError, match="at most 256"):
        require_32_bit_sum(300, 24)
