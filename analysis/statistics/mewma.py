"""Control charts for slow changes: MEWMA with its limit for a wanted run length, and Crosier's MCUSUM.

Both take whitened vectors: independent, with covariance 1 while the sensor is healthy.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import scipy  # its parts come when asked for: they are slow to import
from numpy.typing import ArrayLike

from analysis.errors import InvalidInputError
from analysis.statistics.limits import f_predictive_limit
from analysis.waves.record_reduction import FloatArray

WEIGHT = 0.1
"""Lambda: a slow change, some hundred sets long, is seen soonest."""
NODES, NODES_PER_SD = 40, 3.0
"""Of the integral equation, at least, and in its length; 20 are not enough for run lengths of tens of
thousands, nor 40 for a hundred features."""
LONGEST = 1e12
"""Average run length beyond which the equation is singular to rounding."""
REFERENCE = 1.0
"""k of Crosier's MCUSUM: it is made for shifts of 2."""


@lru_cache(maxsize=64)
def average_run_length(limit: float, p: int, weight: float = WEIGHT) -> float:
    """Return the mean number of sets until a healthy sensor exceeds ``limit``: known baseline, zero start.

    Rigdon's integral equation for the squared radius of the average, solved by Gauss-Legendre quadrature in
    the radius itself. Source: Rigdon (1995), "An integral equation for the in-control average run length of a
    multivariate exponentially weighted moving average control chart", J. Statist. Comput. Simul. 52, 351-365.
    At most 1e12 is returned. Raise InvalidInputError for a limit, p or weight out of range.
    """
    if not (limit > 0.0 and p >= 1 and 0.0 < weight <= 1.0):
        raise InvalidInputError(
            f"limit {limit}, p {p}, weight {weight}: they must be above 0, at least 1, and within (0, 1]"
        )
    radius = math.sqrt(limit * weight / (2.0 - weight))
    nodes, weights = np.polynomial.legendre.leggauss(max(NODES, math.ceil(NODES_PER_SD * radius / weight)))
    r = 0.5 * radius * (nodes + 1.0)
    w = 0.5 * radius * weights * 2.0 * r / weight**2
    x, stay = r / weight, (1.0 - weight) / weight

    def density(start: FloatArray) -> FloatArray:
        """Return the density of non-central chi-square, p degrees of freedom, shape (starts, nodes)."""
        root, order = np.maximum(stay * start, 1e-12)[:, None], 0.5 * p - 1.0
        powers = order * np.log(x / root) + _log_bessel(order, root * x)
        return np.asarray(0.5 * np.exp(powers - 0.5 * (x - root) ** 2))

    lengths = np.linalg.solve(np.eye(r.size) - density(r) * w, np.ones(r.size))
    average = float(1.0 + ((density(np.zeros(1)) * w) @ lengths)[0])
    return average if 1.0 <= average < LONGEST else LONGEST


def _log_bessel(order: float, z: FloatArray) -> FloatArray:
    """Return the logarithm of exp(-z) I_order(z), also where the function underflows (many features).

    There by its uniform expansion for large orders, Abramowitz and Stegun (1964), 9.7.7.
    """
    bessel = scipy.special.ive(order, z)
    small = bessel == 0.0
    result = np.log(np.where(small, 1.0, bessel))
    t = z[small] / order
    s = 1.0 / np.sqrt(1.0 + t**2)
    eta = 1.0 / s + np.log(t / (1.0 + 1.0 / s))
    first = np.log1p((3.0 * s - 5.0 * s**3) / (24.0 * order))
    result[small] = order * (eta - t) - 0.5 * np.log(2.0 * math.pi * order / s) + first
    return np.asarray(result)


@lru_cache(maxsize=64)
def known_limit(p: int, run_length: float, weight: float = WEIGHT) -> float:
    """Return the MEWMA limit for a known baseline and a mean healthy run length of ``run_length`` sets.

    Raise InvalidInputError unless ``run_length`` exceeds 1.
    """
    if not run_length > 1.0:
        raise InvalidInputError(f"run_length is {run_length}; it must be more than 1 set")
    chi_square = float(scipy.special.chdtri(p, 1.0 / run_length))
    return float(
        scipy.optimize.brentq(
            lambda limit: math.log(average_run_length(limit, p, weight) / run_length),
            *(1e-3 * chi_square, 1.5 * chi_square),
            xtol=1e-9,
        )
    )


def estimated_limit(n: int, p: int, run_length: float, weight: float = WEIGHT) -> float:
    """Return the MEWMA limit for a baseline of ``n`` sets: wider, since mean and covariance are estimates.

    h_n = h_inf F(n, 1/ARL)/chi2(1/ARL) [1 + (2 - weight)/(weight n)], ARL the ``run_length`` in sets: the
    ratio allows for the covariance's error, the bracket for the mean's, which enters the average in full.
    Raise NotEnoughSetsError for n up to p, InvalidInputError unless ``run_length`` exceeds 1.
    """
    rate = 1.0 / run_length
    widened = f_predictive_limit(n, p, rate) / float(scipy.special.chdtri(p, rate))
    return known_limit(p, run_length, weight) * widened * (1.0 + (2.0 - weight) / (weight * n))


def compute_averages(whitened: ArrayLike, start: ArrayLike, weight: float = WEIGHT) -> FloatArray:
    """Return the exponential averages z_t = weight w_t + (1 - weight) z_(t-1), shape (n, p), from ``start``.

    ``start``, shape (p,), is z before the first row of ``whitened``. No value may be missing.
    """
    w = np.asarray(whitened, dtype=np.float64)
    before = (1.0 - weight) * np.asarray(start, dtype=np.float64)[None, :]
    filtered, _ = scipy.signal.lfilter([weight], [1.0, weight - 1.0], w, axis=0, zi=before)
    return np.asarray(filtered)


def mewma(whitened: ArrayLike, weight: float = WEIGHT) -> FloatArray:
    """Return the MEWMA statistic (2 - weight)/weight |z_t|^2 of whitened sets from z = 0, shape (n,).

    A row with a NaN gives NaN and does not change z.
    """
    w = np.asarray(whitened, dtype=np.float64)
    complete = np.isfinite(w).all(axis=1)
    result = np.full(w.shape[0], np.nan)
    z = compute_averages(w[complete], np.zeros(w.shape[1]), weight)
    result[complete] = (2.0 - weight) / weight * (z**2).sum(axis=1)
    return result


def mcusum(whitened: ArrayLike, reference: float = REFERENCE) -> FloatArray:
    """Return Crosier's MCUSUM statistic of whitened sets, shape (n,): max(0, C - k), C = |s + w|.

    The sum s starts from 0 and is shrunk by k, ``reference``, each set. A row with a NaN gives NaN and leaves
    s unchanged.
    Source: Crosier (1988), "Multivariate generalizations of cumulative sum quality-control schemes",
    Technometrics 30, 291-303.
    """
    w = np.asarray(whitened, dtype=np.float64)
    result = np.full(w.shape[0], np.nan)
    s = [0.0] * w.shape[1]
    for index in np.flatnonzero(np.isfinite(w).all(axis=1)).tolist():
        s = [a + b for a, b in zip(s, w[index].tolist(), strict=True)]
        length = math.hypot(*s)
        shrunk = max(0.0, length - reference)
        s = [a * (shrunk / length) for a in s] if shrunk > 0.0 else [0.0] * len(s)
        result[index] = shrunk
    return result
