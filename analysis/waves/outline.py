"""A record in a few dozen numbers, and shots whose record is unlike that of all others.

Corrosion changes the reflected wave from set to set; from strike to strike of one wall it stays, but for
noise and what the contacts do. So a wave that no other shot resembles holds something foreign, and one that
all others resemble, but that came much earlier than they did, has lost samples on its way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.waves.pulses import Pulse
from analysis.waves.record_reduction import FloatArray, ReducedRecord

STEP_S = 15e-6
"""Between points; each is a mean over `TOP_SMOOTHING_S`, so that nothing wider than 30 us falls between."""
PARTS = {"isw": (-5, 10), "psw": (-10, 10), "after": (11, 30)}
"""First and last point around the ISW's matched time, and around and after the PSW's, in steps."""
FEWEST = 7
"""Shots that can tell what is usual."""
NEIGHBOURS = 3
"""So many others must resemble a wave: two knocks alike are still knocks."""
LEAST_APART = 0.035
"""Of the ISW's amplitude, rms: the twin's shots at ``laboratory`` have their third neighbour at .012, one in
a hundred at .025; a foreign pulse of .2 on the reflected wave moves it by .045."""
TIMES_USUAL, TIMES_NOISE = 3.0, 2.2
"""Of the middle distance (at ``plant`` one shot in 200 is beyond), and of what noise alone gives."""
LEAST_EARLY_S, EARLY_SD = 20e-6, 6.0
"""Healthy shots of a set come up to 7 us before the middle one at ``laboratory``, 15 us at ``plant``."""
UPPER_QUARTER_SD = 0.6745
LARGEST_PART_EARLY = 1 / 3
"""More are another wall."""
MOST_OTHERS = 400
"""Of a long file, evenly spread: who has no neighbour among them has none."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outline:
    """A record's smoothed values around its waves, of the ISW's amplitude.

    Attributes
    ----------
    points
        Those of all `PARTS`, shape (n_points,); NaN in a part that the record does not hold.
    sd
        Standard deviation that white noise gives each.
    """

    points: FloatArray
    sd: float


def outline(record: ReducedRecord, isw: Pulse, psw: Pulse) -> Outline:
    """Read a record at the points of `PARTS`, linearly between blocks."""
    stride, parts = max(1, round(STEP_S / record.step_s)), []
    for name, (first, last) in PARTS.items():
        at = record.index((isw if name == "isw" else psw).matched_time_s)
        whole = int(at)
        begin, end = whole + first * stride, whole + last * stride + 1
        if begin < 0 or end >= record.smooth_v.size:
            parts.append(np.full(last - first + 1, np.nan))
            continue
        before, after = record.smooth_v[begin:end:stride], record.smooth_v[begin + 1 : end + 1 : stride]
        parts.append(before + (at - whole) * (after - before))
    noise = record.noise_rms_v / (record.block_samples * record.smooth_blocks) ** 0.5
    return Outline(points=np.concatenate(parts) / isw.amplitude_v, sd=noise / isw.amplitude_v)


def unlike_others(outlines: Sequence[Outline], tofs_s: FloatArray) -> NDArray[np.bool_]:
    """Tell which shots no others resemble, or came earlier than all that they resemble, shape (n,).

    Parameters
    ----------
    outlines, tofs_s
        Of each shot, of one transducer; of less than `FEWEST` none is told.
    """
    n = len(outlines)
    unlike = np.zeros(n, dtype=bool)
    if n < FEWEST:
        return unlike
    table = np.array([one.points for one in outlines])
    noise = np.array([one.sd for one in outlines])
    others = np.unique(np.linspace(0, n - 1, min(n, MOST_OTHERS)).round().astype(np.intp))
    start = 0
    for name, (first, last) in PARTS.items():
        part = table[:, start : start + last - first + 1]
        start += last - first + 1
        there = np.isfinite(part[:, 0])
        if np.count_nonzero(there[others]) < FEWEST:
            continue
        distance = _distances(part, others)
        nearest = np.partition(distance, NEIGHBOURS - 1, axis=1)[:, NEIGHBOURS - 1]
        usual = TIMES_USUAL * float(np.median(nearest[there]))
        limit = np.maximum(max(LEAST_APART, usual), TIMES_NOISE * np.sqrt(2.0) * noise)
        unlike |= there & (nearest > limit)
        if name == "psw":
            unlike |= _early(distance <= limit[:, None], tofs_s, others)
    return unlike


def _distances(part: FloatArray, others: NDArray[np.intp]) -> FloatArray:
    """Root mean square between each row and each of the others, shape (n, n_others); inf to itself."""
    squares = np.einsum("ij,ij->i", part, part)
    apart = squares[:, None] + squares[others] - 2.0 * np.einsum("ik,jk->ij", part, part[others])
    apart[others, np.arange(others.size)] = np.inf
    apart = np.where(np.isnan(apart), np.inf, apart).clip(0.0)
    return np.asarray(np.sqrt(apart / part.shape[1]), dtype=np.float64)


def _early(alike: NDArray[np.bool_], tofs_s: FloatArray, others: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Whether a reflected wave came before those like it, whose later half tells their scatter."""
    early = np.zeros(tofs_s.size, dtype=bool)
    for index in np.flatnonzero(tofs_s < tofs_s.max() - LEAST_EARLY_S):
        like_s = tofs_s[others[alike[index]]]
        if like_s.size < FEWEST - 1:
            continue
        middle_s, later_s = np.quantile(like_s, (0.5, 0.75))
        scatter_s = (later_s - middle_s) / UPPER_QUARTER_SD
        early[index] = tofs_s[index] < middle_s - max(LEAST_EARLY_S, EARLY_SD * scatter_s)
    return early if early.mean() <= LARGEST_PART_EARLY else np.zeros_like(early)
