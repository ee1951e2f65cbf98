"""Design of a frozen baseline: limits and chart for later sets, and the recursion from set to set.

`sequence` assesses a whole table at once by the same design; a test compares the two.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.statistics.baseline import Baseline
from analysis.statistics.chart import Chart, design_chart, explain_unverified_rate
from analysis.statistics.default_limit import DefaultLimit, default_limit
from analysis.statistics.distance import distance_squared
from analysis.statistics.memory import effective_sets, pooled_phi
from analysis.statistics.mewma import WEIGHT
from analysis.statistics.named_limits import AVERAGE, DISTANCE, MEWMA, PREWHITENED, Facts, compute_limits
from analysis.statistics.rules import NOMINAL_RATE
from analysis.waves.record_reduction import FloatArray

DAYS_PER_YEAR = 365.25


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """Design false-alarm budget of a healthy sensor.

    Attributes
    ----------
    alarms_per_year
        On average.
    sets_per_day
        The cadence.
    """

    alarms_per_year: float = 0.2
    sets_per_day: float = 24.0

    @property
    def run_length(self) -> float:
        """Return the average number of sets between two false alarms of the chart, at the given cadence."""
        return self.sets_per_day * DAYS_PER_YEAR / self.alarms_per_year


ONE_IN_FIVE_YEARS = Budget()
"""At a set an hour."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Design:
    """Limits and chart of one baseline.

    Attributes
    ----------
    limits
        By name (`named_limits.LIMITS`).
    phi_pooled, n_eff
        Lag-1 autocorrelation, and the effective number of independent sets of the baseline.
    rate_not_verified_reason
        Why the chart's rate of false alarms is not promised; empty: it is.
    """

    baseline: Baseline
    by_default: DefaultLimit
    chart: Chart
    limits: Mapping[str, float]
    phi_pooled: float
    n_eff: float
    rate_not_verified_reason: str


def build_design(
    history: FloatArray,
    baseline: Baseline,
    run_length: float,
    rate: float = NOMINAL_RATE,
    least_phi: ArrayLike = 0.0,
) -> Design:
    """Compute the outlier limits and the control chart of a baseline.

    Raise SingularCovarianceError if a feature is a combination of the others, and InvalidInputError unless
    ``run_length`` exceeds 1 and ``rate`` is in (0, 1).

    Parameters
    ----------
    history
        Sets of the baseline in the order of time, shape (n, p); rows of NaN are gaps and keep their place.
    baseline
        Fitted to its complete rows.
    run_length, rate
        See `named_limits.Facts`.
    least_phi
        See `chart.design_chart`.
    """
    chart, by_default = design_chart(history, run_length, least_phi), default_limit(history, baseline, rate)
    facts = Facts(baseline=baseline, by_default=by_default, chart=chart, rate=rate, run_length=run_length)
    phi = pooled_phi(history)
    return Design(
        baseline=baseline,
        by_default=by_default,
        chart=chart,
        limits=compute_limits(facts),
        phi_pooled=phi,
        n_eff=effective_sets(baseline.n, phi),
        rate_not_verified_reason=explain_unverified_rate(history),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartState:
    """State with which the next set is assessed.

    Attributes
    ----------
    index, vector
        Of the last complete set.
    averages
        Exponentially weighted vector of each chart, by its statistic's name.
    alarming
        The chart's alarm is on: it was beyond its limit, and is not back yet (`is_chart_alarm_active`).
    """

    index: int
    vector: tuple[float, ...]
    averages: Mapping[str, tuple[float, ...]]
    alarming: bool = False


def build_chart_state(baseline: Baseline, last: FloatArray) -> ChartState:
    """Return the chart's state at the end of a baseline: averages zero, no alarm.

    ``last`` is the baseline's last complete set, shape (p,).
    """
    zero = (0.0,) * baseline.p
    return ChartState(
        index=baseline.set_indices[-1],
        vector=tuple(last.tolist()),
        averages={AVERAGE: zero, MEWMA: zero},
    )


def update_chart_state(
    memory: ChartState, design: Design, index: int, vector: FloatArray
) -> tuple[ChartState, dict[str, float]]:
    """Assess one more complete set, shape (p,); return the next state and every statistic by name.

    ``index`` is that of the set in the schedule; the sets since the last complete one weaken its influence.
    """
    baseline, chart = design.baseline, design.chart
    before, distance = np.array(memory.vector), max(1, index - memory.index)
    entering = {
        AVERAGE: (vector - baseline.mean) / baseline.sd @ baseline.whitening,
        MEWMA: chart.whiten_next_set(vector, before, distance),
    }
    averages = {
        name: WEIGHT * w + (1.0 - WEIGHT) * np.array(memory.averages[name]) for name, w in entering.items()
    }
    statistics = {
        DISTANCE: float(distance_squared(vector, baseline)),
        PREWHITENED: design.by_default.distance_squared_after(vector, before, distance),
        **{name: float(sum(compute_chart_contributions(z))) for name, z in averages.items()},
    }
    return ChartState(
        index=index,
        vector=tuple(vector.tolist()),
        averages={name: tuple(z.tolist()) for name, z in averages.items()},
        alarming=is_chart_alarm_active(memory.alarming, statistics[MEWMA], design.limits[MEWMA], baseline.p),
    ), statistics


def compute_chart_contributions(average: FloatArray) -> FloatArray:
    """Return each feature's contribution to a chart's statistic, (2 - weight)/weight z^2, shape (p,).

    z is ``average``, the chart's exponential average.
    """
    return np.asarray((2.0 - WEIGHT) / WEIGHT * average**2)


def is_chart_alarm_active(alarming: bool, statistic: float, limit: float, p: int) -> bool:
    """Return whether the chart alarm is active: from above the limit until the statistic is at most p.

    p is its mean while the sensor is healthy, so the chart continues like one after a restart: an alarm that
    ended at the limit itself would return again and again, beyond the design rate.
    """
    return statistic > p if alarming else statistic > limit
