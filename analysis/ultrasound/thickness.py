"""Travel time of a pulse-echo record and the wall thickness from it (paper, section 4, eq. 17).

The first back-wall echo of the first record is the reference: its absolute travel time is the peak
of its envelope. In later records it is found by correlation with that echo, coarse by the envelope of the
correlation and fine by its carrier: the envelope cannot jump by a period, the carrier has the precision.
A wall that thins from 6.35 to 4.2 mm moves the echo by .73 us, several periods of 5 MHz.

A rough far wall sends the coherent part of an echo back weaker by exp(-2 k^2 sigma^2), k = 2 pi f / c. What
the echo has lost of the reference's amplitude is therefore read as roughness, and the thickness gets an
interval that grows with it: the rest of such an echo is a sum over facets, and its crest may lie anywhere
among them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from analysis.errors import EchoNotFoundError, InvalidInputError, RecordError
from analysis.ultrasound.echo_signal import (
    centre_of_gravity_hz,
    complex_correlation,
    compute_analytic_signal,
    compute_cramer_rao_sd_s,
    correlation_coefficient,
    find_echo_extent,
    find_envelope_peak,
    find_first_envelope_maximum,
    find_nearest_carrier_maximum,
)
from analysis.waves.pulses import interpolate_parabola_peak
from analysis.waves.record_reduction import FloatArray
from hardware_drivers.measurement import Waveform

Quality = Literal["good", "suspect", "bad"]
EXTRACTOR_VERSION = "1.1"
"""Of the travel time; changes whenever any result of any record would."""

THINNEST_FRACTION, THICKEST_FRACTION = 0.1, 1.15
"""Gate for later echoes, in parts of UT_0 - D."""
FIRST_ECHO_FRACTION = 0.5
"""The first maximum of the envelope above this part of the gate's largest is the first echo; each later
echo has lost more energy, and the front wall's is far smaller."""
TEMPLATE_FRACTION = 0.05
"""The template reaches to where the reference echo's envelope has fallen to this part."""
GOOD_CORRELATION = 0.9
SUSPECT_CORRELATION = 0.6
"""Below, the echo no longer looks like the reference's and there is no travel time. Of white noise alone,
without an echo, less than one record in a thousand comes that far."""
INTERVAL_SDS = 2.0
"""Standard deviations of the pick's noise on either side of an interval: 95 %."""
INTERVAL_PER_NEPER = 1.6
"""Half the interval of a rough wall, in units of 1 / k, for each neper that the echo is weaker than the
reference's. Found on the twin's walls: it holds the mean thickness under the beam in 95 % of the records
(``python benchmarks/echo_bias.py``)."""
INTERVAL_LEAST_M = 2e-6
"""Half the least interval: later echoes that run into the first one move a pick by up to 1.5 um at 1.5 mm."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EchoReference:
    """First back-wall echo of the reference record.

    Attributes
    ----------
    travel_time_s
        UT_0: time of the echo's envelope peak from the firing pulse.
    template_v
        The echo, shape (n_template,), read-only.
    template_peak_samples
        Place of the envelope's peak in the template (fractional).
    delay_s
        D, the delay of the dual-element probe.
    carrier_hz
        Centre of gravity of the echo's power spectrum.
    thinnest_fraction, thickest_fraction
        Gate for later echoes, in parts of UT_0 - D.
    """

    travel_time_s: float
    template_v: FloatArray
    template_peak_samples: float
    sample_rate_hz: float
    delay_s: float
    carrier_hz: float
    thinnest_fraction: float
    thickest_fraction: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TravelTime:
    """Travel time of one record.

    Attributes
    ----------
    travel_time_s
        UT, NaN where the quality is bad: a number would be made up.
    travel_time_sd_s
        What the record's white noise moves the pick by (Cramer-Rao bound of a known pulse), NaN like UT.
    amplitude_ratio
        Of the echo over the reference's, by correlation; NaN if none was found.
    correlation_coefficient
        Of the echo with the reference's, -1..1, NaN if none was found.
    quality
        ``good``, ``suspect`` or ``bad``.
    reason
        Why it is not good, empty if it is.
    """

    travel_time_s: float
    travel_time_sd_s: float
    amplitude_ratio: float
    correlation_coefficient: float
    quality: Quality
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Thickness:
    """Remaining thickness and its loss, NaN if the travel time is."""

    thickness_m: float
    thickness_loss_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ThicknessInterval:
    """95 % confidence interval of the mean thickness under the beam; NaN if there is no travel time.

    Attributes
    ----------
    low_m, high_m
        Its ends.
    roughness_rms_m
        RMS roughness of the far wall that the loss of amplitude stands for; lost coupling looks the same.
    """

    low_m: float
    high_m: float
    roughness_rms_m: float


def find_reference_echo(
    waveform: Waveform,
    *,
    delay_s: float,
    initial_thickness_m: float,
    velocity_m_per_s: float = 5900.0,
    tolerance_fraction: float = 0.25,
    thinnest_fraction: float = THINNEST_FRACTION,
    thickest_fraction: float = THICKEST_FRACTION,
) -> EchoReference:
    """Find the first back-wall echo of the pristine wall, the reference of later records.

    It is the highest envelope peak within ``tolerance_fraction`` of the expected round trip around the
    expected time ``D + 2 th_0 / c``.

    Parameters
    ----------
    waveform
        Record of the pristine wall; its trigger is the firing pulse.
    delay_s
        D, to the envelope's peak of the front-wall echo.
    initial_thickness_m
        th_0, thickness of the pristine wall.
    velocity_m_per_s
        c, longitudinal wave speed (5,900 m/s for steel); used to find the echo only.
    thinnest_fraction, thickest_fraction
        Where later records may have it, in parts of the reference's ``UT_0 - D``.

    Raises
    ------
    InvalidInputError
        A parameter is out of range.
    RecordError
        The record does not reach the expected echo.
    EchoNotFoundError
        No peak at least six times the noise.
    """
    _check_reference_parameters(
        delay_s,
        initial_thickness_m,
        velocity_m_per_s,
        tolerance_fraction,
        thinnest_fraction,
        thickest_fraction,
    )
    round_trip_s = 2.0 * initial_thickness_m / velocity_m_per_s
    expected_s = delay_s + round_trip_s
    rate_hz, zero = waveform.sample_rate_hz, waveform.pretrigger_samples
    volts = _remove_median(waveform)
    first = zero + math.floor((expected_s - tolerance_fraction * round_trip_s) * rate_hz)
    last = zero + math.ceil((expected_s + tolerance_fraction * round_trip_s) * rate_hz)
    if last + 1 >= volts.size or first < 1:
        raise RecordError(
            f"the first echo is expected at {expected_s * 1e6:.2f} us, the record reaches to "
            f"{(volts.size - zero) / rate_hz * 1e6:.2f} us: record longer or correct delay_s and thickness"
        )
    envelope = np.abs(compute_analytic_signal(volts))
    peak = first + int(np.argmax(envelope[first : last + 1]))
    # Median of a Rayleigh-distributed envelope is 1.18 noise rms; echoes fill little of the record.
    noise_v = float(np.median(envelope)) / 1.18
    if not first < peak < last or envelope[peak] < 6.0 * noise_v or envelope[peak] <= 0.0:
        raise EchoNotFoundError(
            f"no back-wall echo above the noise within {tolerance_fraction:.0%} of the round trip around "
            f"{expected_s * 1e6:.2f} us (largest {envelope[peak]:.3g} V, noise {noise_v:.3g} V): check the "
            "coupling, gain, delay_s, initial_thickness_m and velocity_m_per_s"
        )
    place = find_envelope_peak(envelope, peak)
    low, high = find_echo_extent(envelope, peak, TEMPLATE_FRACTION)
    template = np.array(volts[low : high + 1], copy=True)
    template.flags.writeable = False
    return EchoReference(
        travel_time_s=(place - zero) / rate_hz,
        template_v=template,
        template_peak_samples=place - low,
        sample_rate_hz=rate_hz,
        delay_s=delay_s,
        carrier_hz=centre_of_gravity_hz(template, rate_hz),
        thinnest_fraction=thinnest_fraction,
        thickest_fraction=thickest_fraction,
    )


def substitute_reference(
    later: EchoReference, *, travel_time_s: float, reference_travel_time_s: float
) -> EchoReference:
    """Return a reference made from the echo of a later record, for when the reference record is lost.

    Its travel times continue those of the lost reference.

    Parameters
    ----------
    later
        Taken from the later record (`find_reference_echo`).
    travel_time_s, reference_travel_time_s
        UT of the later record and UT_0, as they were read with the lost reference: the same times are read
        with the new one. Amplitudes are compared with the later echo's.
    """
    moved = (travel_time_s - later.travel_time_s) * later.sample_rate_hz
    return replace(
        later,
        travel_time_s=reference_travel_time_s,
        template_peak_samples=later.template_peak_samples + moved,
    )


def travel_time(waveform: Waveform, reference: EchoReference) -> TravelTime:
    """Measure the travel time of the first back-wall echo, by correlation with the reference echo.

    The complex correlation with the reference's analytic signal gives envelope and carrier in one. The first
    envelope maximum in the gate above half of the gate's largest is the first echo; the carrier maximum
    nearest to it, refined by a parabola, is the travel time. Where a neighbouring carrier maximum is higher,
    or the nearest one is more than a quarter period from the envelope's, a slip by one period is possible and
    the result is suspect. Without an echo in the gate or with a correlation below 0.6, the quality is bad and
    the time NaN.

    Raises
    ------
    RecordError
        Another sample rate than the reference's, or a record that does not reach the gate's end.
    """
    rate_hz, zero = waveform.sample_rate_hz, waveform.pretrigger_samples
    if rate_hz != reference.sample_rate_hz:
        raise RecordError(
            f"sample_rate_hz is {rate_hz}, the reference was taken at {reference.sample_rate_hz}: "
            "take a new reference at this rate"
        )
    volts = _remove_median(waveform)
    span_s = reference.travel_time_s - reference.delay_s
    # Correlation lag 0 puts the template's first sample on the record's first.
    offset = zero - reference.template_peak_samples
    first = math.floor((reference.delay_s + reference.thinnest_fraction * span_s) * rate_hz + offset)
    last = math.ceil((reference.delay_s + reference.thickest_fraction * span_s) * rate_hz + offset)
    if first < 1 or last + reference.template_v.size >= volts.size:
        raise RecordError(
            f"the gate for the first echo ends at {(last - offset) / rate_hz * 1e6:.2f} us, the record at "
            f"{(volts.size - zero) / rate_hz * 1e6:.2f} us: record longer"
        )
    correlation = complex_correlation(volts, reference.template_v)
    coarse = find_first_envelope_maximum(np.abs(correlation), first, last, FIRST_ECHO_FRACTION)
    if coarse is None:
        return TravelTime(
            travel_time_s=math.nan,
            travel_time_sd_s=math.nan,
            amplitude_ratio=math.nan,
            correlation_coefficient=math.nan,
            quality="bad",
            reason="no echo in the gate",
        )
    carrier = np.ascontiguousarray(correlation.real)
    lag, slipped = find_nearest_carrier_maximum(carrier, coarse)
    fine = lag + interpolate_parabola_peak(*(float(v) for v in carrier[lag - 1 : lag + 2]))
    template = reference.template_v
    segment = volts[lag : lag + template.size]
    coefficient = correlation_coefficient(segment, template)
    quality, reason = _assess_reading_quality(coefficient, slipped)
    ratio = float(segment @ template) / float(template @ template)
    found = quality != "bad"
    return TravelTime(
        travel_time_s=(fine - offset) / rate_hz if found else math.nan,
        travel_time_sd_s=compute_cramer_rao_sd_s(volts, ratio * template, rate_hz) if found else math.nan,
        amplitude_ratio=ratio,
        correlation_coefficient=coefficient,
        quality=quality,
        reason=reason,
    )


def compute_thickness(
    travel_time_s: float,
    reference_travel_time_s: float,
    delay_s: float,
    initial_thickness_m: float,
    element_separation_m: float = 0.0,
) -> Thickness:
    """Return the remaining thickness: th_0 - (UT_0 - UT) / (UT_0 - D) th_0 (paper, eq. 17).

    Equation 17 assumes a straight sound path. Between the two elements of a probe it is a V of length sqrt(4
    th^2 + s^2), and a thinned wall is read too thick; with their distance s given, that is corrected.

    Parameters
    ----------
    travel_time_s, reference_travel_time_s, delay_s
        UT, UT_0 and D.
    initial_thickness_m
        th_0.
    element_separation_m
        s; 0 is equation 17 to the letter.

    Returns
    -------
    Thickness
        NaN where the travel time is, and where it is too short for any wall at this separation.

    Raises
    ------
    InvalidInputError
        UT_0 not above D, th_0 not positive, or s negative.
    """
    if not reference_travel_time_s > delay_s:
        raise InvalidInputError(
            f"reference_travel_time_s is {reference_travel_time_s} s; it must exceed delay_s = {delay_s} s"
        )
    if not initial_thickness_m > 0.0:
        raise InvalidInputError(f"initial_thickness_m is {initial_thickness_m} m; it must be positive")
    if not element_separation_m >= 0.0:
        raise InvalidInputError(f"element_separation_m is {element_separation_m} m; it must not be negative")
    span_s = reference_travel_time_s - delay_s
    loss = (reference_travel_time_s - travel_time_s) / span_s * initial_thickness_m
    if element_separation_m > 0.0:
        initial_way_m = math.hypot(2.0 * initial_thickness_m, element_separation_m)
        way_m = (travel_time_s - delay_s) / span_s * initial_way_m
        square_m2 = way_m**2 - element_separation_m**2
        loss = initial_thickness_m - (0.5 * math.sqrt(square_m2) if square_m2 > 0.0 else math.nan)
    return Thickness(thickness_m=initial_thickness_m - loss, thickness_loss_m=loss)


def thickness_interval(
    found: TravelTime,
    reference: EchoReference,
    initial_thickness_m: float,
    element_separation_m: float = 0.0,
) -> ThicknessInterval:
    """Return the 95 % interval of the thickness of one record, for its noise and the far wall's roughness.

    Wave speed, delay and initial thickness are taken as exact, and so is the separation: what they are wrong
    by comes on top. The amplitude is compared with the reference's without regard to attenuation, which in a
    thinner wall is smaller and hides a roughness of a few hundredths of a millimetre.
    All values are NaN if there is no travel time. Raise InvalidInputError as `compute_thickness`.
    """
    wall = compute_thickness(
        found.travel_time_s,
        reference.travel_time_s,
        reference.delay_s,
        initial_thickness_m,
        element_separation_m,
    )
    way_m = math.hypot(2.0 * initial_thickness_m, element_separation_m)
    velocity_m_per_s = way_m / (reference.travel_time_s - reference.delay_s)
    wavenumber = 2.0 * math.pi * reference.carrier_hz / velocity_m_per_s
    if math.isnan(wall.thickness_m):
        return ThicknessInterval(low_m=math.nan, high_m=math.nan, roughness_rms_m=math.nan)
    lost_nepers = max(-math.log(found.amplitude_ratio), 0.0)
    # th moves by c / 2 a second on a straight way, and by more on a slant one.
    slant = math.hypot(2.0 * wall.thickness_m, element_separation_m) / (2.0 * wall.thickness_m)
    noise_m = 0.5 * velocity_m_per_s * slant * found.travel_time_sd_s
    rough_m = INTERVAL_PER_NEPER * lost_nepers / wavenumber
    half_m = INTERVAL_LEAST_M + math.hypot(INTERVAL_SDS * noise_m, rough_m)
    return ThicknessInterval(
        low_m=wall.thickness_m - half_m,
        high_m=wall.thickness_m + half_m,
        roughness_rms_m=math.sqrt(lost_nepers / 2.0) / wavenumber,
    )


def _check_reference_parameters(
    delay_s: float,
    initial_thickness_m: float,
    velocity_m_per_s: float,
    tolerance_fraction: float,
    thinnest_fraction: float,
    thickest_fraction: float,
) -> None:
    """Raise InvalidInputError for a parameter of a reference echo that is not physical, or not finite."""
    if not delay_s >= 0.0:
        raise InvalidInputError(f"delay_s is {delay_s} s; it must not be negative")
    for name, value in (
        ("initial_thickness_m", initial_thickness_m),
        ("velocity_m_per_s", velocity_m_per_s),
        ("tolerance_fraction", tolerance_fraction),
        ("thinnest_fraction", thinnest_fraction),
    ):
        if not (math.isfinite(value) and value > 0.0):
            raise InvalidInputError(f"{name} is {value}; it must be positive and finite")
    if not thinnest_fraction < 1.0 < thickest_fraction:
        raise InvalidInputError(
            f"the gate {thinnest_fraction}..{thickest_fraction} of UT_0 - D must enclose the reference at 1"
        )


def _remove_median(waveform: Waveform) -> FloatArray:
    """Return the record in volts minus its median, shape (n_samples,)."""
    volts = waveform.volts()
    return np.asarray(volts - np.median(volts), dtype=np.float64)


def _assess_reading_quality(coefficient: float, slipped: bool) -> tuple[Quality, str]:
    """Rate a reading good, suspect or bad; return the quality and the reasons (English), empty for good.

    A correlation below 0.6 is bad, below 0.9 suspect; so is a possible slip by one carrier period
    (``slipped``).
    """
    if not coefficient >= SUSPECT_CORRELATION:
        return "bad", f"correlation {coefficient:.2f} below {SUSPECT_CORRELATION}"
    reasons = []
    if coefficient < GOOD_CORRELATION:
        reasons.append(f"correlation {coefficient:.2f} below {GOOD_CORRELATION}")
    if slipped:
        reasons.append("a slip by one carrier period is possible")
    return ("suspect" if reasons else "good"), "; ".join(reasons)
