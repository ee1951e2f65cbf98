"""Colour of a record's noise: variance and correlation on the time scales of a wave and of a sample.

Noise that an amplifier or a filter limits in band is like from sample to sample: differences between
neighbours see little of it, means over a pulse all of it. So its power is read

- for block means from their third differences over the whole record (`record_reduction.estimate_fine_noise`);
- below, from the quiet blocks before the wave: coefficients of cosines, a constant and the wave's exponential
  foot taken out. A band counts for itself only where its power lies above that of the wider one by more than
  chance (1 %): a band of few coefficients is uncertain by itself.

Powers are reported as the variance of one block mean of white noise with that spectral density.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from analysis.waves.record_reduction import MAD_TO_SD, FloatArray, ReducedRecord, estimate_fine_noise, median

SLOW_HZ = (20e3, 100e3)
"""Band that means over some 10 us take in; a knock or hum, slower, is no noise."""
LEAST_EXCESS = 2.5
"""By chance the median of a dozen squares of normal values is that much above its usual one in 5 %."""
RED_GROWTH = (0.7, 1.4)
"""Variance of a mean over that of half as long: 1/2 for white noise, 1 for pink noise. Noise that ends in the
band grows by more from one block to two, or by 1/2 from two to four."""
BANDS_HZ = (math.inf, 250e3, 100e3, 40e3)
"""Of block means: all, down to what a flank (5 us) and the top and the matched filter of a wave take in."""
FEWEST_COEFFICIENTS = 4
CHANCE_SD = 2.33
"""Normal quantile of 99 %."""
QUIET_BEFORE_PEAK_PER_FWHM = 1.2
FOOT_RATE = 3.5255
"""A sech^2 pulse begins as f - f^2 / 2, f = 4 exp(3.5255 t / FWHM)."""
N_LEVEL = 3
"""A constant, f and f^2."""
LONGEST_MEMORY_S, LEAST_MEMORY_SD = 10e-6, 3.0
MEDIAN_SD, MEDIAN_SQUARE = 1.166, 0.368
"""Relative standard deviation of a median of n absolute normal values, times sqrt(n); and what a correlation
rho between two of them adds, over rho^2 (second Hermite coefficient of |x| < median)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseColour:
    """Variances of the noise in V^2.

    Attributes
    ----------
    sample2, block2
        Of a sample and of a block mean.
    flank2, slow2
        Of a block mean of white noise as strong as this one below 100 kHz, and below 40 kHz.
    level2
        Of the quiet level, the median of the quiet blocks.
    memory
        Sum of the squared autocorrelations of samples over all lags; 1: white.
    rms_sd
        Relative standard deviation of `ReducedRecord.noise_rms_v`.
    """

    sample2: float
    block2: float
    flank2: float
    slow2: float
    level2: float
    memory: float
    rms_sd: float


def find_noise_colour(record: ReducedRecord, isw_time_s: float, isw_fwhm_s: float) -> NoiseColour:
    """Estimate the noise variances of a record from the quiet part before the incident wave.

    With fewer than seven quiet blocks, white noise is assumed.

    Parameters
    ----------
    isw_time_s, isw_fwhm_s
        Of the incident wave, before which the record is quiet.
    """
    fine2 = estimate_fine_noise(record.blocks_v) ** 2
    n = _count_quiet_blocks(record, isw_time_s, isw_fwhm_s)
    white2 = record.noise_rms_v**2
    if n < N_LEVEL + FEWEST_COEFFICIENTS:
        return _build_noise_colour(record, white2, [fine2] * 4, np.zeros(record.quiet_blocks), 1.0, 0.5)
    basis = _build_quiet_basis(n, round(isw_fwhm_s / record.step_s))
    found = basis.T @ record.blocks_v[:n]
    powers2, known2 = found[N_LEVEL:] ** 2, fine2
    bands = []
    for upper_hz in BANDS_HZ:
        inside = min(powers2.size, math.floor(2.0 * n * record.step_s * min(upper_hz, 1e12)))
        power2 = float(powers2[:inside].sum()) / max(1, inside)
        if inside >= FEWEST_COEFFICIENTS and power2 > chance_mean_square(inside) * known2:
            known2 = power2
        bands.append(known2)
    level = basis[:, :N_LEVEL] @ found[:N_LEVEL]
    x = record.samples_v[: n * record.block_samples] - record.offset_v
    x -= np.repeat(level, record.block_samples)
    lags = max(1, min(round(LONGEST_MEMORY_S * record.block_samples / record.step_s), x.size // 4))
    sample2, memory = float(x @ x) / (x.size - N_LEVEL), _sum_squared_autocorrelation(x, lags)
    if sample2 < chance_mean_square(x.size / memory) * white2:
        sample2 = white2
    return _build_noise_colour(
        record, sample2, bands, level, memory, _sum_squared_autocorrelation(np.diff(x), lags) - 1.0
    )


def strongest_block_noise_v(record: ReducedRecord, isw_time_s: float, isw_fwhm_s: float) -> float:
    """Return the SD in V of a block mean of white noise as strong as the record's between 20 and 100 kHz.

    Return the record's own block noise where that is not significantly exceeded. The median over the band
    ignores what is in a few coefficients only, such as a knock.
    """
    power2 = record.block_noise_v**2
    n = _count_quiet_blocks(record, isw_time_s, isw_fwhm_s)
    # The k-th cosine has the frequency k / (2 n step).
    first, last = (2.0 * n * record.step_s * hz for hz in SLOW_HZ)
    columns = slice(N_LEVEL + math.ceil(first) - 1, min(n, N_LEVEL + math.floor(last)))
    if columns.stop - columns.start >= FEWEST_COEFFICIENTS:
        cosines = _build_quiet_basis(n, round(isw_fwhm_s / record.step_s))[:, columns]
        slow2 = median((cosines.T @ record.blocks_v[:n]) ** 2) * MAD_TO_SD**2
        if slow2 > LEAST_EXCESS * power2:
            power2 = slow2
    return math.sqrt(power2)


def wandering_noise_v(record: ReducedRecord, block_noise_v: float) -> float:
    """Return the SD in V that noise gives the smoothed record around its quiet level."""
    return measure_wandering_noise(record, block_noise_v)[0]


def measure_wandering_noise(record: ReducedRecord, block_noise_v: float) -> tuple[float, float]:
    """Return the SD in V of noise in the smoothed record, and the variance of its means over that of halves.

    That of white noise with the block noise ``block_noise_v``; where means of two and of four blocks vary as
    those of pink noise do, that of noise whose octaves go on like that, at most as pink noise. The
    second is 0.5 for white noise, 1 for pink noise.
    """
    white_v = block_noise_v / math.sqrt(record.smooth_blocks)
    fine2, mid2 = (estimate_fine_noise(_average_blocks(record.blocks_v, n)) ** 2 for n in (1, 2))
    low, high = RED_GROWTH
    if not low * fine2 <= mid2 <= high * fine2:
        return white_v, 0.5
    coarse2 = estimate_fine_noise(_average_blocks(record.blocks_v, 4)) ** 2
    if not coarse2 >= low * mid2 > 0.0:
        return white_v, 0.5
    growth = min(1.0, math.sqrt(coarse2 / fine2))
    first2 = coarse2 * growth ** math.log2(record.smooth_blocks / 4)
    octaves, of_level = (
        round(math.log2(n / record.smooth_blocks)) for n in (record.blocks_v.size, record.quiet_blocks)
    )
    # Each octave has half of the variance of such means; the quiet level wanders in those longer than itself.
    powers = [growth**k for k in range(octaves)]
    return max(white_v, math.sqrt(0.5 * first2 * (sum(powers) + sum(powers[max(0, of_level) :])))), growth


def _average_blocks(blocks_v: FloatArray, n: int) -> FloatArray:
    """Return the means of each ``n`` blocks; blocks after the last full group are left out."""
    return np.asarray(np.einsum("ij->i", blocks_v[: blocks_v.size // n * n].reshape(-1, n)) / n)


def _count_quiet_blocks(record: ReducedRecord, isw_time_s: float, isw_fwhm_s: float) -> int:
    """Count the quiet blocks before the incident wave; 0 if its time is unknown."""
    before = record.index(isw_time_s - QUIET_BEFORE_PEAK_PER_FWHM * isw_fwhm_s)
    return max(0, min(record.quiet_blocks, math.floor(before))) if math.isfinite(before) else 0


def _build_noise_colour(
    record: ReducedRecord,
    sample2: float,
    bands: list[float],
    level: FloatArray,
    memory: float,
    of_differences: float,
) -> NoiseColour:
    """Build the `NoiseColour` of a record from its variances in V^2 at several time scales.

    ``bands`` are those of block means in `BANDS_HZ`, ``level`` the quiet level of each quiet block,
    ``memory`` and ``of_differences`` sums of squared autocorrelations of samples and, less 1, of their
    differences.
    """
    block2, _, flank2, slow2 = bands
    return NoiseColour(
        sample2=sample2,
        block2=block2,
        flank2=flank2,
        slow2=slow2,
        level2=_median_variance(record.quiet_blocks, level, block2, slow2),
        memory=memory,
        rms_sd=MEDIAN_SD * math.sqrt((1.0 + MEDIAN_SQUARE * of_differences) / record.samples_v.size),
    )


def _median_variance(n: int, level: FloatArray, block2: float, slow2: float) -> float:
    """Return the variance in V^2 of the median of n blocks on a level that rises to the wave's foot.

    pi s^2 / (2 n + 1.1) for white noise, n the blocks whose level is so near that noise decides their side
    (s^2 for n = 1, .45 for 3); correlated noise, sum of arcsin(rho), adds nearly what it adds to a mean.
    ``level`` is that of each block, ``block2`` the variance s^2, ``slow2`` that of slow noise.
    """
    if block2 <= 0.0:
        return 0.0
    near = n / level.size * float(np.exp(-0.5 * (level - median(level)) ** 2 / block2).sum())
    return 0.5 * math.pi * block2 / (near + 0.55) + max(0.0, slow2 - block2) / n


def chance_mean_square(n: float) -> float:
    """Return the mean square of n unit normal values exceeded by chance in 1 % (Wilson and Hilferty)."""
    third = 2.0 / (9.0 * n)
    return (1.0 - third + CHANCE_SD * math.sqrt(third)) ** 3


@lru_cache(maxsize=256)
def _build_quiet_basis(n: int, fwhm_blocks: int) -> FloatArray:
    """Build orthonormal columns that model the quiet part of a record, shape (n, n).

    They are a constant, two of the wave's foot, cosines of rising frequency; n is the number of quiet blocks,
    ``fwhm_blocks`` the ISW's width in blocks. Cached and read-only.
    """
    place = np.arange(n)
    cosines = np.cos(np.pi * np.outer(place + 0.5, np.arange(1, n - N_LEVEL + 1)) / n)
    foot = np.exp(FOOT_RATE * (place - n) / fwhm_blocks)
    basis, _ = np.linalg.qr(np.column_stack([np.ones(n), foot, foot**2, cosines]))
    basis.flags.writeable = False
    return np.asarray(basis)


def _sum_squared_autocorrelation(x: FloatArray, lags: int) -> float:
    """Return the sum of the squared autocorrelations of x over all lags, negative ones too; white noise: 1.

    Those beyond ``lags``, or within three standard errors of 0, are left out.
    """
    begin = x[: x.size - lags]
    energy = float(begin @ begin)
    if energy == 0.0:
        return 1.0
    squares = (np.correlate(x, begin, "valid")[1:] / energy) ** 2
    return 1.0 + 2.0 * float(squares[squares > LEAST_MEMORY_SD**2 / x.size].sum())
