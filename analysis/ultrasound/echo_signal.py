"""Envelopes, correlations and arrival times of ultrasonic echoes."""

from __future__ import annotations

import math

import numpy as np
from numpy.fft import fft, ifft
from numpy.typing import NDArray

from analysis.waves.fft_length import next_fast_length
from analysis.waves.pulses import interpolate_parabola_peak
from analysis.waves.record_reduction import MAD_TO_SD, FloatArray

FACTORS = (2, 3, 5, 7, 11)
"""Lengths of complex transforms are products of these."""


def compute_analytic_signal(values: FloatArray) -> NDArray[np.complex128]:
    """Return the analytic signal of real values, shape (n,); its modulus is their envelope."""
    n = next_fast_length(values.size, FACTORS)
    return np.asarray(ifft(_one_sided_spectrum(fft(values, n))))[: values.size]


def _one_sided_spectrum(spectrum: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Convert the spectrum of real values to that of their analytic signal.

    Negative frequencies become zero, positive ones are doubled.
    """
    half = spectrum.size // 2
    out = np.zeros_like(spectrum)
    out[0] = spectrum[0]
    out[1 : (spectrum.size + 1) // 2] = 2.0 * spectrum[1 : (spectrum.size + 1) // 2]
    if spectrum.size % 2 == 0:
        out[half] = spectrum[half]
    return out


def complex_correlation(values: FloatArray, template: FloatArray) -> NDArray[np.complex128]:
    """Correlate values with a template at lags 0..n-1 samples; return the analytic signal, shape (n,).

    The real part is the plain correlation, the modulus its envelope.
    """
    n = next_fast_length(values.size + template.size, FACTORS)
    product = fft(values, n) * np.conj(fft(template, n))
    return np.asarray(ifft(_one_sided_spectrum(product)))[: values.size]


def find_envelope_peak(envelope: FloatArray, peak: int) -> float:
    """Return the peak of an envelope near sample ``peak``, as a fractional sample index.

    It is the vertex of the parabola through the envelope's logarithm above half height: exact for a Gaussian
    envelope. Three samples around the peak would be thirty times noisier.
    """
    low, high = find_echo_extent(envelope, peak, 0.5)
    if high - low < 3:
        return peak + interpolate_parabola_peak(*(float(v) for v in envelope[peak - 1 : peak + 2]))
    x = np.arange(low, high + 1) - peak
    square, linear, _ = np.linalg.lstsq(np.vander(x / (high - low), 3), np.log(envelope[low : high + 1]))[0]
    vertex = -0.5 * linear / square * (high - low)
    return float(np.clip(peak + vertex, low, high))


def find_echo_extent(envelope: FloatArray, peak: int, fraction: float) -> tuple[int, int]:
    """Return the first and last sample around ``peak`` where the envelope is at least a fraction of it.

    It ends at an end of the record if the envelope does not fall below that.
    """
    low_enough = np.flatnonzero(envelope < fraction * envelope[peak])
    before, after = low_enough[low_enough < peak], low_enough[low_enough > peak]
    first = int(before[-1]) + 1 if before.size else 0
    last = int(after[0]) - 1 if after.size else envelope.size - 1
    return first, last


def find_first_envelope_maximum(envelope: FloatArray, first: int, last: int, fraction: float) -> int | None:
    """Return the first high maximum of an envelope from sample ``first`` to ``last``; None without one.

    High is at least ``fraction`` of the highest value in the range.
    """
    gate = envelope[first - 1 : last + 2]
    inner = gate[1:-1]
    floor = fraction * float(inner.max())
    found = np.flatnonzero((inner > gate[:-2]) & (inner >= gate[2:]) & (inner >= floor) & (inner > 0.0))
    return first + int(found[0]) if found.size else None


def find_nearest_carrier_maximum(carrier: FloatArray, coarse: int) -> tuple[int, bool]:
    """Return the lag in samples of the carrier maximum nearest to ``coarse``, and whether it may be wrong.

    It may be wrong if a neighbouring maximum is higher, or if it is more than a quarter period from
    ``coarse``: the echo's shape has changed then. Raise ValueError if the carrier has no local maximum.
    """
    maxima = np.flatnonzero((carrier[1:-1] > carrier[:-2]) & (carrier[1:-1] >= carrier[2:])) + 1
    k = int(np.argmin(np.abs(maxima - coarse)))
    neighbours = maxima[max(0, k - 1) : k + 2]
    period = float(np.diff(neighbours).mean()) if neighbours.size > 1 else math.inf
    doubtful = carrier[neighbours].max() > carrier[maxima[k]] or abs(maxima[k] - coarse) > 0.25 * period
    return int(maxima[k]), bool(doubtful)


def correlation_coefficient(segment: FloatArray, template: FloatArray) -> float:
    """Return the normalized correlation of two segments, -1 to 1; NaN if one of them is all zero."""
    norm = math.sqrt(float(segment @ segment) * float(template @ template))
    return float(segment @ template) / norm if norm > 0.0 else math.nan


def compute_cramer_rao_sd_s(volts: FloatArray, echo_v: FloatArray, rate_hz: float) -> float:
    """Return the lowest possible SD of an echo's arrival time in white noise (Cramer-Rao bound), in s.

    It is the noise SD over the root of the energy of the slope of ``echo_v``, the echo of known shape. The
    noise is estimated from the median absolute deviation of differences between samples of the record
    ``volts``, which hold little of an echo.
    """
    differences = np.diff(volts)
    noise_v = MAD_TO_SD * float(np.median(np.abs(differences - np.median(differences)))) / math.sqrt(2.0)
    slope = np.gradient(echo_v) * rate_hz
    return noise_v / math.sqrt(float(slope @ slope))


def centre_of_gravity_hz(values: FloatArray, rate_hz: float) -> float:
    """Return the centre of gravity of a signal's power spectrum, in Hz; NaN for an all-zero signal."""
    power = np.abs(fft(values, 8 * values.size)[: 4 * values.size]) ** 2
    frequency_hz = np.arange(power.size) * rate_hz / (8 * values.size)
    return float(power @ frequency_hz / power.sum())
