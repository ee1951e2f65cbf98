"""How far the healthy sets scatter beyond a normal distribution, and a limit that allows for it."""

from __future__ import annotations

import numpy as np
import scipy  # `scipy.special` and `scipy.optimize` come when asked for
from numpy.typing import ArrayLike

from analysis.statistics.limits import predictive_scale
from analysis.statistics.rules import NOMINAL_RATE
from analysis.waves.record_reduction import FloatArray

HEAVY = 1.5
"""Tails are heavy where the limit that allows for them is larger than the F limit by this factor."""
FEWEST_DEGREES = 2.5
"""Of the fitted tail: below, it would have no mean."""


def left_out_distances(distances_squared: ArrayLike) -> FloatArray:
    """Squared distance of each baseline set from the baseline of the others, shape (n,).

    From D with n sets by the formula of Sherman and Morrison, u = D/(n - 1):
    (n/(n - 1))^2 (n - 2) u/(1 - n u/(n - 1)).
    """
    d = np.asarray(distances_squared, dtype=np.float64)
    n = d.size
    u = d / (n - 1)
    return np.asarray((n / (n - 1)) ** 2 * (n - 2) * u / (1.0 - n * u / (n - 1)))


def tail_limit(distances_squared: ArrayLike, p: int, rate: float = NOMINAL_RATE) -> float:
    """Limit by a scaled F distribution fitted to the left-out distances of the baseline's own sets.

    Of normal sets each left-out distance over its scale is F(p, n - 1 - p). Fitted are a factor and the
    denominator's degrees of freedom, at most these, by mean and variance of the logarithm: one gross set does
    not carry the fit away.
    """
    d = np.asarray(distances_squared, dtype=np.float64)
    n = d.size
    logs = np.log(np.maximum(left_out_distances(d) / predictive_scale(n - 1, p), 1e-300))
    psi = scipy.special.digamma
    spread = float(logs.var(ddof=1)) - _trigamma(p / 2)
    most = float(n - 1 - p)
    if spread <= _trigamma(most / 2):
        degrees = most
    elif spread >= _trigamma(FEWEST_DEGREES / 2):
        degrees = FEWEST_DEGREES
    else:
        degrees = float(scipy.optimize.brentq(lambda v: _trigamma(v / 2) - spread, FEWEST_DEGREES, most))
    expected = psi(p / 2) - np.log(p / 2) - psi(degrees / 2) + np.log(degrees / 2)
    factor = float(np.exp(logs.mean() - expected))
    return float(predictive_scale(n, p) * factor * scipy.special.fdtri(p, degrees, 1.0 - rate))


def _trigamma(x: float) -> float:
    return float(scipy.special.polygamma(1, x))
