"""Parameters of sensor disk, noise and digitizer."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Gt, Le

from hardware_drivers.bounds import bounded, check_field_relation


@bounded
class NoiseParameters:
    """Noise at the digitizer's input: white up to half the sampling rate, and a slow part."""

    enabled: bool = True
    """Off: counts are the rounded signal itself."""
    rms_v: Annotated[float, Ge(0.0), Le(10.0)] = 0.025
    """RMS of the white part (assumption: 40 dB below an incident wave of 2.5 V)."""
    slow_rms_v: Annotated[float, Ge(0.0), Le(10.0)] = 0.015
    """RMS of the slow part: vibration of chain and cable, 0.6 % of the incident wave (assumption)."""
    slow_bandwidth_hz: Annotated[float, Gt(0.0), Le(1e9)] = 20e3
    """The slow part is even from one cycle a record up to this frequency (assumption)."""


@bounded
class SensorParameters:
    """Sensor: a PZT disk that turns the chain's dynamic force into volts.

    It does not see the static preload.
    """

    sensitivity_v_per_n: Annotated[float, Gt(0.0), Le(100.0)] = 0.0192
    """Sensitivity without tilt (assumption: at the mean tilt 150 N fill half the range)."""
    tilt_loss_per_rad: Annotated[float, Ge(0.0), Le(50.0)] = 8.5
    """Relative loss of sensitivity a radian of tilt: the disk is pressed on one side (assumption)."""


@bounded
class AdcParameters:
    """Digitizer of the solitary-wave records, modelled on a 16-bit 14 MS/s PXI board."""

    sample_rate_hz: Annotated[float, Gt(0.0), Le(1e9)] = 10e6
    """Sampling rate (paper: 10 MHz)."""
    range_v: Annotated[float, Gt(0.0), Le(1000.0)] = 5.0
    """Input range -range_v .. +range_v (one of the usual four: 1, 2, 5, 10 V)."""
    resolution_bits: Annotated[int, Ge(8), Le(24)] = 16
    """Resolution; up to 16 bits give int16 records, more give int32."""
    over_range_fraction: Annotated[float, Ge(0.0), Le(0.1)] = 0.02
    """The codes reach this far beyond the range, as boards do to keep both ends usable (2 %)."""
    offset_v: Annotated[float, Ge(-1.0), Le(1.0)] = 1.2e-3
    """Constant term of the board's scaling polynomial (assumption)."""
    gain_error_fraction: Annotated[float, Ge(-0.1), Le(0.1)] = 8e-4
    """Departure of its linear term from the ideal one (assumption)."""
    quadratic_fraction: Annotated[float, Ge(-0.01), Le(0.01)] = 3e-5
    """Its quadratic term at the last code, as a fraction of the range (assumption)."""
    cubic_fraction: Annotated[float, Ge(-0.01), Le(0.01)] = -2e-5
    """Its cubic term at the last code, as a fraction of the range (assumption)."""
    record_samples: Annotated[int, Ge(16), Le(100_000_000)] = 13_600
    """Samples of a record: 0.1 ms before the trigger and 1.26 ms after it, so 1.2 ms after the peak."""
    pretrigger_samples: Annotated[int, Ge(2), Le(100_000_000)] = 1_000
    """Samples before the trigger: 100 us, of which 60 us are quiet."""
    trigger_level_v: Annotated[float, Gt(0.0), Le(1000.0)] = 0.25
    """Rising edge that triggers: a tenth of the incident wave, ten times the noise."""

    def __post_init__(self) -> None:
        """Raise ValueError unless the pre-trigger is within the record and the level within the range."""
        check_field_relation(self, "pretrigger_samples", "less than", "record_samples")
        check_field_relation(self, "trigger_level_v", "below", "range_v", " V")
