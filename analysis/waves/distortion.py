"""Distorted shots: tops made lower by an amplifier, samples lost without a gap.

One wall sends back one shape, so both show beside the set's median outline, by the pattern that they leave in
the difference from it: small ones that no distance between records distinguishes from scatter (`outline`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from analysis.waves.outline import (
    FEWEST,
    FROM_ISW,
    FROM_PSW,
    LENGTHS,
    N_ISW,
    ONE_WALL_S,
    ROWS_AT_ONCE,
    STEP_S,
    Outline,
)
from analysis.waves.record_reduction import MAD_TO_SD, FloatArray, column_medians, median

N_PSW = N_ISW + int(LENGTHS[1])
CAP = 0.95
"""Of the height: what a hard limit there takes from the top."""
FLAT_SD, FLAT_SCATTER = 3.0, 8.0
"""Standard deviations of noise, and of what scatters from shot to shot on top of it."""
MAD_OF_FEW = 2.0
"""Times the noise's variance: so much a median distance of ten may show of noise alone."""
LOWEST_CAP, LOWEST_BEND = 0.02, 0.015
"""Of the ISW's amplitude times the root of points: a hard limit at .95 leaves .032, tanh to .95 .027; healthy
shots of the twin at ``laboratory`` stay below .017 and .05, most of which is their scatter."""
SHIFTS = np.arange(37.5e-6, 91e-6, 7.5e-6) / STEP_S
"""Lengths that may be missing, in steps."""
ALIGNED = 2 - FROM_PSW
"""Points of the reflected wave, up to 15 us after its top, that say how high it is and when it came."""
CUT_SD2, CUT_SCATTER2, LEAST_CUT, UNEXPLAINED = 25.0, 80.0, 1e-3, 0.3
"""What a cut must explain of the sum of squares: times the variance of noise and of what scatters on top, of
the ISW's amplitude squared; and what it may leave of that."""
GRAIN = 1e-13
"""Of the sum of squares: what keeps a column without a slope from being singular."""


def is_same_wall(tofs_s: FloatArray) -> bool:
    """Check whether the middle eight of ten times of flight agree within 30 us, as for one wall."""
    ordered, tenth = np.sort(tofs_s), tofs_s.size // 10
    return bool(ordered[-1 - tenth] - ordered[tenth] <= ONE_WALL_S)


def find_clipped_shots(outlines: Sequence[Outline], tofs_s: FloatArray) -> NDArray[np.bool_]:
    """Find shots with a flattened top: an amplifier near its limit. Boolean, shape (n_shots,).

    A hard limit lowers the middle of the ISW's top; a soft one, v - c v^3, more of the ISW than of the PSW,
    which is sought where all shots are of one wall. Height, arrival and width are each shot's own.
    None is found among fewer than seven shots.
    """
    table, sd = _tabulate_outlines(outlines)
    found = np.zeros(len(table), dtype=bool)
    if len(table) < FEWEST:
        return found
    isw = table[:, :N_ISW]
    middle = _median_wave(isw)
    cap = np.clip(middle - CAP, 0.0, None)
    found |= _find_lowered_shots(isw, middle, cap, _build_variations([(0, FROM_ISW, middle)]), sd, LOWEST_CAP)
    if is_same_wall(tofs_s):
        both = table[:, :N_PSW]
        middle = _median_wave(both)
        variation = _build_variations([(0, FROM_ISW, middle[:N_ISW]), (N_ISW, FROM_PSW, middle[N_ISW:])])
        found |= _find_lowered_shots(both, middle, middle**3, variation, sd, LOWEST_BEND)
    return found


def _tabulate_outlines(outlines: Sequence[Outline]) -> tuple[FloatArray, FloatArray]:
    """Stack points, shape (n_outlines, n_points), and SDs, shape (n_outlines,), of all outlines."""
    return np.array([one.points for one in outlines]), np.array([one.sd for one in outlines])


def _median_wave(points: FloatArray) -> FloatArray:
    """Return the median outline of the complete shots, shape (n_points,); NaN if there is none."""
    complete = points[np.isfinite(points).all(axis=1)]
    return column_medians(complete) if len(complete) else np.full(points.shape[1], np.nan)


def _compute_slope(wave: FloatArray) -> FloatArray:
    """Compute the central differences of a wave per sample, shape (n,), n >= 2; one-sided at the ends.

    Same values as `numpy.gradient`, without its checks.
    """
    slope = np.empty(wave.size)
    slope[1:-1] = (wave[2:] - wave[:-2]) / 2.0
    slope[0], slope[-1] = wave[1] - wave[0], wave[-1] - wave[-2]
    return slope


def _build_variations(waves: Sequence[tuple[int, int, FloatArray]]) -> FloatArray:
    """Build columns, shape (n, n_waves + 1), of a sound shot's variation: arrival of each wave, width.

    Each of ``waves`` is its first row, its first point from the peak, and its values; together they have n.
    """
    n = sum(wave.size for _, _, wave in waves)
    columns = np.zeros((n, len(waves) + 1))
    for k, (begin, first, wave) in enumerate(waves):
        slope, part = _compute_slope(wave), slice(begin, begin + wave.size)
        columns[part, k] = slope
        columns[part, -1] = np.arange(first, first + wave.size) * slope
    return columns


def _fit_linear_model(columns: FloatArray, values: FloatArray) -> FloatArray:
    """Return the least-squares weights of columns, shape (m, k), for values, shape (m,) or (m, n).

    The result has the shape (k,) or (k, n). A ridge of 1e-13 of the trace keeps columns of zeros solvable.
    """
    gram = columns.T @ columns
    gram.flat[:: len(gram) + 1] += GRAIN * gram.trace()
    return np.asarray(np.linalg.solve(gram, columns.T @ values))


def _find_lowered_shots(
    points: FloatArray,
    middle: FloatArray,
    pattern: FloatArray,
    variation: FloatArray,
    sd: FloatArray,
    least: float,
) -> NDArray[np.bool_]:
    """Find shots that a pattern lowers by more than their scatter explains; Boolean, shape (n_shots,).

    ``points`` has shape (n_shots, n), the median outline ``middle`` and ``pattern`` (n,). ``variation``,
    shape (n, k), is how sound shots differ, ``sd`` each shot's noise, ``least`` the smallest lowering that
    counts. A shot with a missing point is not found.
    """
    if not (np.isfinite(middle).all() and pattern.any()):
        return np.zeros(len(points), dtype=bool)
    variation = np.column_stack([middle, variation])
    pattern = pattern - variation @ _fit_linear_model(variation, pattern)
    lowered = -(points @ pattern) / np.linalg.norm(pattern)
    known = np.isfinite(lowered)
    typical = median(lowered[known])
    scatter2 = (MAD_TO_SD * median(np.abs(lowered[known] - typical))) ** 2
    own_scatter2 = max(0.0, scatter2 - MAD_OF_FEW * median(sd) ** 2)
    limit = np.sqrt((FLAT_SD * sd) ** 2 + FLAT_SCATTER**2 * own_scatter2)
    return np.asarray(known & (lowered - typical > np.maximum(limit, least)))


def find_shots_with_lost_samples(outlines: Sequence[Outline], tofs_s: FloatArray) -> NDArray[np.bool_]:
    """Find shots that lost samples after the top of the reflected wave; Boolean, shape (n_shots,).

    From some point on, such a shot is earlier than the median outline by one constant time: this must explain
    most of its difference. None is found among fewer than seven shots, or if their times of flight ``tofs_s``
    show more than one wall.
    """
    n = len(outlines)
    found = np.zeros(n, dtype=bool)
    if n < FEWEST or not is_same_wall(tofs_s):
        return found
    table, sd = _tabulate_outlines(outlines)
    points = table[:, N_ISW:]
    middle = _median_wave(points)
    if not np.isfinite(middle).all():
        return found
    variation = np.column_stack([middle, _compute_slope(middle)])
    left = points - middle
    left -= (variation @ _fit_linear_model(variation[:ALIGNED], left[:, :ALIGNED].T)).T
    left[np.isnan(left)] = 0.0
    scatter2 = max(0.0, median((left**2).sum(axis=1) / middle.size - sd**2))
    for first in range(0, n, ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        found[rows] = _find_shots_with_cut(left[rows], middle, sd[rows] ** 2, scatter2)
    return found


def _find_shots_with_cut(
    left: FloatArray, middle: FloatArray, noise2: FloatArray, scatter2: float
) -> NDArray[np.bool_]:
    """Find shots that a cut of one length after one point explains; Boolean, shape (n_shots,).

    ``left``, shape (n_shots, n_points), is their difference from the median outline ``middle``; ``noise2``,
    shape (n_shots,), and ``scatter2`` are the variances of noise and of scatter between shots. Arrays below
    have the shape (shots, lengths, points).
    """
    least = np.maximum(CUT_SD2 * noise2, max(CUT_SCATTER2 * scatter2, LEAST_CUT))[:, None]
    place = np.arange(middle.size)
    later = place + SHIFTS[:, None]
    inside = later <= place[-1]
    earlier = np.where(inside, np.interp(later, place, middle) - middle, 0.0)
    left2 = left**2
    gain = left[:, None] * (2.0 * earlier) - earlier**2
    # Of what lies behind each point; the point itself is a mean of before and after.
    behind = gain[..., ::-1].cumsum(axis=-1)[..., ::-1][..., ALIGNED:]
    best = behind.argmax(axis=-1)
    gained = np.take_along_axis(behind, best[..., None], -1)[..., 0]
    explained = gained + np.take_along_axis(left2, best + (ALIGNED - 1), 1)
    rest = np.einsum("ij,kj->ik", left2, inside.astype(np.float64))
    rest -= noise2[:, None] * inside.sum(axis=1) + explained
    return np.asarray(((gained > least) & (rest < UNEXPLAINED * gained)).any(axis=1))
