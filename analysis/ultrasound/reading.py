"""Reading of a wall by one pulse-echo record: travel time, thickness and its interval."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from analysis.ultrasound.thickness import EchoReference, compute_thickness, thickness_interval, travel_time
from hardware_drivers.measurement import Waveform


@dataclass(frozen=True, slots=True, kw_only=True)
class EchoReading:
    """Reading of a wall; None: not available.

    Attributes
    ----------
    reason
        Why it is not ``good``.
    interval_low_m, interval_high_m
        95 % interval of the mean thickness under the beam.
    roughness_rms_m
        Of the far wall.
    """

    quality: Literal["good", "suspect", "bad"] = "bad"
    reason: str = ""
    travel_time_s: float | None = None
    thickness_m: float | None = None
    thickness_loss_m: float | None = None
    correlation_coefficient: float | None = None
    interval_low_m: float | None = None
    interval_high_m: float | None = None
    roughness_rms_m: float | None = None


def measure_wall_thickness(
    waveform: Waveform,
    reference: EchoReference,
    *,
    delay_s: float,
    initial_thickness_m: float,
    element_separation_m: float,
) -> EchoReading:
    """Measure travel time and wall thickness in one pulse-echo record (paper, eq. 17).

    A value that is not finite becomes None: without an echo the quality is bad and there is no thickness.

    Raises
    ------
    RecordError
        Another sample rate than the reference's, or a record that does not reach the gate's end.
    InvalidInputError
        The delay, initial thickness or element separation is out of range.
    """
    travel = travel_time(waveform, reference)
    wall = compute_thickness(
        travel.travel_time_s, reference.travel_time_s, delay_s, initial_thickness_m, element_separation_m
    )
    interval = thickness_interval(travel, reference, initial_thickness_m, element_separation_m)
    return EchoReading(
        quality=travel.quality,
        reason=travel.reason,
        travel_time_s=_to_finite_or_none(travel.travel_time_s),
        thickness_m=_to_finite_or_none(wall.thickness_m),
        thickness_loss_m=_to_finite_or_none(wall.thickness_loss_m),
        correlation_coefficient=_to_finite_or_none(travel.correlation_coefficient),
        interval_low_m=_to_finite_or_none(interval.low_m),
        interval_high_m=_to_finite_or_none(interval.high_m),
        roughness_rms_m=_to_finite_or_none(interval.roughness_rms_m),
    )


def _to_finite_or_none(value: float) -> float | None:
    """Return a value unchanged if it is finite, otherwise None."""
    return value if math.isfinite(value) else None
