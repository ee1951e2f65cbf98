"""Limits for the Mahalanobis squared distance of a new set, each with its name and realised rate.

A limit depends on n, the sets of the baseline, because mean and covariance are estimated from them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # `scipy.special`, slow to import, comes when a limit is asked for
from numpy.typing import ArrayLike

from analysis.errors import InvalidInputError, NotEnoughSetsError
from analysis.statistics.rules import NOMINAL_RATE

PAPER_MEAN_3SD = "paper_mean_3sd"
F_PREDICTIVE = "f_predictive"


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """Limit of the squared distance.

    Attributes
    ----------
    name
        `F_PREDICTIVE` or `PAPER_MEAN_3SD`.
    distance_squared
        The set is an outlier above this.
    false_alarm_rate
        Chance that a healthy set exceeds it: independent normal sets, averaged over baselines of this n.
    """

    name: str
    distance_squared: float
    false_alarm_rate: float


def _require_enough_sets(n: int, p: int) -> None:
    """Raise InvalidInputError for p below 1, NotEnoughSetsError for n sets of up to p features."""
    if p < 1:
        raise InvalidInputError(f"p is {p}; a distance needs at least one feature")
    if n <= p:
        raise NotEnoughSetsError(
            f"{n} sets for {p} features; the limit exists only for more sets than features"
        )


def predictive_scale(n: int, p: int) -> float:
    """Return the ratio of the squared distance of a new normal set to F(p, n - p): p (n+1)(n-1)/(n (n-p)).

    n is the number of sets of the baseline, above p, the number of features.
    """
    return p * (n + 1) * (n - 1) / (n * (n - p))


def f_predictive_limit(n: int, p: int, rate: float = NOMINAL_RATE) -> float:
    """Return the exact limit for a new normal set: p (n+1)(n-1) / (n (n-p)) F(1 - rate; p, n - p).

    n is the number of sets of the baseline, p of features, ``rate`` the false-alarm rate. Source: Tracy,
    Young and Mason (1992), "Multivariate control charts for individual observations", Journal of Quality
    Technology 24(2), 88-95, doi:10.1080/00224065.1992.12015232.

    Raises
    ------
    InvalidInputError
        ``rate`` outside (0, 1) or ``p`` below 1.
    NotEnoughSetsError
        ``n`` not above ``p``.
    """
    _require_enough_sets(n, p)
    if not 0.0 < rate < 1.0:
        raise InvalidInputError(f"rate is {rate}; it must lie between 0 and 1")
    return float(predictive_scale(n, p) * scipy.special.fdtri(p, n - p, 1.0 - rate))


def false_alarm_rate(limit: float, n: int, p: int) -> float:
    """Return the chance that a new healthy normal set exceeds ``limit``, averaged over baselines of n sets.

    A negative limit counts as 0. Raise InvalidInputError for p below 1, NotEnoughSetsError for n up to p.
    """
    _require_enough_sets(n, p)
    return float(scipy.special.fdtrc(p, n - p, max(limit, 0.0) / predictive_scale(n, p)))


def paper_limit(baseline_distances_squared: ArrayLike) -> float:
    """Return the paper's limit: mean + 3 SD of the baseline's own distances (section 4, below eq. 16).

    That the paper means this, with n - 1 in the SD, is our reading. Its realised rate is far above the stated
    .27 %: the baseline's own distances are bounded and the SD is not that of a normal variable.

    Parameters
    ----------
    baseline_distances_squared
        Shape (n,).

    Raises
    ------
    NotEnoughSetsError
        Fewer than two distances.
    """
    distances = np.asarray(baseline_distances_squared, dtype=np.float64)
    if distances.ndim != 1 or distances.size < 2:
        raise NotEnoughSetsError(f"distances of shape {distances.shape}; mean and SD need at least two")
    return float(distances.mean() + 3.0 * distances.std(ddof=1))


def phase_one_limit(n: int, p: int, rate: float = 0.05) -> float:
    """Return the limit for the baseline's own sets: (n-1)^2 / n Beta(1 - rate/n; p/2, (n-p-1)/2).

    ``rate`` is the chance that any of the n healthy sets of p features exceeds it (Bonferroni). Source as for
    `f_predictive_limit`. Raise NotEnoughSetsError for n up to p + 1, InvalidInputError for p below 1 or a
    rate outside (0, 1).
    """
    _require_enough_sets(n, p)
    if n <= p + 1:
        raise NotEnoughSetsError(
            f"{n} sets for {p} features; a screen of the baseline needs at least {p + 2}"
        )
    if not 0.0 < rate < 1.0:
        raise InvalidInputError(f"rate is {rate}; it must lie between 0 and 1")
    return float((n - 1) ** 2 / n * scipy.special.betaincinv(p / 2, (n - p - 1) / 2, 1.0 - rate / n))


def compute_limit_pair(
    baseline_distances_squared: ArrayLike, p: int, rate: float = NOMINAL_RATE
) -> tuple[Limit, Limit]:
    """Return the predictive F limit and the paper's, in this order, for a baseline of p features.

    The paper limit's rate treats its value as fixed before the baseline was taken: a good guide, not exact.
    Raise NotEnoughSetsError for n up to p or below 2, InvalidInputError for p below 1 or a rate outside (0,
    1).
    """
    distances = np.asarray(baseline_distances_squared, dtype=np.float64)
    n = distances.size
    exact, paper = f_predictive_limit(n, p, rate), paper_limit(distances)
    return (
        Limit(name=F_PREDICTIVE, distance_squared=exact, false_alarm_rate=rate),
        Limit(name=PAPER_MEAN_3SD, distance_squared=paper, false_alarm_rate=false_alarm_rate(paper, n, p)),
    )
