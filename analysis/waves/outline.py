"""Outline of a record in a few dozen numbers, and shots whose record is unlike that of all others.

Corrosion changes the reflected wave from set to set; from strike to strike of one wall it stays, but for
noise and what the contacts do. So a wave that no other shot resembles holds something foreign, and one that
all others resemble, but that came much earlier than they did, has lost samples on its way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.waves.noise_colour import chance_mean_square, measure_wandering_noise
from analysis.waves.pulses import Pulse
from analysis.waves.record_reduction import MAD_TO_SD, STANDS_OUT, TOP_SMOOTHING_S, FloatArray, ReducedRecord

STEP_S = 15e-6
"""Between points; each is a mean over `TOP_SMOOTHING_S`, so that nothing wider than 30 us falls between."""
FROM_ISW, FROM_PSW = -5, -10
"""First points, from the matched time of each, in steps."""
LENGTHS = np.array([16, 21, 20])
"""Points around the ISW, around the PSW and after it: parts that are compared each by itself."""
N_ISW, N_POINTS, PSW = int(LENGTHS[0]), int(LENGTHS.sum()), 1
BEGINS = np.cumsum(LENGTHS) - LENGTHS
FEWEST = 7
"""Shots that can tell what is usual."""
NEIGHBOURS = 3
"""So many others must resemble a wave: two knocks alike are still knocks."""
LEAST_APART = 0.035
"""Of the ISW's amplitude, rms: the twin's shots at ``laboratory`` have their third neighbour at .012, one in
a hundred at .025; a foreign pulse of .2 on the reflected wave moves it by .045."""
TIMES_USUAL, TIMES_NOISE = 3.0, 2.2
"""Of the middle distance (at ``plant`` one shot in 200 is beyond), and of what noise alone gives."""
ONE_WALL_S, SAME_WALL_S = 30e-6, 25e-6
"""Eight of ten shots of one wall come within 10 us at ``laboratory``, 25 us at ``plant``; in a file of many
walls a shot has its own wall's next to it where others come within the second."""
LEAST_EARLY_S = 20e-6
"""Healthy shots of a set come up to 7 us before the middle one at ``laboratory``, 15 us at ``plant``."""
LARGEST_PART_EARLY = 1 / 3
"""More are another wall."""
MOST_OTHERS = 400
"""Of a long file, evenly spread: who has no neighbour among them has none."""
ROWS_AT_ONCE = 64
"""So that a long file needs little memory."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outline:
    """Smoothed values of a record around its waves, relative to the ISW's amplitude.

    Attributes
    ----------
    points
        Those of all parts, shape (n_points,); NaN where the record does not reach.
    sd
        Standard deviation that noise gives each.
    stretch
        The ISW's width over that of the paper's chain, in whose time the points lie.
    growth
        Variance of a mean of the noise over that of half as long: 0.5 for white noise, 1 for pink noise.
    """

    points: FloatArray
    sd: float
    stretch: float = 1.0
    growth: float = 0.5


def sample_outline(record: ReducedRecord, isw: Pulse, psw: Pulse, stretch: float = 1.0) -> Outline:
    """Sample a record around ISW and PSW at fixed points, in units of the ISW's height.

    Points that the record does not reach are NaN.
    """
    stride, points = max(1, round(STEP_S / record.step_s)), np.full(N_POINTS, math.nan)
    _fill_points(record, isw, FROM_ISW, stride, points[:N_ISW])
    _fill_points(record, psw, FROM_PSW, stride, points[N_ISW:])
    points /= isw.amplitude_v
    noise_v, growth = measure_wandering_noise(record, record.block_noise_v)
    return Outline(points=points, sd=noise_v / isw.amplitude_v, stretch=stretch, growth=growth)


def _fill_points(record: ReducedRecord, pulse: Pulse, first: int, stride: int, points: FloatArray) -> None:
    """Fill ``points`` in place with the samples around a pulse; NaN stays where the record does not reach."""
    at = record.index(pulse.matched_time_s)
    begin = math.floor(at) + first * stride
    if begin < 0:
        return
    end = begin + points.size * stride
    after = record.smooth_v[begin + 1 : end + 1 : stride]
    before = record.smooth_v[begin:end:stride][: after.size]
    points[: after.size] = before + (at % 1.0) * (after - before)


def find_dissimilar_shots(outlines: Sequence[Outline], tofs_s: FloatArray) -> NDArray[np.bool_]:
    """Find shots that no others resemble, or whose PSW came earlier than similar ones'; mask, shape (n,).

    Parameters
    ----------
    outlines, tofs_s
        Outline, and time of flight in s, of each shot of one transducer; among fewer than seven none is
        found.
    """
    n = len(outlines)
    if n < FEWEST:
        return np.zeros(n, dtype=bool)
    table = np.array([one.points for one in outlines])
    noise = np.array([one.sd for one in outlines])
    others = np.arange(n)
    if n > MOST_OTHERS:
        others = np.linspace(0, n - 1, MOST_OTHERS).round().astype(np.intp)
    distance, nearest = _compute_distances(table, others)
    typical = np.maximum(TIMES_USUAL * np.partition(nearest, n // 2)[:, n // 2], LEAST_APART)
    limit = np.maximum(typical[:, None], TIMES_NOISE * math.sqrt(2.0) * noise)
    is_apart = (nearest > limit) & (nearest < math.inf)
    # Where noise is pink, differences of independent noise show what its slow octaves hide.
    growth = float(np.median([one.growth for one in outlines]))
    if growth > 0.5:
        _, white = _compute_distances(_whiten(table, growth), others)
        noise2 = np.maximum(noise, np.median(noise)) ** 2
        usual2 = np.partition(white, n // 2)[:, n // 2, None] ** 2
        by_chance = np.array([[chance_mean_square(length)] for length in LENGTHS.tolist()])
        most2 = np.maximum((1.0 + by_chance) * noise2, by_chance * usual2)
        most2 += TIMES_USUAL**2 * np.maximum(0.0, usual2 - 2.0 * noise2)
        is_apart |= (white**2 > most2) & (nearest > LEAST_APART) & (nearest < math.inf)
    is_apart[PSW:] &= _find_comparable_shots(tofs_s, others)
    unlike = np.asarray(is_apart.any(axis=0))
    early = np.flatnonzero(tofs_s < tofs_s.max() - LEAST_EARLY_S)
    if early.size:
        unlike[_find_early_shots(early, distance[PSW] <= limit[PSW][:, None], tofs_s, others)] = True
    return unlike


def _whiten(table: FloatArray, growth: float) -> FloatArray:
    """Return outlines, shape (n, 57), whose parts have independent noise of the same SD as before."""
    span_s = N_POINTS * STEP_S
    hertz = np.arange(1.0, 2.0 * span_s / TOP_SMOOTHING_S) / span_s
    powers = hertz ** -(1.0 + math.log2(growth)) * np.sinc(hertz * TOP_SMOOTHING_S) ** 2
    apart_s = STEP_S * np.arange(LENGTHS.max())
    lags = np.cos(2.0 * np.pi * apart_s[:, None] * hertz) @ powers / powers.sum()
    whitened = table.copy()
    for begin, length in zip(BEGINS.tolist(), LENGTHS.tolist(), strict=True):
        steps = np.abs(np.subtract.outer(np.arange(length), np.arange(length)))
        part = table[:, begin : begin + length]
        whitened[:, begin : begin + length] = np.linalg.solve(np.linalg.cholesky(lags[steps]), part.T).T
    return whitened


def _compute_distances(table: FloatArray, others: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    """Compute RMS differences of all rows from the rows ``others``, by part, and the third smallest."""
    rows = range(0, len(table), ROWS_AT_ONCE)
    distance = np.concatenate([_compute_row_distances(table, k, others) for k in rows], axis=1)
    return distance, np.partition(distance, NEIGHBOURS - 1)[:, :, NEIGHBOURS - 1]


def _compute_row_distances(table: FloatArray, start: int, others: NDArray[np.intp]) -> FloatArray:
    """Compute RMS differences of up to 64 rows of ``table``, from ``start`` on, from its rows ``others``.

    Shape (3, n_rows, n_others) for the parts around the ISW, around the PSW and after it. A distance is inf
    from a shot to itself, and where one of the two shots lacks the part.
    """
    rows = table[start : start + ROWS_AT_ONCE]
    differences = rows[:, None] - table[others]
    differences *= differences
    squares = np.add.reduceat(differences, BEGINS, axis=2).transpose(2, 0, 1) / LENGTHS[:, None, None]
    squares[np.isnan(squares)] = math.inf
    squares[:, np.arange(start, start + len(rows))[:, None] == others] = math.inf
    return np.asarray(np.sqrt(squares), dtype=np.float64)


def _find_comparable_shots(tofs_s: FloatArray, others: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return a mask, shape (n,): seven or more of ``others`` are within 25 us of the shot's time of flight.

    All are if the middle eight of ten times of flight agree within 30 us. Corrosion changes the record after
    the incident wave, so only shots of the same wall are comparable there.
    """
    ordered = np.sort(tofs_s)
    if ordered[-1 - tofs_s.size // 10] - ordered[tofs_s.size // 10] <= ONE_WALL_S:
        return np.ones(tofs_s.size, dtype=bool)
    ordered = np.sort(tofs_s[others])
    upper, lower = tofs_s + SAME_WALL_S, tofs_s - SAME_WALL_S
    return np.asarray(np.searchsorted(ordered, upper) - np.searchsorted(ordered, lower) >= FEWEST)


def _find_early_shots(
    candidates: NDArray[np.intp], similar: NDArray[np.bool_], tofs_s: FloatArray, others: NDArray[np.intp]
) -> list[int]:
    """Find the indices of shots whose reflected wave came earlier than those of similar shots.

    ``similar``, shape (n, n_others), marks which of ``others`` each shot resembles; candidates with fewer
    than six are skipped. Return an empty list if more than a third of all shots are early: another wall.
    """
    early = []
    for index in candidates.tolist():
        like_s = np.sort(tofs_s[others[similar[index]]])
        if like_s.size < FEWEST - 1:
            continue
        middle_s, later_s = like_s[like_s.size // 2], like_s[3 * like_s.size // 4]
        scatter_s = (later_s - middle_s) * MAD_TO_SD
        if tofs_s[index] < middle_s - max(LEAST_EARLY_S, STANDS_OUT * scatter_s):
            early.append(index)
    return early if len(early) <= LARGEST_PART_EARLY * tofs_s.size else []
