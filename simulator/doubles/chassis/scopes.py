"""Board type of the NI-SCOPE double: its figures and its ADC.

The default follows NI's PXI-5122: two channels, 14 bits in 16, 100 MS/s, codes that reach a little beyond
the range, and a gain and an offset of its own.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le

from hardware_drivers.bounds import bounded
from hardware_drivers.measurement import Calibration

SAMPLE_BITS = 16
"""Width in which the board hands over its codes; the low bits of a 14-bit code are padding."""


@bounded
class ScopeParameters:
    """Digitizer board."""

    name: str = "PXI1Slot4"
    """Resource name under which it is found."""
    serial_number: Annotated[int, Ge(1), Le(0xFFFFFFFF)] = 0x01C5A1F0
    """What a driver finds the board by, as eight hexadecimal digits."""
    product: str = "NI PXI-5122"
    """Model it reports."""
    channels: Annotated[int, Ge(1), Le(8)] = 2
    """Number of inputs."""
    resolution_bits: Annotated[int, Ge(8), Le(SAMPLE_BITS)] = 14
    """Bits of the ADC."""
    maximum_rate_hz: Annotated[float, Gt(0.0), Le(1e10)] = 100e6
    """Its rates are this one over a whole number."""
    ranges_v: tuple[float, ...] = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
    """Its ranges -range_v .. +range_v."""
    over_range_fraction: Annotated[float, Ge(0.0), Le(0.1)] = 0.02
    """The codes reach this far beyond the range."""
    gain_error_fraction: Annotated[float, Ge(-0.1), Le(0.1)] = -6e-4
    """Departure of its gain from the ideal one."""
    offset_v: Annotated[float, Ge(-1.0), Le(1.0)] = 4e-4
    """Voltage of code 0 at no vertical offset."""
    memory_samples: Annotated[int, Ge(1024), Le(2**31)] = 16 * 2**20
    """Samples a channel that one acquisition may take."""
    calibration_date: str = "2026-05-04"
    """Date of both calibrations until it calibrates itself."""
    calibration_temperature_c: Annotated[float, Ge(-50.0), Le(150.0)] = 41.5
    """Temperature at both."""

    def calibration(self, range_v: float, vertical_offset_v: float) -> Calibration:
        """Return the scaling of unpadded codes to V in a range (-range_v to +range_v) plus an offset, V."""
        half = float(1 << (self.resolution_bits - 1))
        gain_v = range_v * (1.0 + self.over_range_fraction) / half * (1.0 + self.gain_error_fraction)
        return Calibration(
            coefficients_v=np.array([self.offset_v + vertical_offset_v, gain_v]),
            resolution_bits=self.resolution_bits,
            range_v=range_v,
        )

    @property
    def serial_text(self) -> str:
        """Return the serial number as the board reports it, eight hexadecimal digits."""
        return f"{self.serial_number:08X}"

    @property
    def padding(self) -> int:
        """Return the distance of two neighbouring codes in the driver's integers: 4 for 14 bits in 16."""
        return 1 << (SAMPLE_BITS - self.resolution_bits)

    def coerced_range_v(self, asked_v: float) -> float | None:
        """Return the smallest range (-r to +r) that includes a voltage, V; None above the largest."""
        return next((range_v for range_v in sorted(self.ranges_v) if range_v >= asked_v * (1.0 - 1e-9)), None)

    def coerced_rate_hz(self, asked_hz: float) -> float | None:
        """Return the lowest sample rate at or above the requested one, Hz; None above the highest.

        Rates are the highest one divided by a whole number. Raise ZeroDivisionError for 0.
        """
        divisor = math.floor(self.maximum_rate_hz / asked_hz * (1.0 + 1e-9))
        return self.maximum_rate_hz / divisor if divisor >= 1 else None
