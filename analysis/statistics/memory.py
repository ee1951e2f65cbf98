"""Autocorrelation of healthy sets from one set to the next, and its removal.

Phi is the coefficient of a first-order autoregression. Estimated from n sets it is too small by about
(1 + 4 phi)/n, more for a known trend of the mean; `corrected_autocorrelation` takes that out.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from analysis.errors import InvalidInputError
from analysis.waves.record_reduction import FloatArray

LARGEST_PHI = 0.95
SIGNIFICANT = 1.64
"""Times 1/sqrt(n): an autocorrelation of independent sets lies above in 5 %."""


def autocorrelation(vectors: ArrayLike, lag: int) -> FloatArray:
    """Return the autocorrelation of each feature at one lag in sets, shape (p,).

    Return 0 for a constant feature, and for all without a pair of complete sets at this lag. Raise
    InvalidInputError unless the lag is in 1..n - 1.

    Parameters
    ----------
    vectors
        Shape (n, p), a row per set in the order of time; rows with a NaN are gaps and keep their place.
    """
    x = np.asarray(vectors, dtype=np.float64)
    if x.ndim != 2 or not 1 <= lag < x.shape[0]:
        raise InvalidInputError(f"lag {lag} of vectors of shape {x.shape}; it must lie in 1..n - 1")
    complete = np.asarray(np.isfinite(x).all(axis=1))
    z = x - x[complete].mean(axis=0)
    pairs = complete[lag:] & complete[:-lag]
    n = int(complete.sum())
    if not pairs.any():
        return np.zeros(x.shape[1])
    products = (z[lag:][pairs] * z[:-lag][pairs]).mean(axis=0) * (n - lag) / n
    variance = (z[complete] ** 2).mean(axis=0)
    return np.asarray(np.divide(products, variance, out=np.zeros_like(products), where=variance > 0.0))


def corrected_autocorrelation(r: ArrayLike, n: int) -> FloatArray:
    """Return the autocorrelation without the bias from estimating the mean: (n r + 1)/(n - 4) within 0..0.95.

    ``r`` is the estimate at lag 1 from n sets, n above 4. Source: Marriott and Pope (1954), "Bias in the
    estimation of autocorrelations", Biometrika 41, 390-402.
    """
    return np.clip((n * np.asarray(r, dtype=np.float64) + 1.0) / (n - 4.0), 0.0, LARGEST_PHI)


def pooled_phi(vectors: ArrayLike) -> float:
    """Return the bias-corrected mean lag-1 autocorrelation of all features, 0 to 0.95.

    ``vectors`` has shape (n, p); rows with a NaN are gaps. Raise InvalidInputError for fewer than two rows.
    """
    n = int(np.isfinite(np.asarray(vectors)).all(axis=1).sum())
    return float(corrected_autocorrelation(autocorrelation(vectors, 1).mean(), n))


def significant_phi(phi: float, n: int) -> float:
    """Return ``phi`` if it exceeds 1.64/sqrt(n) (5 % one-sided test for n sets), else 0."""
    return phi if phi > SIGNIFICANT / math.sqrt(n) else 0.0


def effective_sets(n: int, phi: float) -> float:
    """Return the effective number of independent sets for the mean, n (1 - phi)/(1 + phi).

    ``phi`` is the lag-1 autocorrelation of n sets.
    """
    return n * (1.0 - phi) / (1.0 + phi)


def prewhiten_sets(vectors: ArrayLike, mean: ArrayLike, phi: ArrayLike) -> FloatArray:
    """Remove the dependence on the previous set: z_t - phi^k z_(t-k), scaled to one variance, z = x - mean.

    k is the distance to the last complete set, infinite for the first: over any gap, the result has
    (1 - phi^2) times the variance of z.

    Parameters
    ----------
    vectors
        Shape (n, p); rows with a NaN are gaps, and NaN in the result.
    phi
        A number, or one for each feature.
    """
    x = np.asarray(vectors, dtype=np.float64)
    phi = np.broadcast_to(np.asarray(phi, dtype=np.float64), x.shape[1:])
    complete = np.flatnonzero(np.isfinite(x).all(axis=1))
    z = x[complete] - np.asarray(mean)
    result = np.full_like(x, np.nan)
    if complete.size == 0:
        return result
    result[complete[0]] = z[0] * np.sqrt(1.0 - phi**2)
    result[complete[1:]] = innovation(z[1:], z[:-1], np.diff(complete)[:, None], phi)
    return result


def innovation(z: FloatArray, before: FloatArray, distance: ArrayLike, phi: ArrayLike) -> FloatArray:
    """Remove from deviations the dependence on those ``distance`` sets earlier, as `prewhiten_sets` does.

    Parameters
    ----------
    z, before
        Deviations from the mean, shape (p,) or (n, p).
    distance, phi
        At least 1; lag-1 autocorrelation, a number or shape (p,).
    """
    phi = np.asarray(phi, dtype=np.float64)
    power = phi ** np.asarray(distance)
    return np.asarray((z - power * before) * np.sqrt((1.0 - phi**2) / (1.0 - power**2)))
