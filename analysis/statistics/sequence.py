"""A whole sequence of sets judged at once, baseline first: every limit and chart by name, and what to doubt.

What the recorder decides set by set is said here of a table that is complete; nothing is learned after the
baseline.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy  # `scipy.special` comes when asked for
from numpy.typing import ArrayLike

from analysis.errors import AnalysisError, NotEnoughSetsError
from analysis.statistics.baseline import fit_baseline, whitening_matrix
from analysis.statistics.baseline_check import Named, named_in
from analysis.statistics.chart import designed, unshown_memory
from analysis.statistics.distance import distance_squared
from analysis.statistics.heavy_tails import HEAVY, tail_limit
from analysis.statistics.limits import F_PREDICTIVE, PAPER_MEAN_3SD, f_predictive_limit, paper_limit
from analysis.statistics.memory import effective_sets, pooled_phi, prewhitened, significant
from analysis.statistics.mewma import estimated_limit, known_limit, mcusum, mewma
from analysis.statistics.rules import MINIMUM_SETS, NOMINAL_RATE
from analysis.waves.record_reduction import FloatArray

SMALLEST_SD = 1e-9
"""Of a feature, as part of its size: one that scatters less is constant and has no distance."""
DAYS_PER_YEAR = 365.25


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """False alarms that a healthy sensor may raise.

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
        """Sets from one false alarm to the next, on average."""
        return self.sets_per_day * DAYS_PER_YEAR / self.alarms_per_year


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Assessed:
    """What a sequence says; rows count from 0, the baseline's included.

    Attributes
    ----------
    refused
        Why nothing could be judged; None: it was. Then everything below has its value.
    features_dropped
        Constant in the baseline.
    n, n_eff, phi_pooled
        Sets of the baseline, how many independent ones they are worth, and their memory from set to set.
    tail
        Limit that allows for the tails of the baseline, over the F limit.
    suspects
        Rows of the baseline beyond the Phase I limit.
    named
        What else stands out of the baseline.
    left_out
        Rows with a missing value, and other rows that are not judged, each with its reason.
    limits
        By name.
    count, first
        Rows after the baseline beyond each limit, and the first of them.
    onsets
        Rows at which the default chart alarms.
    why_not_guaranteed
        Empty where the chart keeps to its budget.
    distances_squared, mewma_textbook, mcusum_textbook, chart
        Shape (rows,), NaN where there is none.
    chart_limit
        Of ``chart``.
    """

    refused: str | None
    features_dropped: tuple[str, ...] = ()
    n: int = 0
    n_eff: float = 0.0
    phi_pooled: float = 0.0
    tail: float = 0.0
    suspects: tuple[int, ...] = ()
    named: tuple[Named, ...] = ()
    left_out: tuple[tuple[int, str], ...] = ()
    limits: Mapping[str, float] = field(default_factory=dict)
    count: Mapping[str, int] = field(default_factory=dict)
    first: Mapping[str, int | None] = field(default_factory=dict)
    default_because: str = ""
    onsets: tuple[int, ...] = ()
    why_not_guaranteed: str = ""
    chart_limit: float = 0.0
    distances_squared: FloatArray = field(default_factory=lambda: np.empty(0))
    mewma_textbook: FloatArray = field(default_factory=lambda: np.empty(0))
    mcusum_textbook: FloatArray = field(default_factory=lambda: np.empty(0))
    chart: FloatArray = field(default_factory=lambda: np.empty(0))


def assess(
    vectors: ArrayLike,
    in_baseline: ArrayLike,
    feature_names: Sequence[str],
    budget: Budget = Budget(),
    *,
    textbooks: bool = True,
) -> Assessed:
    """Judge a sequence.

    Parameters
    ----------
    vectors
        Shape (rows, features), in the order of time; NaN where a value is missing.
    in_baseline
        Shape (rows,), True for the sets that are known to be healthy.
    textbooks
        Also run the MCUSUM, which nothing here decides by.
    """
    x, healthy = np.asarray(vectors, dtype=np.float64), np.asarray(in_baseline, dtype=bool)
    x = np.where(np.isfinite(x), x, np.nan)
    if healthy.sum() < MINIMUM_SETS:
        return Assessed(refused=_too_few(int(healthy.sum()), "rows"))
    varies = _varies(x[healthy])
    dropped = tuple(name for name, kept in zip(feature_names, varies, strict=True) if not kept)
    names = [name for name, kept in zip(feature_names, varies, strict=True) if kept]
    if not names:
        return Assessed(refused="every feature is constant in the baseline", features_dropped=dropped)
    try:
        return _judged(x[:, varies], healthy, names, dropped, budget, textbooks=textbooks)
    except AnalysisError as error:
        return Assessed(refused=str(error), features_dropped=dropped)


def _too_few(n: int, what: str) -> str:
    return f"{n} {what} in the baseline; at least {MINIMUM_SETS} are needed: let it be longer"


def _varies(baseline: FloatArray) -> np.ndarray:
    present = np.isfinite(baseline)
    n = np.maximum(present.sum(axis=0), 1)
    mean = np.where(present, baseline, 0.0).sum(axis=0) / n
    spread = np.sqrt((np.where(present, baseline - mean, 0.0) ** 2).sum(axis=0) / n)
    size = np.abs(np.where(present, baseline, 0.0)).max(axis=0)
    return np.asarray((spread > SMALLEST_SD * size) | ~present.any(axis=0))


def _judged(
    x: FloatArray,
    healthy: np.ndarray,
    names: Sequence[str],
    dropped: tuple[str, ...],
    budget: Budget,
    *,
    textbooks: bool,
) -> Assessed:
    complete = np.asarray(np.isfinite(x).all(axis=1))
    rows = np.flatnonzero(healthy & complete)
    n, p = rows.size, len(names)
    if n < MINIMUM_SETS:
        raise NotEnoughSetsError(_too_few(n, "complete rows"))
    baseline = fit_baseline(x[rows], rows.tolist(), name="baseline", feature_names=names)
    begins, ends = np.flatnonzero(healthy)[[0, -1]]
    after: np.ndarray = np.arange(len(x)) > ends
    history = np.where(healthy[:, None], x, np.nan)[begins : ends + 1]  # gaps where other sets lie between
    followed = np.where((healthy | after)[:, None], x, np.nan)
    judged = np.flatnonzero(after)

    distances = np.where(complete, distance_squared(np.where(complete[:, None], x, 0.0), baseline), np.nan)
    run_length = budget.run_length
    f_limit = f_predictive_limit(n, p)

    phi = pooled_phi(history)
    memory = significant(phi, n)
    default_distances, own = distances, baseline.distances_squared
    if memory > 0.0:
        residuals = prewhitened(followed, baseline.mean, memory)
        of_residuals = fit_baseline(
            residuals[rows], rows.tolist(), name="baseline without memory", feature_names=names
        )
        known = np.asarray(np.isfinite(residuals).all(axis=1))
        default_distances = np.where(
            known, distance_squared(np.where(known[:, None], residuals, 0.0), of_residuals), np.nan
        )
        own = of_residuals.distances_squared
    allowing = tail_limit(own, p)
    heavy = allowing > HEAVY * f_limit
    because = "prewhitened" if memory > 0.0 else "independent"
    because += ", heavy tails: left-out limit" if heavy else ", F limit"

    of_distance = {
        PAPER_MEAN_3SD: paper_limit(baseline.distances_squared),
        "chi_square": float(scipy.special.chdtri(p, NOMINAL_RATE)),
        F_PREDICTIVE: f_limit,
        "f_budget": f_predictive_limit(n, p, 1.0 / run_length),
        "phase_one": baseline.suspect_limit,
    }
    of_average = {
        "mewma_known": known_limit(p, run_length),
        "mewma_textbook": estimated_limit(n, p, run_length),
    }
    limits = {**of_distance, **of_average, "default": allowing if heavy else f_limit}

    whitened = (x[judged] - baseline.mean) / baseline.sd @ whitening_matrix(baseline.correlation)
    textbook = _placed(len(x), judged, mewma(whitened))
    values = dict.fromkeys(of_distance, distances)
    values |= dict.fromkeys(of_average, textbook)
    values["default"] = default_distances
    beyond = {name: np.flatnonzero(after & (values[name] > limit)) for name, limit in limits.items()}

    chart = designed(history, run_length)
    statistic, onsets = chart.run(chart.whitened(followed)[judged])
    return Assessed(
        refused=None,
        features_dropped=dropped,
        n=n,
        n_eff=effective_sets(n, phi),
        phi_pooled=phi,
        tail=allowing / f_limit,
        suspects=baseline.suspects,
        named=tuple(
            Named(kind=found.kind, rows=tuple(int(rows[row]) for row in found.rows))
            for found in named_in(x[rows])
        ),
        left_out=_left_out(complete, healthy, after),
        limits=limits,
        count={name: int(found.size) for name, found in beyond.items()},
        first={name: int(found[0]) if found.size else None for name, found in beyond.items()},
        default_because=because,
        onsets=tuple(int(judged[row]) for row in onsets),
        why_not_guaranteed=unshown_memory(history),
        chart_limit=chart.limit,
        distances_squared=distances,
        mewma_textbook=textbook,
        mcusum_textbook=_placed(len(x), judged, mcusum(whitened)) if textbooks else np.empty(0),
        chart=_placed(len(x), judged, statistic),
    )


def _placed(size: int, rows: np.ndarray, values: FloatArray) -> FloatArray:
    result = np.full(size, np.nan)
    result[rows] = values
    return result


def _left_out(complete: np.ndarray, healthy: np.ndarray, after: np.ndarray) -> tuple[tuple[int, str], ...]:
    told = [(int(row), "a value is missing") for row in np.flatnonzero(~complete)]
    between = np.flatnonzero(complete & ~healthy & ~after)
    told += [(int(row), "not of the baseline, and before its end: no chart") for row in between]
    return tuple(sorted(told))
