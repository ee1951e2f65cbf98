"""Scatter of healthy sets in excess of a normal distribution, and a limit that allows for it."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import scipy  # `scipy.special` comes when asked for
from numpy.typing import ArrayLike

from analysis.statistics.limits import predictive_scale
from analysis.statistics.rules import NOMINAL_RATE
from analysis.waves.record_reduction import FloatArray

HEAVY = 1.5
"""Tails are heavy where the limit that allows for them is larger than the F limit by this factor."""
FEWEST_DEGREES = 2.5
"""Of the fitted tail: below, it would have no mean."""
CAUTION, LEAST_CAUTION, MOST_CAUTION = 0.1, 0.5, 1.2
"""Standard errors, a feature, by which the tail is taken to be longer than found: the rate's average over
baselines is above that of the average tail, and one feature's own jump is the smaller a part of the usual
distance the more features there are. Chosen by simulation of two kinds of t5: sets that are far off as a
whole, and features each by itself (`tests/validation/test_budget_of_false_alarms.py`)."""
UPPER_HALF = 0.5 + (np.arange(200) + 0.5) / 400


def left_out_distances(distances_squared: ArrayLike) -> FloatArray:
    """Return the squared distance of each baseline set from the baseline of the others, shape (n,).

    From D with n sets by the formula of Sherman and Morrison, u = D/(n - 1):
    (n/(n - 1))^2 (n - 2) u/(1 - n u/(n - 1)).
    """
    d = np.asarray(distances_squared, dtype=np.float64)
    n = d.size
    u = d / (n - 1)
    return np.asarray((n / (n - 1)) ** 2 * (n - 2) * u / (1.0 - n * u / (n - 1)))


def tail_limit(distances_squared: ArrayLike, p: int, rate: float = NOMINAL_RATE) -> float:
    """Return the limit of the squared distance from an F distribution fitted to the left-out distances.

    ``distances_squared`` are those of the baseline's n sets of p features, ``rate`` is the false-alarm rate
    of one set. Of normal sets each left-out distance over its scale is F(p, n - 1 - p). Fitted are a factor
    and the denominator's degrees of freedom, at most these, by the median of the logarithm and by how far its
    upper half reaches beyond on average: the small distances of few features hold no information on the tail,
    and one gross set hardly affects the fit.
    """
    d = np.asarray(distances_squared, dtype=np.float64)
    n = d.size
    logs = np.sort(np.log(np.maximum(left_out_distances(d) / predictive_scale(n - 1, p), 1e-300)))
    middle, upper = float(np.median(logs)), logs[n // 2 :]
    caution = min(max(CAUTION * p, LEAST_CAUTION), MOST_CAUTION)
    reach = float(upper.mean()) - middle + caution * float(upper.std(ddof=1)) / math.sqrt(upper.size)
    per_degree, reaches, middles = _tabulate_log_f(n, p)
    inverse = float(np.interp(reach, reaches, per_degree))
    factor = math.exp(middle - float(np.interp(inverse, per_degree, middles)))
    return float(predictive_scale(n, p) * factor * scipy.special.fdtri(p, 1.0 / inverse, 1.0 - rate))


@lru_cache(maxsize=64)
def _tabulate_log_f(n: int, p: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Tabulate log F(p, v), v falling from n - 1 - p: 1/v, mean of the upper half less the median, median.

    Three arrays of shape (25,), the first two ascending; v ends at 2.5.
    """
    most = max(float(n - 1 - p), FEWEST_DEGREES)
    per_degree = np.linspace(1.0 / most, 1.0 / FEWEST_DEGREES, 25)
    logs = np.log(scipy.special.fdtri(p, 1.0 / per_degree[:, None], UPPER_HALF))
    middles = np.log(scipy.special.fdtri(p, 1.0 / per_degree, 0.5))
    return per_degree, logs.mean(axis=1) - middles, middles
