"""Baseline check: gross outliers, a group of sets with a common offset, a trend.

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
from analysis.statistics.memory import autocorrelation, corrected_autocorrelation, significant_phi
from analysis.waves.record_reduction import FloatArray

CORE = 0.7
"""Part of the sets that the core has at first: up to 30 % of bad ones stay outside."""
STARTS = 60
"""Random starts; one without a bad set in 30 % has a chance of 12 % at p = 5, none of 60 one of .05 %."""
CONCENTRATIONS = 4
CUT_RATE = 0.025
"""Part of the healthy sets that a grown core leaves outside."""
GROWTHS = 10
FEW_ALIKE, MANY_ALIKE = 3, 5
"""Sets that make a group: of those that do not fit, and of those that are only not near."""
NAMED_RATE = 0.02
"""Chance that a healthy set is named if the core were known; that it was chosen makes it some .04."""
ALIKE = 0.6
"""Distance from the middle of a group, in that of the middle from the core."""
TREND_RATE = 0.015
"""Chance that a trend is named in a healthy baseline."""
Kind = Literal["outlier", "group", "trend"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Anomaly:
    """Anomaly of a baseline that a person should check before approval.

    Attributes
    ----------
    kind
        ``outlier``: one set far off; ``group``: several sets off alike (a re-seat, a knock, another gain);
        ``trend``: the sets drift in one direction from first to last.
    rows
        Rows of the vectors handed in; all of a trend.
    """

    kind: Kind
    rows: tuple[int, ...]


def find_anomalies(vectors: ArrayLike) -> tuple[Anomaly, ...]:
    """Find a group, outliers and a trend among the sets of a baseline, in this order; empty if there is none.

    ``vectors`` has shape (n, p) with no value missing and n above 2 p + 2. Raise LinAlgError if most sets do
    not scatter in some direction.
    """
    x = np.asarray(vectors, dtype=np.float64)
    found: list[Anomaly] = []
    near, core = find_core_sets(x)
    outside = np.flatnonzero(~core)
    if not near.all():
        whitened = _whiten_by_core(x, core)
        group = _find_group(whitened, np.flatnonzero(~near), MANY_ALIKE)
        if not group.size:
            group = _find_group(whitened, outside, FEW_ALIKE)
        if group.size:
            found.append(Anomaly(kind="group", rows=tuple(group.tolist())))
        found += [Anomaly(kind="outlier", rows=(row,)) for row in outside.tolist() if row not in group]
    if compute_trend_p_value(x[core], np.flatnonzero(core)) < TREND_RATE:
        found.append(Anomaly(kind="trend", rows=tuple(range(len(x)))))
    return tuple(found)


def find_core_sets(x: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Return two masks, shape (n,): sets in a robust core of x, shape (n, p), and sets that fit it.

    The core starts as 70 % of the sets and becomes those within the 97.5 % limit around it until it no longer
    changes. Grown at once by all that fit, it would take in a group: few sets or many features determine it
    too poorly. Raise LinAlgError if the core does not scatter in some direction.
    """
    n, p = x.shape
    core, kept = _minimum_covariance_determinant(x), CORE
    for _ in range(GROWTHS):
        near = _distances_from_core(x, core, kept) <= f_predictive_limit(int(core.sum()), p, CUT_RATE)
        if near.sum() <= max(n // 2, p + 1) or (near == core).all():
            break
        core, kept = near, 1.0 - CUT_RATE
    fits = _distances_from_core(x, core, kept) <= f_predictive_limit(int(core.sum()), p, NAMED_RATE / n)
    return core, np.asarray(fits)


def _distances_from_core(x: FloatArray, core: np.ndarray, kept: float) -> FloatArray:
    """Return squared distances, shape (n,), from a core of the nearest fraction ``kept`` of healthy sets.

    The core's covariance is that of a normal distribution cut at its edge (Croux and Haesbroeck 1999). Raise
    LinAlgError if it is singular.
    """
    p = x.shape[1]
    inside = float(scipy.special.chdtr(p + 2, scipy.special.chdtri(p, 1.0 - kept)))
    return np.asarray((_whiten_by_core(x, core) ** 2).sum(axis=1) * inside / kept)


def _minimum_covariance_determinant(x: FloatArray) -> np.ndarray:
    """Find the 70 % of the sets, rows of x, whose covariance has the smallest determinant; mask, shape (n,).

    They are at least p + 2, found from 60 random starts, concentrated (Rousseeuw 1999). The random seed
    depends only on n and p, so equal sets give the same subset.
    """
    n, p = x.shape
    size = max(math.ceil(CORE * n), p + 2)
    rng = np.random.default_rng(n * 1000 + p)  # the same sets always give the same names
    picks = np.argsort(rng.random((STARTS, n)), axis=1)[:, : p + 1]
    for _ in range(CONCENTRATIONS):
        chosen = x[picks]
        mean = chosen.mean(axis=1, keepdims=True)
        centred = chosen - mean
        covariance = np.einsum("sij,sik->sjk", centred, centred) / (chosen.shape[1] - 1)
        deviations = x[None] - mean
        distances = np.einsum("sij,sij->si", deviations @ np.linalg.pinv(covariance), deviations)
        picks = np.argpartition(distances, size - 1, axis=1)[:, :size]
    chosen = x[picks] - x[picks].mean(axis=1, keepdims=True)
    _, volume = np.linalg.slogdet(np.einsum("sij,sik->sjk", chosen, chosen))
    core = np.zeros(n, dtype=bool)
    core[picks[int(np.argmin(volume))]] = True
    return core


def _whiten_by_core(x: FloatArray, core: np.ndarray) -> FloatArray:
    """Transform all sets to units of the core's scatter, shape (n, p), by Cholesky whitening.

    Raise LinAlgError if the core's covariance is singular.
    """
    mean = x[core].mean(axis=0)
    root = np.linalg.cholesky(np.atleast_2d(np.cov(x[core], rowvar=False)))
    return np.asarray(np.linalg.solve(root, (x - mean).T).T)


def _find_group(whitened: FloatArray, outside: np.ndarray, fewest: int) -> np.ndarray:
    """Find the rows of outlying sets with a common offset; empty if fewer than ``fewest`` have one.

    ``outside`` are the rows of the outlying sets. Those of a group are nearer to the median of all of them
    than 0.6 times its distance from the core.
    """
    if outside.size < fewest:
        return outside[:0]
    middle = np.median(whitened[outside], axis=0)
    near = np.linalg.norm(whitened[outside] - middle, axis=1) < ALIKE * np.linalg.norm(middle)
    return outside[near] if near.sum() >= fewest else outside[:0]


def compute_trend_p_value(x: FloatArray, rows: ArrayLike) -> float:
    """Return the p-value of a linear trend of x, shape (n, p), over its rows (Hotelling's test of slopes).

    Autocorrelated healthy sets drift slowly: the variance of the slopes is (1 + phi)/(1 - phi) times that of
    independent sets. Return 0 if the residual covariance is singular.
    """
    t = np.asarray(rows, dtype=np.float64)
    n, p = x.shape
    t = t - t.mean()
    z = x - x.mean(axis=0)
    slope = t @ z / (t @ t)
    rest = z - t[:, None] * slope
    try:
        root = np.linalg.cholesky(rest.T @ rest / (n - 2))
        slope, rest = np.linalg.solve(root, slope), np.linalg.solve(root, rest.T).T
    except np.linalg.LinAlgError:  # a feature is a straight line, such as the hour
        return 0.0
    phi = significant_phi(float(corrected_autocorrelation(autocorrelation(rest, 1).mean(), n)), n)
    statistic = float(slope @ slope) * float(t @ t) * (1.0 - phi) / (1.0 + phi)
    return float(scipy.special.fdtrc(p, n - 1 - p, statistic * (n - 1 - p) / (p * (n - 2))))
