"""What may be wrong with sets offered as a baseline: gross ones, a group that is off alike, a trend.

Mean and covariance of all sets hide a group: it widens the covariance along itself. So a core of sets is
sought whose covariance is least (the minimum covariance determinant), and grown by whatever fits it. The core
only names sets: limits and distances never use its covariance, since below some 200 sets its false alarms
have no known rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy  # `scipy.special` comes when asked for
from numpy.typing import ArrayLike

from analysis.statistics.limits import f_predictive_limit
from analysis.statistics.memory import autocorrelation, corrected, significant
from analysis.waves.record_reduction import FloatArray

CORE = 0.7
"""Part of the sets that the core has at first: up to 30 % of bad ones stay outside."""
STARTS = 60
"""Random starts; one without a bad set in 30 % has a chance of 12 % at p = 5, none of 60 one of .05 %."""
CONCENTRATIONS = 4
NAMED_RATE = 0.15
"""Chance that sets are named in a healthy baseline, at most: the widened core names about half as often."""
TREND_RATE = 0.02
"""Chance that a trend is named in a healthy baseline."""
Kind = Literal["outlier", "group", "trend"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Named:
    """Something of a baseline that a person should look at before approving it.

    Attributes
    ----------
    kind
        ``outlier``: one set far off; ``group``: several sets off alike (a re-seat, a knock, another gain);
        ``trend``: the sets wander one way from first to last.
    rows
        Rows of the vectors handed in; all of a trend.
    """

    kind: Kind
    rows: tuple[int, ...]


def named_in(vectors: ArrayLike) -> tuple[Named, ...]:
    """Name what stands out of the sets of a baseline, shape (n, p), none missing, n above 2 p + 2."""
    x = np.asarray(vectors, dtype=np.float64)
    found: list[Named] = []
    core = grown_core(x)
    outside = np.flatnonzero(~core)
    if outside.size:
        whitened = _whitened(x, core)
        alike = _alike(whitened, outside)
        if alike.size:
            found.append(Named(kind="group", rows=tuple(alike.tolist())))
        found += [Named(kind="outlier", rows=(row,)) for row in outside.tolist() if row not in alike]
    if trend_probability(x[core], np.flatnonzero(core)) < TREND_RATE:
        found.append(Named(kind="trend", rows=tuple(range(len(x)))))
    return tuple(found)


def grown_core(x: FloatArray) -> np.ndarray:
    """Tell which sets fit the rest, shape (n,), True for those that do."""
    n, p = x.shape
    core = _least_determinant(x)
    limit_rate = NAMED_RATE / n
    for _ in range(n):
        m = int(core.sum())
        inside = scipy.special.chdtri(p, 1.0 - m / n) if m < n else math.inf
        # The core's covariance is that of a normal distribution cut at its edge (Croux and Haesbroeck 1999).
        widened = (m / n) / float(scipy.special.chdtr(p + 2, inside)) if m < n else 1.0
        distances = (_whitened(x, core) ** 2).sum(axis=1) / widened
        grown = distances <= f_predictive_limit(m, p, limit_rate)
        if (grown == core).all() or grown.sum() <= m // 2:
            break
        core = grown
    return core


def _least_determinant(x: FloatArray) -> np.ndarray:
    """Find the part of the sets with the least covariance: random starts, concentrated (Rousseeuw 1999)."""
    n, p = x.shape
    size = max(math.ceil(CORE * n), p + 2)
    rng = np.random.default_rng(n * 1000 + p)  # the same sets always give the same names
    picks = np.argsort(rng.random((STARTS, n)), axis=1)[:, : p + 1]
    for _ in range(CONCENTRATIONS):
        chosen = x[picks]
        mean = chosen.mean(axis=1, keepdims=True)
        centred = chosen - mean
        covariance = np.einsum("sij,sik->sjk", centred, centred) / (chosen.shape[1] - 1)
        away = x[None] - mean
        distances = np.einsum("sij,sij->si", away @ np.linalg.pinv(covariance), away)
        picks = np.argpartition(distances, size - 1, axis=1)[:, :size]
    chosen = x[picks] - x[picks].mean(axis=1, keepdims=True)
    _, volume = np.linalg.slogdet(np.einsum("sij,sik->sjk", chosen, chosen))
    core = np.zeros(n, dtype=bool)
    core[picks[int(np.argmin(volume))]] = True
    return core


def _whitened(x: FloatArray, core: np.ndarray) -> FloatArray:
    """All sets in units of the core's scatter, shape (n, p)."""
    mean = x[core].mean(axis=0)
    root = np.linalg.cholesky(np.atleast_2d(np.cov(x[core], rowvar=False)))
    return np.asarray(np.linalg.solve(root, (x - mean).T).T)


def _alike(whitened: FloatArray, outside: np.ndarray) -> np.ndarray:
    """Find those outside that are off alike: nearer to their middle than that is to the core."""
    if outside.size < 3:
        return outside[:0]
    middle = np.median(whitened[outside], axis=0)
    near = np.linalg.norm(whitened[outside] - middle, axis=1) < 0.5 * np.linalg.norm(middle)
    return outside[near] if near.sum() >= 3 else outside[:0]


def trend_probability(x: FloatArray, rows: ArrayLike) -> float:
    """Chance of such a trend over the rows in sets without one, by Hotelling's test of the slopes.

    Memory lets healthy sets wander: the slopes' variance is (1 + phi)/(1 - phi) times that of independent
    ones.
    """
    t = np.asarray(rows, dtype=np.float64)
    n, p = x.shape
    t = t - t.mean()
    z = x - x.mean(axis=0)
    slope = t @ z / (t @ t)
    rest = z - t[:, None] * slope
    covariance = rest.T @ rest / (n - 2)
    phi = significant(float(corrected(autocorrelation(rest, 1).mean(), n)), n)
    try:
        size = float(slope @ np.linalg.solve(covariance, slope))
    except np.linalg.LinAlgError:  # a feature is a straight line, such as the hour
        return 0.0
    statistic = size * float(t @ t) * (1.0 - phi) / (1.0 + phi)
    return float(scipy.special.fdtrc(p, n - 1 - p, statistic * (n - 1 - p) / (p * (n - 2))))
