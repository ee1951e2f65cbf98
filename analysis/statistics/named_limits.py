"""All limits by name: the meaning of each, the statistic it bounds, and its computation from a baseline.

A further limit is a function and an entry here: it is computed, stored with baselines and
assessments, and shown wherever limits are listed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import scipy  # `scipy.special` comes when asked for

from analysis.statistics.baseline import Baseline
from analysis.statistics.chart import Chart
from analysis.statistics.default_limit import DefaultLimit
from analysis.statistics.limits import F_PREDICTIVE, PAPER_MEAN_3SD, f_predictive_limit, paper_limit
from analysis.statistics.mewma import estimated_limit, known_limit

DISTANCE, PREWHITENED, AVERAGE, MEWMA = (
    "distance_squared",
    "distance_squared_prewhitened",
    "mewma_textbook",
    "mewma",
)
STATISTICS: Mapping[str, str] = MappingProxyType(
    {
        DISTANCE: "Squared Mahalanobis distance of the set from the baseline",
        PREWHITENED: "The same after the baseline's memory from set to set was taken out",
        AVERAGE: "MEWMA of the whitened sets, weight 0.1, asymptotic covariance",
        MEWMA: "The same with memory taken out and each set cut back to the F limit of 1 %",
    }
)
"""What limits bound, by name, in words."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Facts:
    """Properties of a baseline that a limit may depend on.

    Attributes
    ----------
    rate
        Chance that a healthy set lies beyond, of limits that assess single sets.
    run_length
        Sets from one false alarm to the next, of limits that keep a budget.
    """

    baseline: Baseline
    by_default: DefaultLimit
    chart: Chart
    rate: float
    run_length: float


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedLimit:
    """Limit with a name: ``value`` computes it, ``of`` is one of `STATISTICS`, ``unit`` that of both.

    ``caveat`` says what it does not keep; empty: nothing. It ends ``words``.
    """

    words: str
    of: str
    value: Callable[[Facts], float]
    unit: str = "1"
    caveat: str = ""


def _chi_square_limit(facts: Facts) -> float:
    """Return the chi-square limit of the squared distance at the false-alarm rate."""
    return float(scipy.special.chdtri(facts.baseline.p, facts.rate))


PAPER_RATE = (
    "of healthy sets of five features 13 % exceed it with 24 baseline sets, 5 % with 48 and 2 % with "
    "200, where 0.27 % was meant"
)
"""Measured on simulated sets by `tests/validation/test_false_alarm_limits.py`."""

LIMITS: Mapping[str, NamedLimit] = MappingProxyType(
    {
        PAPER_MEAN_3SD: NamedLimit(
            words=f"the paper's: mean + 3 SD of the baseline's own distances; {PAPER_RATE}",
            caveat=PAPER_RATE,
            of=DISTANCE,
            value=lambda facts: paper_limit(facts.baseline.distances_squared),
        ),
        "chi_square": NamedLimit(
            words="that of chi-square, for a baseline known exactly", of=DISTANCE, value=_chi_square_limit
        ),
        F_PREDICTIVE: NamedLimit(
            words="the predictive F limit for a new set of a healthy wall",
            of=DISTANCE,
            value=lambda facts: f_predictive_limit(facts.baseline.n, facts.baseline.p, facts.rate),
        ),
        "f_budget": NamedLimit(
            words="the predictive F limit at the rate of the budget of false alarms",
            of=DISTANCE,
            value=lambda facts: f_predictive_limit(
                facts.baseline.n, facts.baseline.p, 1.0 / facts.run_length
            ),
        ),
        "phase_one": NamedLimit(
            words="the screen of the baseline's own sets: 5 % of healthy baselines have one above it",
            of=DISTANCE,
            value=lambda facts: facts.baseline.suspect_limit,
        ),
        "mewma_known": NamedLimit(
            words="that of the textbook's MEWMA for a baseline known exactly, at the budget",
            of=AVERAGE,
            value=lambda facts: known_limit(facts.baseline.p, facts.run_length),
        ),
        "mewma_textbook": NamedLimit(
            words="that of the textbook's MEWMA, widened for an estimated baseline, at the budget",
            of=AVERAGE,
            value=lambda facts: estimated_limit(facts.baseline.n, facts.baseline.p, facts.run_length),
        ),
        "default": NamedLimit(
            words="chosen by the data: it allows for the baseline's memory and tails",
            of=PREWHITENED,
            value=lambda facts: facts.by_default.limit,
        ),
        MEWMA: NamedLimit(
            words="that of the chart that keeps the budget of false alarms",
            of=MEWMA,
            value=lambda f: f.chart.limit,
        ),
    }
)
"""By name, in the order in which they are listed."""


def compute_limits(facts: Facts) -> dict[str, float]:
    """Compute every one of `LIMITS` for a baseline, by name in the order in which they are listed.

    Raise InvalidInputError unless the rate is in (0, 1) and the run length exceeds 1.
    """
    return {name: limit.value(facts) for name, limit in LIMITS.items()}
