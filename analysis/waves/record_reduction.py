"""Extraction settings, and the reduction of a record to block means, quiet level, noise and matched filter.

A solitary wave of 65 us has nothing above 40 kHz, so means of about 1 us hold all of it and cost a
tenth to search. Picks are made on them by least squares or a parabola and are not bound to their grid.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np
from numpy.fft import irfft, rfft
from numpy.typing import NDArray

from analysis.errors import InvalidInputError, RecordError
from analysis.waves.fft_length import next_fast_length

FloatArray = NDArray[np.float64]

USUAL_FWHM_S = 64.7e-6
"""Width of the incident wave of the paper's chain. Every time in `analysis.waves` is that of a wave of this
width: others are extracted as if time ran at another rate (`ExtractionSettings.stretch`)."""
KERNEL_WIDTH_PER_FWHM = 2.75
"""Width of a cos^4 pulse over its full width at half maximum: pi / (2 arccos(2^-1/4)) = 2.747."""
STANDS_OUT = 6.0
"""Standard deviations of what is no noise: crests in a record of a million samples stay below 5.2."""
MAD_TO_SD = 1.4826
"""Standard deviation of a normal variable over its median absolute deviation."""
THIRD_DIFFERENCE = math.sqrt(20.0)
"""Standard deviation of a - 3 b + 3 c - d for white noise of 1."""
LEAST_EXCESS = 1.1
"""By chance the third differences of 1,300 blocks show that much more than white noise in 2 %."""
TOP_SMOOTHING_S = 11e-6
"""Moving mean that says where a pulse's top begins and ends, and finds maxima; it lowers 65 us by 1 %."""
FEWEST_BLOCKS = 16
"""In a wave's width at half height, for its least-squares fit and matched filter."""
COARSEST_MEDIAN_BIN = 16
"""In a lower bin of the noise's differences, one bin would be more than 6 % of the median."""
USUAL_MEDIAN_BIN = 54
"""Of normal noise: 64 x .6745 / .7979."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtractionSettings:
    """Search windows and limits for pulses; the defaults suit the paper's disk-sensor transducer.

    Windows count from the ISW's peak. Fractions are of the ISW's amplitude. For a wave of another width
    see `for_width`.
    """

    isw_fwhm_s: float = USUAL_FWHM_S
    """Full width at half maximum of the ISW in the frozen baseline; it sets the matched filter's width."""
    psw_earliest_s: float = 200e-6
    psw_latest_s: float = 900e-6
    """The paper saw 320-420 us; a 50.8 mm patch thinned by 85 % sends the wave back after 800 us."""
    psw_leading_fraction: float = 0.5
    """The PSW is the first wave of the window that has this part of the strongest one's height."""
    ssw_after_psw_latest_s: float = 350e-6
    window_half_width_s: float = 90e-6
    """Half-width of the area windows, and reach of the autocorrelation gate beyond ISW and PSW. The SSW comes
    later after the PSW; a hidden second strike, and its slower wave, differ by less from the PSW's time."""
    autocorrelation_search_half_width_s: float = 40e-6
    autocorrelation_triangle_s: float = 10e-6
    """Base of the triangle that smooths the autocorrelation."""
    block_s: float = 1e-6
    """Longest block mean the record is reduced to."""
    missed_below_snr: float = 3.0
    """ISW amplitude over noise rms below which there was no strike."""
    noisy_below_snr: float = 7.0
    """ISW amplitude over noise rms (7 = 17 dB) below which a shot is called noisy."""
    no_psw_below_fraction: float = 0.1
    """A reflected wave smaller than this does not exist; the smallest ratio expected is .3."""
    no_psw_below_sigmas: float = 5.0
    """Nor does one below this many standard deviations of the matched filter's noise."""
    ssw_below_fraction: float = 0.02
    double_above_fraction: float = 0.22
    """A third pulse above this is a second strike (the SSW is .08 to .19). Such a strike sends that part of
    the PSW back, too; what else comes then stays below .2 of it on the twin's plates of 6 to 25 mm."""
    stray_above_fraction: float = 0.09
    """A pulse before the PSW above this is none of the strike's (the ISW's own after-wave is .05)."""
    stray_width_ratio: float = 0.85
    """A PSW narrower than this times the ISW is none: no wall sends back a shorter push than it got."""
    highest_reflection_fraction: float = 0.6
    """The PSW counts for no more there: a second strike on top of it makes it larger."""
    second_reflection_earliest_s: float = 230e-6
    second_reflection_latest_s: float = 520e-6
    """After the PSW: what the second strike came after the first, and more since smaller waves are slower."""
    second_reflection_latest_tof_s: float = 480e-6
    """Beyond, a thinned patch itself sends waves at that time, and a second strike comes before the PSW."""
    second_strike_latest_s: float = 1.0
    """After the PSW: a later wave may be a pressed chain that opened and closes again."""
    double_above_amplitude_ratio: float = 0.97
    """No wall sends back more than a rigid one does (.92): a PSW above this is a second strike."""
    double_valley_fraction: float = 0.05
    """Two maxima count as two pulses if the record falls at least this much between them."""
    double_isw_width_ratio: float = 1.5
    """An ISW wider than this times `isw_fwhm_s` is two strikes in one."""
    spike_width_ratio: float = 0.4
    """A pulse narrower than this times `isw_fwhm_s` is an electrical spike, not a wave."""
    merged_width_ratio: float = 1.6
    """A PSW wider than this times the ISW holds more than one wave."""
    merged_distance_s: float = 120e-6
    """A second maximum this near the PSW is merged with it."""
    deepest_pull_fraction: float = 0.05
    """How far a strike lets the record fall below its level: the preload, 1 %, and slow vibration of the
    twin's chain, 3 %, at half the gain 5 %. A pressed chain may let go of all its precompression."""
    baseline_drift_fraction: float = 0.03
    """Drift of the quiet parts of the record that flags it."""

    def __post_init__(self) -> None:
        """Raise InvalidInputError for a value that is not positive and finite, or a window that is empty."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value > 0.0):
                raise InvalidInputError(f"{field.name} is {value}; it must be positive and finite")
        for low, high in (
            ("psw_earliest_s", "psw_latest_s"),
            ("isw_fwhm_s", "psw_latest_s"),
            ("window_half_width_s", "ssw_after_psw_latest_s"),
        ):
            if getattr(self, low) >= getattr(self, high):
                raise InvalidInputError(
                    f"{low} is {getattr(self, low)} s; it must lie below {high} = {getattr(self, high)} s"
                )

    @classmethod
    def for_width(cls, isw_fwhm_s: float, **given: float) -> ExtractionSettings:
        """Return the defaults with every time in proportion to the ISW's width; ``given`` fields as they are.

        Raise InvalidInputError for values that `ExtractionSettings` refuses.
        """
        return replace(cls()._times(isw_fwhm_s / USUAL_FWHM_S), **{"isw_fwhm_s": isw_fwhm_s, **given})

    @property
    def stretch(self) -> float:
        """Return the ISW's width over that of the paper's chain."""
        return self.isw_fwhm_s / USUAL_FWHM_S

    def unstretched(self) -> ExtractionSettings:
        """Return the settings in the time in which the ISW has the width of the paper's chain."""
        return self if self.stretch == 1.0 else self._times(1.0 / self.stretch)

    def _times(self, factor: float) -> ExtractionSettings:
        """Return the settings with every time multiplied by a factor."""
        times = {f.name: getattr(self, f.name) * factor for f in fields(self) if f.name.endswith("_s")}
        return replace(self, **times)

    @property
    def kernel_width_s(self) -> float:
        """Return the width W of the matched filter's kernel cos^4(pi t / W) in s, 178 us by default."""
        return KERNEL_WIDTH_PER_FWHM * self.isw_fwhm_s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReducedRecord:
    """Record as block means without its offset.

    Attributes
    ----------
    blocks_v
        Block means minus the quiet level, shape (n_blocks,).
    smooth_v
        Means of ``smooth_blocks`` (odd) neighbouring blocks, `TOP_SMOOTHING_S`, shape (n_blocks,).
    matched_v
        Matched filter's output, shape (n_blocks,); a cos^4 pulse gives its amplitude.
    first_s
        Time of the first block's centre from the trigger.
    samples_v
        The record at its full rate, offset included, shape (n_samples,).
    offset_v
        Quiet level that was taken off.
    noise_rms_v, block_noise_v, matched_noise_v
        Noise of one sample, 1.4826 MAD(differences) / sqrt(2); of a block mean, by their third differences
        where noise is limited in band; of the matched filter's output.
    quiet_blocks
        Blocks the quiet level was read from.
    """

    blocks_v: FloatArray
    smooth_v: FloatArray
    smooth_blocks: int
    matched_v: FloatArray
    first_s: float
    step_s: float
    block_samples: int
    samples_v: FloatArray
    offset_v: float
    noise_rms_v: float
    block_noise_v: float
    matched_noise_v: float
    quiet_blocks: int

    @property
    def end_s(self) -> float:
        """Return the end of the record, in s from the trigger."""
        return self.time_s(self.blocks_v.size - 0.5)

    def time_s(self, index: float) -> float:
        """Convert a (fractional) block index to the time from the trigger in s."""
        return self.first_s + index * self.step_s

    def index(self, time_s: float) -> float:
        """Convert a time from the trigger in s to a fractional block index."""
        return (time_s - self.first_s) / self.step_s


def round_to_odd(width: float) -> int:
    """Return the odd integer nearest to a width, at least 1."""
    return 2 * max(0, round(0.5 * (width - 1.0))) + 1


def moving_mean(values: FloatArray, width: int) -> FloatArray:
    """Compute centred means of ``width`` (odd) neighbours, shape (n,), n >= width.

    Values outside the record count as 0.
    """
    # Equal weights: correlation is convolution, without its reversal of an array.
    return np.correlate(values, equal_weights(width), "same")


def moving_means(rows: FloatArray, width: int) -> FloatArray:
    """Compute the moving mean over ``width`` (odd) neighbours of each row, shape (n_rows, n).

    Values outside a row count as 0.
    """
    # One correlation of all, with zeros between them.
    gap, (n_rows, n) = width // 2, rows.shape
    spaced = np.zeros(n_rows * (n + gap) + 2 * gap)
    spaced[gap : spaced.size - gap].reshape(n_rows, n + gap)[:, :n] = rows
    return np.correlate(spaced, equal_weights(width), "valid").reshape(n_rows, n + gap)[:, :n]


@lru_cache(maxsize=64)
def equal_weights(width: int) -> FloatArray:
    """Return the weights of a moving mean: equal, with the sum 1; shape (width,), read-only."""
    weights = np.full(width, 1.0 / width)
    weights.flags.writeable = False
    return weights


def median(values: FloatArray) -> float:
    """Return the median of numbers, shape (n,), n >= 1.

    NumPy's digits without its search for NaN and axes.
    """
    upper = values.size // 2
    if values.size % 2:
        return float(np.partition(values, upper)[upper])
    ordered = np.partition(values, (upper - 1, upper))
    return float(ordered[upper - 1] + ordered[upper]) / 2.0


def column_medians(table: FloatArray) -> FloatArray:
    """Compute the median of each column, shape (n, m), n >= 1.

    Same digits as `numpy.median`, without its search for NaN.
    """
    ordered, upper = np.sort(table, axis=0), len(table) // 2
    return np.asarray(ordered[upper] if len(table) % 2 else (ordered[upper - 1] + ordered[upper]) / 2.0)


def filter_kernel(width_blocks: float) -> FloatArray:
    """Return the matched filter's weights cos^4(pi t / W) / sum(cos^8), shape (2 k + 1,), W in blocks."""
    half = math.ceil(width_blocks / 2) - 1
    weights: FloatArray = np.cos(np.pi * np.arange(-half, half + 1) / width_blocks) ** 4
    return weights / float(weights @ weights)


@lru_cache(maxsize=64)
def kernel_noise_gain(width_blocks: float) -> float:
    """Return the SD of the matched filter's output for white noise of SD 1: the norm of its weights."""
    weights = filter_kernel(width_blocks)
    return math.sqrt(float(weights @ weights))


@lru_cache(maxsize=64)
def _kernel_spectrum(width_blocks: float, n_fft: int) -> NDArray[np.complex128]:
    """Return the spectrum of the matched filter's weights, shape (n_fft // 2 + 1,), centred on sample 0.

    Cached and read-only.
    """
    weights = filter_kernel(width_blocks)
    half = weights.size // 2
    wrapped = np.zeros(n_fft)
    wrapped[np.arange(-half, half + 1)] = weights
    spectrum = rfft(wrapped)
    spectrum.flags.writeable = False
    return spectrum


def apply_matched_filter(blocks_v: FloatArray, width_blocks: float) -> FloatArray:
    """Apply the matched filter for the pulse cos^4(pi t / W); zeros are assumed outside the record.

    Raise RecordError for a width below 4 samples.

    Parameters
    ----------
    blocks_v
        Shape (..., n).
    width_blocks
        W in samples of ``blocks_v``, at least 4.

    Returns
    -------
    FloatArray
        Output, shape (..., n), scaled so that this pulse gives its own amplitude at its centre.
    """
    if not width_blocks >= 4.0:
        raise RecordError(
            f"the matched filter's kernel is {width_blocks} samples wide, it needs at least 4: "
            "record at a higher rate or correct isw_fwhm_s"
        )
    n = blocks_v.shape[-1]
    n_fft = next_fast_length(n + math.ceil(width_blocks / 2))
    filtered = irfft(rfft(blocks_v, n_fft) * _kernel_spectrum(width_blocks, n_fft), n_fft)[..., :n]
    return np.asarray(filtered, dtype=np.float64)


def noise_rms(samples_v: FloatArray) -> float:
    """Estimate the RMS of the white noise of one sample in V; blind to pulses, hum and offset.

    It is 1.4826 MAD(differences) / sqrt(2). The median is sought in bins of 1/64 of the mean, linearly inside
    a bin, from its usual place on: a few counts cost a sixth of a partition. Where few large differences make
    the mean, the bins are too wide and the median is taken exactly.
    """
    difference = samples_v[1:] - samples_v[:-1]
    np.abs(difference, out=difference)
    bin_v = float(difference.sum()) / difference.size / 64.0
    if bin_v == 0.0:
        return 0.0
    middle = 0.5 * difference.size
    k = USUAL_MEDIAN_BIN
    below, within = (int(np.count_nonzero(difference < edge * bin_v)) for edge in (k, k + 1))
    while within < middle and k < 128:  # it is at most twice the mean
        k, below, within = k + 1, within, int(np.count_nonzero(difference < (k + 2) * bin_v))
    while below >= middle:
        k, below, within = k - 1, int(np.count_nonzero(difference < (k - 1) * bin_v)), below
    if k < COARSEST_MEDIAN_BIN:
        return MAD_TO_SD * median(difference) / math.sqrt(2.0)
    inside = (middle - below) / (within - below)
    return MAD_TO_SD * (k + inside) * bin_v / math.sqrt(2.0)


def estimate_fine_noise(blocks_v: FloatArray) -> float:
    """Estimate the SD of a block mean's white noise in V: 1.4826 MAD(third differences) / sqrt(20).

    No wave is left in them: a cos^4 pulse of 65 us leaves 5e-5 of its height at blocks of 1 us.
    """
    return MAD_TO_SD * median(_absolute_third_differences(blocks_v)) / THIRD_DIFFERENCE


def estimate_block_noise(blocks_v: FloatArray, white_v: float) -> float:
    """Estimate the SD of a block mean's noise in V, at least ``white_v``.

    It is ``white_v``, the SD expected from white samples, or `estimate_fine_noise` where that is
    significantly larger.
    """
    differences = _absolute_third_differences(blocks_v)
    limit_v = LEAST_EXCESS * white_v * THIRD_DIFFERENCE / MAD_TO_SD
    # Counting costs less than finding the median.
    if 2 * np.count_nonzero(differences > limit_v) < differences.size:
        return white_v
    middle_v = median(differences)
    return MAD_TO_SD * middle_v / THIRD_DIFFERENCE if middle_v > limit_v else white_v


def _absolute_third_differences(blocks_v: FloatArray) -> FloatArray:
    """Compute the absolute third differences a - 3 b + 3 c - d, shape (n - 3,)."""
    differences = blocks_v[2:-1] - blocks_v[1:-2]
    differences *= -3.0
    differences += blocks_v[3:]
    differences -= blocks_v[:-3]
    return np.abs(differences, out=differences)


@dataclass(frozen=True, slots=True, eq=False)
class VoltRecord:
    """Record in volts, shape (n_samples,); `clipped`: it touches an end of the ADC's range."""

    samples_v: FloatArray
    sample_rate_hz: float
    pretrigger_samples: int
    clipped: bool = False

    @property
    def kind(self) -> tuple[int, float, int]:
        """Return sample count, sample rate in Hz and pre-trigger samples, which alike records share."""
        return self.samples_v.size, self.sample_rate_hz, self.pretrigger_samples


def reduce_records(given: Sequence[VoltRecord], settings: ExtractionSettings) -> list[ReducedRecord]:
    """Compute block means, quiet level, noise and matched filter of records of one kind (`VoltRecord.kind`).

    The quiet level is the median of the block means before the trigger that are also at least 3/4 FWHM before
    the first rise to half of the record's extreme: the foot of an ISW that itself fired the trigger reaches
    into the pre-trigger and would bias it. Block means, because a median of raw counts moves in steps of an
    ADC code.

    Raises
    ------
    RecordError
        No sample before the trigger, sample rate too low for the pulse, or records shorter than the
        search windows.
    """
    n_samples, sample_rate_hz, pretrigger_samples = given[0].kind
    block_samples = max(1, math.floor(settings.block_s * sample_rate_hz * (1.0 + 1e-9)))
    step_s = block_samples / sample_rate_hz
    n_blocks = n_samples // block_samples
    blocks = np.empty((len(given), n_blocks))
    for row, one in zip(blocks, given, strict=True):
        complete_blocks = one.samples_v[: n_blocks * block_samples].reshape(n_blocks, block_samples)
        # einsum, not matmul: a threaded BLAS on a busy machine waits milliseconds for its threads.
        np.einsum("ij->i", complete_blocks, out=row)
    blocks /= block_samples

    pretrigger_blocks = max(1, pretrigger_samples // block_samples)
    level = column_medians(blocks[:, :pretrigger_blocks].T)
    rise = np.abs(moving_means(blocks - level[:, None], 2 * round(5e-6 / step_s) + 1))
    onset = (rise >= 0.5 * rise.max(axis=1)[:, None]).argmax(axis=1)
    quiet = np.minimum(pretrigger_blocks, onset - math.ceil(0.75 * settings.isw_fwhm_s / step_s))
    quiet[quiet * step_s < 10e-6] = pretrigger_blocks
    offset = [median(row[:n_quiet]) for row, n_quiet in zip(blocks, quiet.tolist(), strict=True)]
    blocks -= np.array(offset)[:, None]

    smooth_blocks, width = round_to_odd(TOP_SMOOTHING_S / step_s), settings.kernel_width_s / step_s
    smooth, matched = moving_means(blocks, smooth_blocks), apply_matched_filter(blocks, width)
    records = []
    for k, one in enumerate(given):
        noise_v = noise_rms(one.samples_v)
        block_noise_v = estimate_block_noise(blocks[k], noise_v / math.sqrt(block_samples))
        records.append(
            ReducedRecord(
                blocks_v=blocks[k],
                smooth_v=smooth[k],
                smooth_blocks=smooth_blocks,
                matched_v=matched[k],
                first_s=((block_samples - 1) / 2 - pretrigger_samples) / sample_rate_hz,
                step_s=step_s,
                block_samples=block_samples,
                samples_v=one.samples_v,
                offset_v=offset[k],
                noise_rms_v=noise_v,
                block_noise_v=block_noise_v,
                matched_noise_v=block_noise_v * kernel_noise_gain(width),
                quiet_blocks=int(quiet[k]),
            )
        )
    return records


def minimum_after_isw_s(settings: ExtractionSettings) -> float:
    """Return the shortest record in s after the ISW that holds a sound wall's reflected wave."""
    return settings.psw_earliest_s + 2.0 * (settings.window_half_width_s + settings.isw_fwhm_s)


def check_record(given: VoltRecord, settings: ExtractionSettings) -> None:
    """Raise RecordError if a record's length, sample rate or pre-trigger is too small."""
    n_samples, sample_rate_hz, pretrigger_samples = given.kind
    if not (math.isfinite(sample_rate_hz) and sample_rate_hz > 0.0):
        raise RecordError(f"sample_rate_hz is {sample_rate_hz}; it must be positive")
    if not 0 < pretrigger_samples < n_samples:
        raise RecordError(
            f"pretrigger_samples is {pretrigger_samples} of {n_samples}; the quiet level is read before the "
            "trigger: record at least 100 us of pre-trigger"
        )
    step_s = max(1, math.floor(settings.block_s * sample_rate_hz * (1.0 + 1e-9))) / sample_rate_hz
    if settings.isw_fwhm_s / step_s < FEWEST_BLOCKS:
        raise RecordError(
            f"an ISW of {settings.isw_fwhm_s * 1e6:.1f} us spans {settings.isw_fwhm_s / step_s:.1f} samples, "
            f"at least {FEWEST_BLOCKS} are needed: sample at {FEWEST_BLOCKS / settings.isw_fwhm_s:.3g} Hz "
            "or more"
        )
    needed_s = minimum_after_isw_s(settings)
    after_s = (n_samples - pretrigger_samples) / sample_rate_hz
    if after_s < needed_s:
        raise RecordError(
            f"the record ends {after_s * 1e6:.0f} us after its trigger, a reflected wave needs "
            f"{needed_s * 1e6:.0f} us: record longer"
        )
