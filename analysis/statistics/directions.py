"""Directions of autocorrelation of healthy sets: invariant under linear mixtures of the features.

Features that share their scatter hide memory: a direction of little variance may remember much that no
feature shows. So the sets are whitened and turned to where they resemble the last one most, second most, and
so on (minimum/maximum autocorrelation factors), and each direction has its own memory.
Source: Switzer and Green (1984), "Min/max autocorrelation factors for multivariate spatial imagery",
Technical report 6, Department of Statistics, Stanford University.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.statistics.baseline import whitening_matrix
from analysis.statistics.memory import LARGEST_PHI, SIGNIFICANT
from analysis.statistics.mewma import WEIGHT
from analysis.waves.record_reduction import FloatArray

MOST_LAGS, SETS_PER_LAG = 20, 5
"""An average of weight .1 has forgotten 88 % after 20 sets; fewer than five sets a lag say nothing of it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Directions:
    """Directions and the autocorrelation along each.

    Attributes
    ----------
    matrix
        Shape (p, p): (vectors - mean) @ matrix has covariance 1; its columns are ordered by falling
        autocorrelation.
    phi
        From one set to the next, shape (p,).
    guarded
        The same, and at least what averages over the sets show of slower autocorrelation.
    error
        Standard error of artanh phi for sets with little autocorrelation; less where all directions are
        alike.
    """

    matrix: FloatArray
    phi: FloatArray
    guarded: FloatArray
    error: float


def find_directions(vectors: ArrayLike) -> Directions:
    """Find the directions of falling autocorrelation in sets, shape (n, p), in the order of time.

    Rows of NaN are gaps and keep their position.
    Raise SingularCovarianceError if a feature is a combination of the others.

    Autocorrelations scatter: of sets with equal ones along all directions, the largest and the smallest
    estimate are still far apart. That part of their spread is removed (shrinkage as by James and Stein).
    """
    x = np.asarray(vectors, dtype=np.float64)
    complete = np.asarray(np.isfinite(x).all(axis=1))
    n, p = int(complete.sum()), x.shape[1]
    z = x - x[complete].mean(axis=0)
    sd = z[complete].std(axis=0)
    correlation = np.atleast_2d(np.corrcoef(z[complete], rowvar=False))
    whitening = whitening_matrix(correlation) / sd[:, None]
    lags = max(1, min(MOST_LAGS, n // SETS_PER_LAG))
    found = _autocorrelations(np.where(complete[:, None], z @ whitening, 0.0), complete, lags)
    r, turn = np.linalg.eigh(found[0])
    # As `memory.corrected_autocorrelation`, before it is clipped.
    r, turn = (
        (n * r[::-1] + 1.0) / (n - 4.0),
        turn[:, ::-1],
    )
    middle = float(r.mean())
    variance = (1.0 - np.clip(middle, 0.0, LARGEST_PHI) ** 2) / n
    # Of the eigenvalues of a symmetric matrix with this variance on, and half of it next to its diagonal.
    by_chance = variance * (p - 1) * (p + 2) / (2 * p)
    spread = float(((r - middle) ** 2).mean())
    true_part = max(0.0, 1.0 - by_chance / spread) if spread > 0.0 else 0.0
    phi = np.clip(middle + true_part * (r - middle), 0.0, LARGEST_PHI)
    of_direction = np.einsum("ij,kil,lj->kj", turn, found, turn)
    together = compute_equivalent_phi(of_direction.mean(axis=1), n, directions=p)
    guarded = np.maximum(np.maximum(phi, together), compute_equivalent_phi(of_direction, n))
    return Directions(
        matrix=whitening @ turn,
        phi=phi,
        guarded=guarded,
        error=math.sqrt((true_part + 1.0 / p) / n),
    )


def _autocorrelations(whitened: FloatArray, complete: np.ndarray, lags: int) -> FloatArray:
    """Return the symmetric part of the autocorrelation at lags 1 to ``lags``, shape (lags, p, p).

    ``whitened`` has shape (n, p), with rows of 0 as gaps, where ``complete`` is False.
    """
    n, found = int(complete.sum()), []
    for lag in range(1, lags + 1):
        pairs = int((complete[lag:] & complete[:-lag]).sum())
        products = whitened[lag:].T @ whitened[:-lag] / max(1, pairs) * (n - lag) / n
        found.append(0.5 * (products + products.T))
    return np.stack(found)


def compute_equivalent_phi(autocorrelations: FloatArray, n: int, directions: int = 1) -> FloatArray:
    """Return the phi of the AR(1) process whose exponential averages have the same variance, at most 0.95.

    Their variance is I = 1 + 2 sum of (1 - weight)^k r_k times that of independent sets, and (1 + q)/(1 - q),
    q = (1 - weight) phi, for r_k = phi^k. Phi is 0 where I is not significant at 5 %, one-sided; shape (...).

    Parameters
    ----------
    autocorrelations
        At lags from 1 on, of n sets about their mean; shape (lags, ...).
    directions
        Averaged over so many.
    """
    weights = (1.0 - WEIGHT) ** np.arange(1, len(autocorrelations) + 1)
    kept = 1.0 - 2.0 * float(weights.sum()) / n  # of I, where n sets give the mean: r_k is less by I/n
    inflation = (1.0 + 2.0 * np.tensordot(weights, autocorrelations, axes=1)) / kept
    error = 2.0 * np.sqrt((weights**2).sum() / (n * directions)) / kept
    phi = (inflation - 1.0) / (np.maximum(inflation, 1.0) + 1.0) / (1.0 - WEIGHT)
    return np.where(inflation - 1.0 > SIGNIFICANT * error, np.minimum(phi, LARGEST_PHI), 0.0)
