"""Average of single records, in whole counts.

The average is kept as the exact integer sum of the records' counts; the scaling polynomial is divided by
their number instead. So nothing is rounded: every sum is a count that can be stored, and
``offset + gain / n * sum`` is the mean of the records' voltages.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware_drivers.errors import ConfigurationError, ConnectionLostError
from hardware_drivers.measurement import Calibration, Counts


@dataclass(frozen=True, slots=True, kw_only=True)
class Codes:
    """Range of an ADC's codes within the integers of the driver.

    Attributes
    ----------
    width_bits
        Width of the codes' scale: NI-SCOPE pads a 14-bit code with two low bits to 16.
    step
        Distance of two neighbouring codes: 4 for 14 bits in 16.
    """

    width_bits: int
    step: int

    @property
    def lowest(self) -> int:
        """Return the lowest code, -2**(width_bits - 1)."""
        return -(1 << (self.width_bits - 1))

    @property
    def highest(self) -> int:
        """Return the highest code, 2**(width_bits - 1) - step."""
        return (1 << (self.width_bits - 1)) - self.step


def compute_code_scale(*, gain_v: float, range_v: float, resolution_bits: int) -> Codes:
    """Compute the scale of the ADC's codes from the gain, which alone shows how the driver pads them.

    Parameters
    ----------
    gain_v
        Volts per count.
    range_v
        Input range -range_v .. +range_v.
    resolution_bits
        Bits of the ADC.

    Raises
    ------
    ConnectionLostError
        The gain does not fit this range and resolution.
    """
    if not (math.isfinite(gain_v) and gain_v > 0.0):
        raise ConnectionLostError(f"the board reports a gain of {gain_v} V a count; it must be positive")
    # Over-range and gain error move the ratio by a few percent, one bit more or less by a factor of 2.
    width_bits = round(math.log2(2.0 * range_v / gain_v))
    if not resolution_bits <= width_bits <= 32:
        raise ConnectionLostError(
            f"the board reports {gain_v} V a count over +-{range_v} V, a scale of {width_bits} bits; its "
            f"ADC has {resolution_bits}"
        )
    return Codes(width_bits=width_bits, step=1 << (width_bits - resolution_bits))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AveragedRecord:
    """Sum of the records and the properties of each.

    Attributes
    ----------
    counts
        int32, shape (record_samples,): sum over the records.
    calibration
        Turns the sum into the mean voltage.
    clipped_records
        Records with a sample at either end of the ADC's codes: in the sum this is no longer visible.
    """

    counts: Counts
    calibration: Calibration
    clipped_records: int


def sum_records(
    records: NDArray[np.int16] | NDArray[np.int32],
    *,
    gain_v: float,
    offset_v: float,
    codes: Codes,
    range_v: float,
    calibration_date: str,
) -> AveragedRecord:
    """Sum the records sample by sample without rounding, and count those with a clipped sample.

    Parameters
    ----------
    records
        Counts, shape (n_records, record_samples).
    gain_v, offset_v
        Volts of a single record: ``gain_v * count + offset_v``.
    codes
        Range of the ADC's codes; a sample at either end is clipped.
    range_v, calibration_date
        Input range -range_v .. +range_v, and ISO date, for the calibration.

    Returns
    -------
    AveragedRecord
        int32 sum, and the calibration that turns it into the mean voltage.

    Raises
    ------
    ConfigurationError
        The sum of so many records may not fit in 32 bits.
    """
    n_records = records.shape[0]
    require_32_bit_sum(n_records, codes.width_bits)
    clipped = (records.min(axis=1) <= codes.lowest) | (records.max(axis=1) >= codes.highest)
    return AveragedRecord(
        counts=records.sum(axis=0, dtype=np.int32),
        calibration=Calibration(
            coefficients_v=np.array([offset_v, gain_v / n_records]),
            resolution_bits=_count_sum_bits(n_records, codes.width_bits),
            range_v=range_v,
            date=calibration_date,
        ),
        clipped_records=int(clipped.sum()),
    )


def _count_sum_bits(n_records: int, width_bits: int) -> int:
    """Return the number of bits that a sum of ``n_records`` counts of ``width_bits`` bits may need."""
    return width_bits + math.ceil(math.log2(n_records))


def require_32_bit_sum(n_records: int, width_bits: int) -> None:
    """Raise ConfigurationError if a sum of ``n_records`` counts of ``width_bits`` bits may exceed 32 bits."""
    if _count_sum_bits(n_records, width_bits) > 32:
        raise ConfigurationError(
            f"averages is {n_records}; with counts of {width_bits} bits it must be at most "
            f"{1 << (32 - width_bits)}, or their sum leaves 32 bits"
        )
