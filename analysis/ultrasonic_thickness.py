"""Travel time of a pulse-echo record and the wall thickness from it (paper, section 4, eq. 17).

The first back-wall echo of the first record is the reference: its absolute travel time is the peak
of its envelope. In later records it is found by correlation with that echo, coarse by the envelope of the
correlation and fine by its carrier: the envelope cannot jump by a period, the carrier has the precision.
A wall that thins from 6.35 to 4.2 mm moves the echo by .73 us, several periods of 5 MHz.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fft, ifft, next_fast_len

from analysis.errors import EchoNotFoundError, InvalidInputError, RecordError
from analysis.pulses import parabola_peak
from analysis.record_reduction import FloatArray
from hardware_drivers.measurement import Waveform

FIRST_ECHO_FRACTION = 0.5
"""The first maximum of the envelope above this part of the gate's largest is the first echo; each later
echo has lost more energy, and the front wall's is far smaller."""
TEMPLATE_FRACTION = 0.05
"""The template reaches to where the reference echo's envelope has fallen to this part."""
GOOD_CORRELATION = 0.9
SUSPECT_CORRELATION = 0.6
"""Below, the echo no longer looks like the reference's and the travel time is bad."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EchoReference:
    """The first back-wall echo of the reference record.

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
    thinnest_fraction, thickest_fraction
        Gate for later echoes, in parts of UT_0 - D.
    """

    travel_time_s: float
    template_v: FloatArray
    template_peak_samples: float
    sample_rate_hz: float
    delay_s: float
    thinnest_fraction: float
    thickest_fraction: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TravelTime:
    """Travel time of one record.

    Attributes
    ----------
    travel_time_s
        UT, NaN if no echo was found.
    correlation_coefficient
        Of the echo with the reference's, -1..1, NaN if none was found.
    quality
        ``good``, ``suspect`` or ``bad``.
    reason
        Why it is not good, empty if it is.
    """

    travel_time_s: float
    correlation_coefficient: float
    quality: str
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Thickness:
    """Remaining thickness and its loss, NaN if the travel time is."""

    thickness_m: float
    thickness_loss_m: float


def reference_echo(
    waveform: Waveform,
    *,
    delay_s: float,
    initial_thickness_m: float,
    velocity_m_per_s: float = 5900.0,
    tolerance_fraction: float = 0.25,
    thinnest_fraction: float = 0.1,
    thickest_fraction: float = 1.15,
) -> EchoReference:
    """Take the first back-wall echo as the reference.

    It is the highest envelope peak within ``tolerance_fraction`` of the expected round trip around the
    expected time ``D + 2 th_0 / c``.

    Parameters
    ----------
    waveform
        Record of the pristine wall; its trigger is the firing pulse.
    delay_s
        D, to the envelope's peak of the front-wall echo.
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
    _check_reference(
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
    volts = _centred(waveform)
    first = zero + math.floor((expected_s - tolerance_fraction * round_trip_s) * rate_hz)
    last = zero + math.ceil((expected_s + tolerance_fraction * round_trip_s) * rate_hz)
    if last + 1 >= volts.size or first < 1:
        raise RecordError(
            f"the first echo is expected at {expected_s * 1e6:.2f} us, the record reaches to "
            f"{(volts.size - zero) / rate_hz * 1e6:.2f} us: record longer or correct delay_s and thickness"
        )
    envelope = np.abs(_analytic(volts))
    peak = first + int(np.argmax(envelope[first : last + 1]))
    # Median of a Rayleigh-distributed envelope is 1.18 noise rms; echoes fill little of the record.
    noise_v = float(np.median(envelope)) / 1.18
    if not first < peak < last or envelope[peak] < 6.0 * noise_v or envelope[peak] <= 0.0:
        raise EchoNotFoundError(
            f"no back-wall echo stands out within {tolerance_fraction:.0%} of the round trip around "
            f"{expected_s * 1e6:.2f} us (largest {envelope[peak]:.3g} V, noise {noise_v:.3g} V): check the "
            "coupling, gain, delay_s, initial_thickness_m and velocity_m_per_s"
        )
    place = _envelope_peak(envelope, peak)
    low, high = _echo_extent(envelope, peak, TEMPLATE_FRACTION)
    template = np.array(volts[low : high + 1], copy=True)
    template.flags.writeable = False
    return EchoReference(
        travel_time_s=(place - zero) / rate_hz,
        template_v=template,
        template_peak_samples=place - low,
        sample_rate_hz=rate_hz,
        delay_s=delay_s,
        thinnest_fraction=thinnest_fraction,
        thickest_fraction=thickest_fraction,
    )


def travel_time(waveform: Waveform, reference: EchoReference) -> TravelTime:
    """Travel time of the first back-wall echo of a record, by correlation with the reference echo.

    The complex correlation with the reference's analytic signal gives envelope and carrier in one. The
    first envelope maximum in the gate above half of the gate's largest is the first echo; the carrier
    maximum nearest to it, refined by a parabola, is the travel time. Where a neighbouring carrier maximum is
    higher, or the nearest one lies more than a quarter period from the envelope's, a slip by one period is
    possible and the result is suspect.

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
    volts = _centred(waveform)
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
    correlation = _complex_correlation(volts, reference.template_v)
    coarse = _first_envelope_maximum(np.abs(correlation), first, last)
    if coarse is None:
        return TravelTime(
            travel_time_s=math.nan,
            correlation_coefficient=math.nan,
            quality="bad",
            reason="no echo in the gate",
        )
    carrier = np.ascontiguousarray(correlation.real)
    lag, slipped = _nearest_carrier_maximum(carrier, coarse)
    fine = lag + parabola_peak(*(float(v) for v in carrier[lag - 1 : lag + 2]))
    coefficient = _coefficient(volts[lag : lag + reference.template_v.size], reference.template_v)
    quality, reason = _quality(coefficient, slipped)
    return TravelTime(
        travel_time_s=(fine - offset) / rate_hz,
        correlation_coefficient=coefficient,
        quality=quality,
        reason=reason,
    )


def thickness(
    travel_time_s: float, reference_travel_time_s: float, delay_s: float, initial_thickness_m: float
) -> Thickness:
    """Remaining thickness: th_0 - (UT_0 - UT) / (UT_0 - D) th_0 (paper, eq. 17).

    Parameters
    ----------
    travel_time_s, reference_travel_time_s, delay_s
        UT, UT_0 and D.
    initial_thickness_m
        th_0.

    Raises
    ------
    InvalidInputError
        UT_0 not above D, or th_0 not positive.
    """
    if not reference_travel_time_s > delay_s:
        raise InvalidInputError(
            f"reference_travel_time_s is {reference_travel_time_s} s; it must exceed delay_s = {delay_s} s"
        )
    if not initial_thickness_m > 0.0:
        raise InvalidInputError(f"initial_thickness_m is {initial_thickness_m} m; it must be positive")
    span_s = reference_travel_time_s - delay_s
    loss = (reference_travel_time_s - travel_time_s) / span_s * initial_thickness_m
    return Thickness(thickness_m=initial_thickness_m - loss, thickness_loss_m=loss)


def _check_reference(
    delay_s: float,
    initial_thickness_m: float,
    velocity_m_per_s: float,
    tolerance_fraction: float,
    thinnest_fraction: float,
    thickest_fraction: float,
) -> None:
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


def _centred(waveform: Waveform) -> FloatArray:
    volts = waveform.volts()
    return np.asarray(volts - np.median(volts), dtype=np.float64)


def _analytic(values: FloatArray) -> NDArray[np.complex128]:
    """Analytic signal: negative frequencies removed, positive doubled; its modulus is the envelope."""
    n = next_fast_len(values.size)
    return np.asarray(ifft(_one_sided(fft(values, n))))[: values.size]


def _one_sided(spectrum: NDArray[np.complex128]) -> NDArray[np.complex128]:
    half = spectrum.size // 2
    out = np.zeros_like(spectrum)
    out[0] = spectrum[0]
    out[1 : (spectrum.size + 1) // 2] = 2.0 * spectrum[1 : (spectrum.size + 1) // 2]
    if spectrum.size % 2 == 0:
        out[half] = spectrum[half]
    return out


def _complex_correlation(values: FloatArray, template: FloatArray) -> NDArray[np.complex128]:
    """Correlation at lags 0..n-1; its real part is the plain one, its modulus the envelope."""
    n = next_fast_len(values.size + template.size)
    product = fft(values, n) * np.conj(fft(template, n))
    return np.asarray(ifft(_one_sided(product)))[: values.size]


def _envelope_peak(envelope: FloatArray, peak: int) -> float:
    """Peak of the envelope: vertex of the parabola through its logarithm above half height.

    Exact for a Gaussian envelope. Three samples around the peak would be thirty times noisier.
    """
    low, high = _echo_extent(envelope, peak, 0.5)
    if high - low < 3:
        return peak + parabola_peak(*(float(v) for v in envelope[peak - 1 : peak + 2]))
    x = np.arange(low, high + 1) - peak
    square, linear, _ = np.linalg.lstsq(np.vander(x / (high - low), 3), np.log(envelope[low : high + 1]))[0]
    vertex = -0.5 * linear / square * (high - low)
    return float(np.clip(peak + vertex, low, high))


def _echo_extent(envelope: FloatArray, peak: int, fraction: float) -> tuple[int, int]:
    """First and last sample around ``peak`` where the envelope stays above a fraction of it."""
    low_enough = np.flatnonzero(envelope < fraction * envelope[peak])
    before, after = low_enough[low_enough < peak], low_enough[low_enough > peak]
    first = int(before[-1]) + 1 if before.size else 0
    last = int(after[0]) - 1 if after.size else envelope.size - 1
    return first, last


def _first_envelope_maximum(envelope: FloatArray, first: int, last: int) -> int | None:
    gate = envelope[first - 1 : last + 2]
    inner = gate[1:-1]
    floor = FIRST_ECHO_FRACTION * float(inner.max())
    found = np.flatnonzero((inner > gate[:-2]) & (inner >= gate[2:]) & (inner >= floor) & (inner > 0.0))
    return first + int(found[0]) if found.size else None


def _nearest_carrier_maximum(carrier: FloatArray, coarse: int) -> tuple[int, bool]:
    """Lag of the carrier maximum nearest to ``coarse``, and whether it may be the wrong one.

    It may be if a neighbour is higher, or if it lies more than a quarter period from ``coarse``: the
    echo's shape has changed then.
    """
    maxima = np.flatnonzero((carrier[1:-1] > carrier[:-2]) & (carrier[1:-1] >= carrier[2:])) + 1
    k = int(np.argmin(np.abs(maxima - coarse)))
    neighbours = maxima[max(0, k - 1) : k + 2]
    period = float(np.diff(neighbours).mean()) if neighbours.size > 1 else math.inf
    doubtful = carrier[neighbours].max() > carrier[maxima[k]] or abs(maxima[k] - coarse) > 0.25 * period
    return int(maxima[k]), bool(doubtful)


def _coefficient(segment: FloatArray, template: FloatArray) -> float:
    norm = math.sqrt(float(segment @ segment) * float(template @ template))
    return float(segment @ template) / norm if norm > 0.0 else math.nan


def _quality(coefficient: float, slipped: bool) -> tuple[str, str]:
    if not coefficient >= SUSPECT_CORRELATION:
        return "bad", f"correlation {coefficient:.2f} below {SUSPECT_CORRELATION}"
    reasons = []
    if coefficient < GOOD_CORRELATION:
        reasons.append(f"correlation {coefficient:.2f} below {GOOD_CORRELATION}")
    if slipped:
        reasons.append("a slip by one carrier period is possible")
    return ("suspect" if reasons else "good"), "; ".join(reasons)
