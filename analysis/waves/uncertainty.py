"""Standard deviation of each feature from the record's own noise, propagated to first order.

With s the noise of a block mean in the band that an estimate takes in (`find_noise_colour`), n blocks in a
window:

- height and time of a top: of the least-squares quartic p(u) on n points, s^2 f^T (X^T X)^-1 f with f the
  powers of u for p, their derivatives for p', and var(u) = var(p') / p''^2;
- matched time: s^2 |k'|^2 / m''^2, k' the kernel's derivative, m'' the output's curvature at its maximum;
- time of flight by autocorrelation: s^2 (1/E'_ISW + 1/E'_PSW), the Cramer-Rao bound of a known pulse, E' the
  sum of squares of its slope; coefficient r = a / (1 + a^2): by dr/da, plus what noise adds to R(0);
- the quiet level, a median of blocks, moves heights alike, and areas n times;
- width: noise of both flanks and of the level, over their slope.

Scatter from shot to shot (strike, contact) comes on top; a set's own standard deviation holds both.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from analysis.waves.noise_colour import NoiseColour, find_noise_colour
from analysis.waves.pulses import FLANK_SMOOTHING_S, Pulse, Pulses, quartic_design_matrix
from analysis.waves.record_reduction import (
    ExtractionSettings,
    FloatArray,
    ReducedRecord,
    filter_kernel,
    round_to_odd,
)

STANDS_OUT = 20.0
"""Height over its standard deviation, below which a time's is not of first order and is not told."""
EDGE_OF_FIT = 1.875
"""Weight of the outermost of n points in the height of the quartic's middle, times n; half a flank is in."""
FLANK_SLOPE = 1.36
"""Slope at half height times width over height: between cos^4 1.47, Gaussian 1.39, sech^2 1.25."""
ENERGY, SLOPE_ENERGY, AREA = 0.751, 2.06, 1.030
"""Integrals of a pulse of height and width 1: its square, its slope's (between cos^4 2.25, Gaussian 2.09 and
sech^2 1.88), itself."""


def propagate_noise_to_features(
    record: ReducedRecord, pulses: Pulses, values: dict[str, float], settings: ExtractionSettings
) -> dict[str, float]:
    """Propagate a record's noise to the standard deviation of each available feature, by name.

    Without an incident wave, only that of ``noise_rms_v`` is returned.

    Parameters
    ----------
    values
        Features by name, without those that are not available.
    """
    isw, psw, ssw = pulses.isw, pulses.psw, pulses.ssw
    noise = find_noise_colour(record, *((math.nan, math.nan) if isw is None else (isw.time_s, isw.fwhm_s)))
    found = {"noise_rms_v": noise.rms_sd * record.noise_rms_v}
    if isw is None or "isw_time_s" not in values:
        return found
    s2, level2 = noise.slow2, noise.level2
    times, heights = {}, {}
    for name, pulse in (("isw", isw), ("psw", psw), ("ssw", ssw)):
        if pulse is not None and pulse.regular:
            times[name], heights[name] = _quartic_variances(pulse, s2, record.step_s)
            if pulse.amplitude_v > STANDS_OUT * math.sqrt(heights[name]):
                found[f"{name}_time_s"] = math.sqrt(times[name])
            found[f"{name}_amplitude_v"] = math.sqrt(heights[name] + level2)
    if "isw" in heights and isw.fwhm_s > 0.0:
        flanks = 2.0 * noise.flank2 / round_to_odd(FLANK_SMOOTHING_S / record.step_s)
        flanks -= 2.0 * EDGE_OF_FIT * s2 / isw.top_points
        slope = FLANK_SLOPE * isw.amplitude_v / isw.fwhm_s
        found["isw_fwhm_s"] = math.sqrt(flanks + heights["isw"] + level2) / slope
    if psw is None:
        return found
    ratio, isw_v = psw.amplitude_v / isw.amplitude_v, isw.amplitude_v
    found["tof_mf_s"] = math.sqrt(
        _matched_time_variance(isw, record, settings, s2) + _matched_time_variance(psw, record, settings, s2)
    )
    if "isw" in heights and "psw" in heights:
        found["tof_pp_s"] = math.sqrt(times["isw"] + times["psw"])
        of_tops = heights["psw"] + ratio**2 * heights["isw"]
        found["amplitude_ratio"] = math.sqrt(of_tops + level2 * (1.0 - ratio) ** 2) / isw_v
    n = 2.0 * settings.window_half_width_s / record.step_s
    found["psw_area_v_s"] = record.step_s * math.sqrt(n * s2 + n**2 * level2)
    area_ratio = values["psw_isw_area_ratio"]
    if math.isfinite(area_ratio) and area_ratio != 0.0:
        isw_area = values["psw_area_v_s"] / area_ratio
        of_areas = n * s2 * (1.0 + area_ratio**2) + n**2 * level2 * (1.0 - area_ratio) ** 2
        found["psw_isw_area_ratio"] = record.step_s * math.sqrt(of_areas) / abs(isw_area)
    if math.isfinite(values["tof_ac_s"]) and isw.fwhm_s > 0.0 and psw.fwhm_s > 0.0:
        slopes = [SLOPE_ENERGY * one.amplitude_v**2 * record.step_s / one.fwhm_s for one in (isw, psw)]
        found["tof_ac_s"] = record.step_s * math.sqrt(s2 * sum(1.0 / slope for slope in slopes))
        found["autocorrelation_coefficient"] = values["autocorrelation_coefficient"] * _coefficient_sd(
            record, isw, ratio, values["tof_ac_s"] + 2.0 * settings.window_half_width_s, noise
        )
    return found


def _quartic_variances(pulse: Pulse, s2: float, step_s: float) -> tuple[float, float]:
    """Return the variances of time (s^2) and height (V^2) of a pulse's quartic fit.

    ``s2`` is the noise variance of a block mean in V^2, ``step_s`` the length of a block.
    """
    u, inverse = pulse.top_place, _inverse_normal_matrix(pulse.top_points)
    powers = np.array([1.0, u, u * u, u**3, u**4])
    slopes = np.array([0.0, 1.0, 2.0 * u, 3.0 * u * u, 4.0 * u**3])
    half_s = 0.5 * (pulse.top_points - 1) * step_s
    time = s2 * float(slopes @ inverse @ slopes) * (half_s / pulse.top_curvature_v) ** 2
    return time, s2 * float(powers @ inverse @ powers)


@lru_cache(maxsize=1024)
def _inverse_normal_matrix(n: int) -> FloatArray:
    """Return (X^T X)^-1 of the quartic fit on n points, shape (5, 5).

    X is the design matrix of `quartic_design_matrix`. Cached: callers must not write to the result.
    """
    _, solver = quartic_design_matrix(n)
    return np.asarray(solver @ solver.T)


def _matched_time_variance(
    pulse: Pulse, record: ReducedRecord, settings: ExtractionSettings, s2: float
) -> float:
    """Return the variance of a matched-filter time in s^2; NaN where the filter has no maximum.

    ``s2`` is the noise variance of a block mean in V^2.
    """
    if pulse.matched_curvature_v >= 0.0:
        return math.nan
    slope2 = s2 * _kernel_slope_energy(settings.kernel_width_s / record.step_s)
    return slope2 * (record.step_s / pulse.matched_curvature_v) ** 2


@lru_cache(maxsize=64)
def _kernel_slope_energy(width_blocks: float) -> float:
    """Return the sum of squares of the matched filter's central differences, per block squared."""
    weights = np.pad(filter_kernel(width_blocks), 2)
    slopes = 0.5 * (weights[2:] - weights[:-2])
    return float(slopes @ slopes)


def _coefficient_sd(
    record: ReducedRecord, isw: Pulse, ratio: float, gate_s: float, noise: NoiseColour
) -> float:
    """Return the relative SD of the autocorrelation coefficient for a gate of ``gate_s`` seconds.

    ``ratio`` is the amplitude of the PSW over that of the ISW.
    """
    both = 1.0 + ratio**2
    energy = ENERGY * isw.amplitude_v**2 * isw.fwhm_s / record.step_s
    of_ratio = noise.slow2 / energy * ((1.0 - ratio**2) / both) ** 2 * (1.0 + 1.0 / ratio**2)
    area = AREA * isw.amplitude_v * isw.fwhm_s / record.step_s
    of_level = noise.level2 * (area * (1.0 + ratio) * (1.0 - ratio) ** 2 / (ratio * both * energy)) ** 2
    # R(0) at the full rate: the energy of n samples of noise, less n times its estimated square.
    n, total = gate_s / record.step_s * record.block_samples, energy * both * record.block_samples
    of_energy = 2.0 * n * noise.memory * noise.sample2**2
    of_estimate = (2.0 * n * noise.rms_sd * record.noise_rms_v**2) ** 2
    return math.sqrt(of_ratio + of_level + (of_energy + of_estimate) / total**2)
