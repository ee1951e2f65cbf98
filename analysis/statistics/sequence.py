"""Assessment of a complete sequence of sets, baseline first: every limit and chart by name, and warnings.

What the recorder decides set by set is said here of a table that is complete; nothing is learned after the
baseline.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from analysis.errors import AnalysisError, NotEnoughSetsError, SingularCovarianceError
from analysis.statistics.baseline import Baseline, fit_baseline
from analysis.statistics.baseline_check import CORE, Anomaly, find_anomalies
from analysis.statistics.design import ONE_IN_FIVE_YEARS, Budget, Design, build_design
from analysis.statistics.distance import distance_squared
from analysis.statistics.mewma import mcusum, mewma
from analysis.statistics.named_limits import AVERAGE, DISTANCE, LIMITS, MEWMA, PREWHITENED
from analysis.statistics.rules import MINIMUM_SETS
from analysis.waves.record_reduction import FloatArray

FARTHEST = 1e100
"""Of a value, in the baseline's size: beyond, squares would overflow."""
SMALLEST_SD = 1e-9
"""Of a feature, as part of its size: one that scatters less is constant and has no distance."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Assessed:
    """Assessment of a sequence; rows count from 0, the baseline's included.

    Attributes
    ----------
    refused
        Why nothing could be assessed; None: it was. Then everything below has its value.
    features_dropped
        Constant in the baseline.
    n, n_eff, phi_pooled
        Sets of the baseline, the effective number of independent ones, and their lag-1 autocorrelation.
    tail
        Limit that allows for the tails of the baseline, over the F limit.
    suspects
        Rows of the baseline beyond the Phase I limit.
    named
        Anomalies of the baseline.
    left_out
        Rows with a missing value, and other rows that are not assessed, each with its reason.
    limits
        By name.
    count, first
        Rows after the baseline beyond each limit, and the first of them.
    onsets
        Rows at which the default chart alarms.
    rate_not_verified_reason
        Empty where the chart keeps to its budget.
    distances_squared, mewma_textbook, mcusum_textbook, chart
        Shape (rows,), NaN where there is none.
    chart_limit
        Of ``chart``.
    unbroken
        The chart without a restart after its alarms; shape (rows,).
    """

    refused: str | None
    features_dropped: tuple[str, ...] = ()
    n: int = 0
    n_eff: float = 0.0
    phi_pooled: float = 0.0
    tail: float = 0.0
    suspects: tuple[int, ...] = ()
    named: tuple[Anomaly, ...] = ()
    left_out: tuple[tuple[int, str], ...] = ()
    limits: Mapping[str, float] = field(default_factory=dict)
    count: Mapping[str, int] = field(default_factory=dict)
    first: Mapping[str, int | None] = field(default_factory=dict)
    default_reason: str = ""
    onsets: tuple[int, ...] = ()
    rate_not_verified_reason: str = ""
    chart_limit: float = 0.0
    distances_squared: FloatArray = field(default_factory=lambda: np.empty(0))
    mewma_textbook: FloatArray = field(default_factory=lambda: np.empty(0))
    mcusum_textbook: FloatArray = field(default_factory=lambda: np.empty(0))
    chart: FloatArray = field(default_factory=lambda: np.empty(0))
    unbroken: FloatArray = field(default_factory=lambda: np.empty(0))


def assess_sequence(
    vectors: ArrayLike,
    in_baseline: ArrayLike,
    feature_names: Sequence[str],
    budget: Budget = ONE_IN_FIVE_YEARS,
    *,
    textbooks: bool = True,
    least_phi: ArrayLike = 0.0,
) -> Assessed:
    """Assess a table of feature vectors against a baseline of its healthy rows.

    Input that cannot be assessed does not raise: the result's ``refused`` states the reason.

    Parameters
    ----------
    vectors
        Shape (rows, features), in the order of time; NaN where a value is missing.
    in_baseline
        Shape (rows,), True for the sets that are known to be healthy.
    textbooks
        Also run the MCUSUM, which nothing here decides by.
    least_phi
        Lower bound of the autocorrelation along the directions, from similar sensors (`chart.design_chart`);
        a number, or one for each feature.
    """
    x, healthy = np.asarray(vectors, dtype=np.float64), np.asarray(in_baseline, dtype=bool)
    x = np.where(np.isfinite(x), x, np.nan)
    if healthy.sum() < MINIMUM_SETS:
        return Assessed(refused=_too_few_sets_message(int(healthy.sum()), "rows"))
    varies = _find_varying_columns(_scale_columns(x, healthy)[healthy])
    dropped = tuple(name for name, kept in zip(feature_names, varies, strict=True) if not kept)
    names = [name for name, kept in zip(feature_names, varies, strict=True) if kept]
    if not names:
        return Assessed(refused="every feature is constant in the baseline", features_dropped=dropped)
    try:
        least = np.sort(np.broadcast_to(least_phi, varies.shape))[::-1][: len(names)]
        return _assess_complete_rows(
            x[:, varies], healthy, names, dropped, budget, least, textbooks=textbooks
        )
    except AnalysisError as error:
        return Assessed(refused=str(error), features_dropped=dropped)


def _scale_columns(x: FloatArray, healthy: np.ndarray) -> FloatArray:
    """Divide columns by powers of two near the baseline's size, then clip them to +-1e100.

    No digit of a result changes, and no square overflows.
    """
    size = np.abs(np.where(healthy[:, None] & np.isfinite(x), x, 0.0)).max(axis=0, initial=0.0)
    _, exponent = np.frexp(size)
    with np.errstate(over="ignore"):  # a set that is so far off stays far off
        return np.asarray(np.clip(np.ldexp(x, -exponent), -FARTHEST, FARTHEST))


def _too_few_sets_message(n: int, subject: str) -> str:
    """Return the error message for a baseline with fewer than 15 sets; ``subject`` names what was counted."""
    return f"{n} {subject} in the baseline; at least {MINIMUM_SETS} are needed: let it be longer"


def _find_varying_columns(baseline: FloatArray) -> np.ndarray:
    """Find the columns that vary in the baseline or have no value there; Boolean, shape (p,)."""
    present = np.isfinite(baseline)
    n = np.maximum(present.sum(axis=0), 1)
    mean = np.where(present, baseline, 0.0).sum(axis=0) / n
    spread = np.sqrt((np.where(present, baseline - mean, 0.0) ** 2).sum(axis=0) / n)
    size = np.abs(np.where(present, baseline, 0.0)).max(axis=0)
    return np.asarray((spread > SMALLEST_SD * size) | ~present.any(axis=0))


def _assess_complete_rows(
    measured: FloatArray,
    healthy: np.ndarray,
    names: Sequence[str],
    dropped: tuple[str, ...],
    budget: Budget,
    least_phi: FloatArray,
    *,
    textbooks: bool,
) -> Assessed:
    """Assess the complete rows of a table, shape (rows, p), against its healthy rows; NaN where not assessed.

    Raise NotEnoughSetsError for fewer than 15 complete healthy rows, SingularCovarianceError as
    `fit_baseline`.
    """
    x = _scale_columns(measured, healthy)
    complete = np.asarray(np.isfinite(x).all(axis=1))
    rows = np.flatnonzero(healthy & complete)
    if rows.size < MINIMUM_SETS:
        known = np.isfinite(x[healthy]).sum(axis=0)
        least = int(known.argmin())
        raise NotEnoughSetsError(
            f"{_too_few_sets_message(rows.size, 'complete rows')}, or leave out {names[least]}, which "
            f"{known[least]} of {healthy.sum()} have"
        )
    baseline = fit_baseline(x[rows], rows.tolist(), name="baseline", feature_names=names)
    named = _find_anomalies(measured[rows], x[rows], rows, names)
    begins, ends = np.flatnonzero(healthy)[[0, -1]]
    after: np.ndarray = np.arange(len(x)) > ends
    history = np.where(healthy[:, None], x, np.nan)[begins : ends + 1]  # gaps where other sets lie between
    design = build_design(history, baseline, budget.run_length, least_phi=least_phi)
    followed = np.where((healthy | after)[:, None], x, np.nan)
    assessed = np.flatnonzero(after)
    entering = design.chart.whiten_sets(followed)[assessed]
    statistic, onsets = design.chart.run(entering)
    statistics = {
        **_compute_statistics(x, followed, complete, assessed, design),
        MEWMA: _spread_over_rows(len(x), assessed, statistic),
    }
    limits = {name: limit for name, limit in design.limits.items() if name != MEWMA}
    beyond = {
        name: np.flatnonzero(after & (statistics[LIMITS[name].of] > limit)) for name, limit in limits.items()
    }
    return Assessed(
        refused=None,
        features_dropped=dropped,
        n=baseline.n,
        n_eff=design.n_eff,
        phi_pooled=design.phi_pooled,
        tail=design.by_default.tail,
        suspects=baseline.suspects,
        named=named,
        left_out=_list_skipped_rows(complete, healthy, after),
        limits=limits,
        count={name: int(found.size) for name, found in beyond.items()},
        first={name: int(found[0]) if found.size else None for name, found in beyond.items()},
        default_reason=design.by_default.reason,
        onsets=tuple(int(assessed[row]) for row in onsets),
        rate_not_verified_reason=design.rate_not_verified_reason,
        chart_limit=design.chart.limit,
        distances_squared=statistics[DISTANCE],
        mewma_textbook=statistics[AVERAGE],
        mcusum_textbook=_spread_over_rows(len(x), assessed, mcusum(_whiten_vectors(x[assessed], baseline)))
        if textbooks
        else np.empty(0),
        chart=statistics[MEWMA],
        unbroken=_spread_over_rows(len(x), assessed, replace(design.chart, limit=np.inf).run(entering)[0]),
    )


def _find_anomalies(
    measured: FloatArray, x: FloatArray, rows: np.ndarray, names: Sequence[str]
) -> tuple[Anomaly, ...]:
    """Find anomalies of the baseline, as row numbers of the complete table.

    Raise SingularCovarianceError if most sets do not scatter, or if one value dwarfs the scatter of the
    others.
    """
    middle = np.quantile(measured, 0.5, axis=0, method="lower")
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        deviation = np.abs(measured - middle)
        scatter = np.quantile(deviation, CORE, axis=0)
        times = np.nan_to_num(deviation.max(axis=0) / scatter, nan=np.inf)
    at = int(times.argmax())
    farthest = int(deviation[:, at].argmax())
    lone = (
        f"{names[at]} of row {rows[farthest]} is {measured[farthest, at]:.4g}, where most of the baseline is "
        f"within {scatter[at]:.2g} of {middle[at]:.4g}: next to it the others do not scatter; correct or "
        f"empty that cell, or leave {names[at]} out"
    )
    if scatter[at] > 0.0 and times[at] > FARTHEST:
        raise SingularCovarianceError(lone)
    try:
        found = find_anomalies(x)
    except np.linalg.LinAlgError as error:
        alike = "in most of the baseline a feature is a combination of the others: leave one out"
        raise SingularCovarianceError(alike if scatter[at] > 0.0 else lone) from error
    return tuple(Anomaly(kind=one.kind, rows=tuple(int(rows[row]) for row in one.rows)) for one in found)


def _compute_statistics(
    x: FloatArray, followed: FloatArray, complete: np.ndarray, assessed: np.ndarray, design: Design
) -> dict[str, FloatArray]:
    """Compute the statistics of all rows by name, shape (rows,), except that of the default chart.

    ``followed`` is ``x`` with NaN in rows neither of the baseline nor after it; ``assessed`` are the row
    numbers after the baseline.
    """
    baseline, by_default = design.baseline, design.by_default
    distances = np.where(complete, distance_squared(np.where(complete[:, None], x, 0.0), baseline), np.nan)
    return {
        DISTANCE: distances,
        PREWHITENED: by_default.distances_squared(followed) if by_default.phi else distances,
        AVERAGE: _spread_over_rows(len(x), assessed, mewma(_whiten_vectors(x[assessed], baseline))),
    }


def _whiten_vectors(vectors: FloatArray, baseline: Baseline) -> FloatArray:
    """Standardize vectors, shape (n, p), by the baseline and decorrelate their features; same shape."""
    return np.asarray((vectors - baseline.mean) / baseline.sd @ baseline.whitening)


def _spread_over_rows(size: int, rows: np.ndarray, values: FloatArray) -> FloatArray:
    """Return an array of NaN, shape (size,), that holds the values in the given rows."""
    result = np.full(size, np.nan)
    result[rows] = values
    return result


def _list_skipped_rows(
    complete: np.ndarray, healthy: np.ndarray, after: np.ndarray
) -> tuple[tuple[int, str], ...]:
    """List the rows that are not assessed, in their order, each with its reason."""
    missing = [(int(row), "a value is missing") for row in np.flatnonzero(~complete)]
    between = np.flatnonzero(complete & ~healthy & ~after)
    missing += [(int(row), "not of the baseline, and before its end: no chart") for row in between]
    return tuple(sorted(missing))
