"""Disturbances of a record that no strike causes.

A flat top, a pull, an edge, missing samples, a stray pulse.

A chain only pushes. Its record is a few smooth humps on a level that it leaves downwards by no more than
the static preload, 1 % of the incident wave (twin, any depth: .9 %). Fractions are of the ISW's amplitude.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from analysis.waves.pulses import NOISE_CRESTS, Pulse
from analysis.waves.quality_gate import DISTURBED, LOST_SAMPLES
from analysis.waves.record_reduction import STANDS_OUT, FloatArray, ReducedRecord, median, moving_mean

FLAT_TOP_REACH = 0.3
"""Of the width at half height: where the top is compared with its middle, means over a fifth of the width."""
FLAT_TOP_FALL = 0.155
"""Least fall from the middle to there: the twin's waves, half sines, cos^4, Gaussian and sech^2 pulses fall
by .19-.23, a wave that is cut at .85 of its height by .11; white noise of a tenth of the height moves it
.011."""
LEAST_SOUND_FALL, TOP_NOISE = 0.19, 3.0
"""Where noise moves it more, that many standard deviations below what a sound wave falls."""
LONGEST_TOP, FEWEST_AT_TOP = 0.15, 16
"""Of the width, and samples, at exactly the highest value: a wave of 100 codes stays on its last for .12."""
LAST_CODE = 1.6
"""The same of a wave of n codes, times the root of n: cos^4 has 1.24, and noise of a code is two more."""
LOOKED_AFTER_PSW_S = 520e-6
"""Nothing is measured later."""
WAKE_S = (50e-6, 150e-6)
DEEPEST_WAKE = 0.13
"""After the PSW a disk that leans by .05 rad swings back by a tenth of the wave."""
FOOT_PER_FWHM = 0.4
END_S, END_MEAN_S, FEWEST_END_MEANS = 200e-6, 20e-6, 3
END_ASIDE, END_NEAREST = 0.3, 0.25
"""Of the means at the end, nearest to the level, that a drift may leave there: a wave leaves more. And how
far off, of the others, the nearest one is at least: waves that overlap come back to the level between."""
PSW_WIDTHS = 2.0
"""After its middle the reflected wave is over."""
LEVEL_BLOCKS = 5
EDGE_S = 3e-6
EDGE_PER_WIDTH = 2.4
"""Steepest slope of a pulse times its width over its height: a half sine has 2.1, the twin's waves 1.5."""
NOISE_STEPS = 5.5
"""The same for the thousand differences between neighbours."""
FEWEST_ALIKE, SHORTEST_ALIKE_S = 32, 15e-6
"""Samples in a row on a line: where noise bends more than every second one away, 32 never are by chance."""
FEWEST_CODES = 1.5
"""By which half of the samples leave the line through their neighbours, as noise of a code makes them; less
noise leaves quiet stretches on one code."""
NOISE_BEND_CODES, FINEST_CODE = 2.5, 3e-5
"""Noise less than a code wide bends by two codes at most, wherever between codes the level is; only wider
noise moves every level. A code is at least that fraction of the range: rounding of volts, and of a simulated
record without noise, is no noise; noise 80 dB below the wave is three of these codes."""
NOISE_PARTS, FEWEST_BENDS = 8, 20.0
"""Parts of the other samples whose median rate of such bends counts, so that spikes do not; and how many a
stretch without any lacks: by chance exp(-20/3), for a sample takes part in three, and then equal ones."""
PLATEAU = 0.4
"""Of the farthest sample from the quiet level: below that, a stretch at an extreme value is no clipping."""
CLOSEST_ALIKE_S, STRAIGHT_CODES = 5e-6, 1.5
"""Between samples looked at first, and by how much those on a line, each rounded, leave it."""


def is_flat_topped(record: ReducedRecord, time_s: float, fwhm_s: float, noise_v: float) -> bool:
    """Check whether a pulse's top is too flat for a wave, as from a saturated amplifier.

    The pulse is at ``time_s`` from the trigger; ``noise_v`` is the SD of a block mean in V. Return False if
    the width is unknown or the record does not reach around the top.
    """
    if not math.isfinite(fwhm_s):
        return False
    half = max(1, round(0.1 * fwhm_s / record.step_s))
    centre = round(record.index(time_s))
    aside = round(FLAT_TOP_REACH * fwhm_s / record.step_s)
    first, last = centre - aside - half, centre + aside + half + 1
    if first < 0 or last > record.blocks_v.size:
        return False
    n = 2 * half + 1
    middle = float(record.blocks_v[centre - half : centre + half + 1].sum())
    sides = float(record.blocks_v[first : first + n].sum()) + float(record.blocks_v[last - n : last].sum())
    fall_sd = math.sqrt(1.5 * n) * noise_v / middle
    return 1.0 - 0.5 * sides / middle < min(FLAT_TOP_FALL, LEAST_SOUND_FALL - TOP_NOISE * fall_sd)


def is_clipped(record: ReducedRecord, time_s: float, fwhm_s: float, rate_hz: float) -> bool:
    """Check whether a pulse stays at one maximum value: the signal exceeded the converter's range.

    At least 16 samples must be at it, over more of the width ``fwhm_s`` than a wave's top explains. The pulse
    is at ``time_s`` from the trigger.
    """
    centre = round(record.index(time_s) * record.block_samples)
    half = round(0.5 * fwhm_s * rate_hz) if math.isfinite(fwhm_s) else 0
    top = record.samples_v[max(0, centre - half) : centre + half]
    if not top.size:
        return False
    highest_v = float(top.max())
    at_top = top == highest_v
    if np.count_nonzero(at_top) < FEWEST_AT_TOP:
        return False
    highest = np.flatnonzero(at_top)
    code_v = highest_v - float(top[~at_top].max(initial=float(top.min())))
    code_v += 2.0 * min(record.noise_rms_v, code_v)
    by_code = LAST_CODE * math.sqrt(code_v / (highest_v - record.offset_v))
    return bool(highest[-1] - highest[0] > max(LONGEST_TOP, by_code) * fwhm_s * rate_hz)


def measure_deepest_pull(
    record: ReducedRecord, isw_v: float, psw_time_s: float | None, noise_v: float, allowed: float
) -> tuple[float, bool]:
    """Measure how far the record falls below its quiet level, and whether more than a strike explains.

    The search ends `LOOKED_AFTER_PSW_S` after the PSW and is less strict in its wake; the drift is a straight
    line.

    Parameters
    ----------
    isw_v
        Amplitude of the ISW in V.
    psw_time_s
        Time of the PSW from the trigger; None: there is none.
    noise_v
        Standard deviation of the smoothed record in V.
    allowed
        Depth over the ISW's amplitude that a strike explains.

    Returns
    -------
    tuple
        Depth over the ISW's amplitude (0 where only a spike falls), and True where the depth is too large.
    """
    last = record.blocks_v.size
    if psw_time_s is not None:
        last = min(last, round(record.index(psw_time_s + LOOKED_AFTER_PSW_S)))
    width = record.smooth_blocks
    seen = record.smooth_v[:last]
    drift = min(0.0, float(seen[-20 * width :].max()))
    fallen = seen - np.linspace(0.0, drift, seen.size) if drift < 0.0 else seen.copy()
    deepest = -float(fallen.min()) / isw_v
    if psw_time_s is not None:
        begins, ends = (max(0, round(record.index(psw_time_s + after_s))) for after_s in WAKE_S)
        fallen[begins:ends] += max(0.0, DEEPEST_WAKE - allowed) * isw_v
    limit = -(allowed * isw_v + NOISE_CRESTS * noise_v)
    lowest = int(fallen.argmin())
    if fallen[lowest] > limit:
        return deepest, False
    # An electrical spike lowers the mean, but not the median.
    near = record.blocks_v[max(0, lowest - width // 2) : lowest + width // 2 + 1]
    falls = median(near) < 0.7 * limit
    return (deepest if falls else 0.0), falls


def has_edge(record: ReducedRecord, isw_v: float, isw_fwhm_s: float, noise_v: float) -> bool:
    """Check for a jump in the record: samples lost in a flank, or the start of an electrical pulse.

    A spike that returns to its level is none. ``isw_v`` and ``isw_fwhm_s`` are height and width of the ISW,
    ``noise_v`` the SD of a block mean in V.
    """
    width = max(1, round(EDGE_S / record.step_s))
    per_block = EDGE_PER_WIDTH * record.step_s / isw_fwhm_s * isw_v
    noise = math.sqrt(2.0) * noise_v
    means = moving_mean(record.blocks_v, 2 * (width // 2) + 1)[width // 2 : record.blocks_v.size - width // 2]
    steps = np.abs(means[width:] - means[:-width])
    highest = int(steps.argmax())
    if steps[highest] < per_block * width + NOISE_STEPS * noise / math.sqrt(width):
        return False
    # An electrical spike moves two means, but the level before and after it is the same.
    around = record.blocks_v[max(0, highest + width - LEVEL_BLOCKS) : highest + width + LEVEL_BLOCKS]
    before, after = around[:LEVEL_BLOCKS], around[LEVEL_BLOCKS:]
    if not (before.size and after.size):
        return False
    rise = abs(median(after) - median(before))
    return rise > per_block * LEVEL_BLOCKS + NOISE_STEPS * noise / math.sqrt(0.64 * LEVEL_BLOCKS)


def has_drift(
    record: ReducedRecord, isw: Pulse, psw: Pulse | None, least_fraction: float, noise_v: float
) -> bool:
    """Check for hum or drift: the quiet part before the ISW, or the record's end, is off its level.

    The stretch's 10-us means range over more, or the end is farther off, than the stated fraction of the ISW
    and six standard deviations of noise.
    """
    width = max(1, round(10e-6 / record.step_s))
    # Some pulses have long feet (sech^2: 3 % of its height a width before its middle's flank).
    foot_s = FOOT_PER_FWHM * isw.fwhm_s if math.isfinite(isw.fwhm_s) else 0.0
    foot = max(record.quiet_blocks - round(foot_s / record.step_s), min(width, record.quiet_blocks))
    quiet = record.blocks_v[: foot - foot % width]
    steps = quiet.reshape(-1, width).sum(axis=1) / width
    limit = max(least_fraction * isw.amplitude_v, STANDS_OUT * noise_v / math.sqrt(width))
    return bool(_end_level(record, psw) > limit or (steps.size > 0 and steps.max() - steps.min() > limit))


def _end_level(record: ReducedRecord, psw: Pulse | None) -> float:
    """Return the offset of the record's end from the quiet level in V; 0 if the end is on it or too short.

    It is one of the smaller 20-us means of the last 200 us after the PSW, each scaled as a linear drift, so
    that a third wave there does not count.
    """
    first = record.blocks_v.size - round(END_S / record.step_s)
    if psw is not None:
        width_s = psw.fwhm_s if math.isfinite(psw.fwhm_s) else 0.0
        first = max(first, math.ceil(record.index(psw.time_s + PSW_WIDTHS * width_s)))
    width = max(1, round(END_MEAN_S / record.step_s))
    n = max(0, record.blocks_v.size - first) // width
    if n < FEWEST_END_MEANS:
        return 0.0
    sums = np.einsum("ij->i", record.blocks_v[-n * width :].reshape(n, width)).tolist()
    since = record.blocks_v.size - 0.5 * record.quiet_blocks
    at_end = since - 0.5 * width
    levels: list[float] = sorted(
        v / width * at_end / (since - width * (n - k - 0.5)) for k, v in enumerate(sums)
    )
    aside = round(END_ASIDE * n)
    if levels[aside] + levels[-1 - aside] < 0.0:
        levels = [-level for level in reversed(levels)]
    return levels[aside] if levels[0] > END_NEAREST * levels[aside] else 0.0


def find_noise_free_flags(records: Sequence[ReducedRecord], rate_hz: float) -> list[set[str]]:
    """Find stretches without noise in records of one kind; return the flags of each record, empty for none.

    Lost samples were replaced by zeros, by the last one, or by a line between their neighbours. The flags are
    ``lost_samples``, ``clipped`` and ``disturbed``; there must be at least one record.
    """
    stride = max(1, round(CLOSEST_ALIKE_S * rate_hz))
    n = (records[0].samples_v.size - 1) // stride
    coarse = np.array([record.samples_v[::stride] for record in records])
    rise = coarse[:, 1:] - coarse[:, :-1]
    code_v = np.where(rise != 0.0, np.abs(rise), math.inf).min(axis=1)
    is_near = np.ones(rise.shape, dtype=bool)
    for between in (stride // 4, stride // 2, 3 * stride // 4):
        departs = np.array([record.samples_v[between : n * stride : stride] for record in records])
        departs -= coarse[:, :-1] + rise * (between / stride)
        is_near &= np.abs(departs, out=departs) <= STRAIGHT_CODES * code_v[:, None]
    suspect = np.asarray((is_near[:, 1:] & is_near[:, :-1]).any(axis=1))
    return [
        _find_noise_free_stretches(record, rate_hz) if is_suspect else set()
        for record, is_suspect in zip(records, suspect.tolist(), strict=True)
    ]


def _find_noise_free_stretches(record: ReducedRecord, rate_hz: float) -> set[str]:
    """Return the flags of stretches in one record whose samples are equal or on a line, without noise.

    Equal samples give ``lost_samples`` or ``clipped``, a line ``disturbed``.
    """
    steps = np.diff(record.samples_v)
    shortest = max(FEWEST_ALIKE, SHORTEST_ALIKE_S * rate_hz)
    found = _find_constant_stretches(record, steps, shortest)
    code_v = _smallest_step(steps)
    bends = np.abs(np.diff(steps))
    if found or median(bends) < FEWEST_CODES * code_v:
        return found
    longest = int(np.diff(np.flatnonzero(np.concatenate([[True], bends > 1.01 * code_v, [True]]))).max())
    return {DISTURBED} if longest + 1 >= shortest else set()


def _find_constant_stretches(record: ReducedRecord, steps: FloatArray, shortest: float) -> set[str]:
    """Return the flags (lost samples, clipped) of stretches of equal samples too long for the noise.

    ``steps`` are the differences between neighbouring samples in V, ``shortest`` is the length in samples
    from which a stretch counts.
    """
    samples = record.samples_v
    lowest, highest = float(samples.min()), float(samples.max())
    edges = np.flatnonzero(np.concatenate([[True], steps != 0.0, [True]]))
    lengths, values = np.diff(edges), samples[edges[:-1]]
    held = np.repeat(lengths >= shortest, lengths)
    bends = np.diff(steps)
    least_v = NOISE_BEND_CODES * max(_smallest_step(steps), FINEST_CODE * (highest - lowest))
    noisy = (np.abs(bends[:-1]) > least_v) & (bends[:-1] * bends[1:] < 0.0)
    parts = np.array_split(noisy[~(held[:-3] | held[3:])], NOISE_PARTS)
    typical = median(np.array([part.mean() if part.size else 0.0 for part in parts]))
    lost = (lengths >= shortest) & (lengths * typical > FEWEST_BENDS)
    height_v = PLATEAU * max(highest - record.offset_v, record.offset_v - lowest)
    plateau = ((values == lowest) | (values == highest)) & (np.abs(values - record.offset_v) > height_v)
    plateau[[0, -1]] = False  # a wave comes and goes
    flags = {LOST_SAMPLES: lost & ~plateau, "clipped": lost & plateau}
    return {flag for flag, stretches in flags.items() if stretches.any()}


def _smallest_step(steps: FloatArray) -> float:
    """Return the magnitude of the smallest step in V that is not zero; infinite if all are zero."""
    return float(np.abs(steps[steps != 0.0]).min(initial=math.inf))
