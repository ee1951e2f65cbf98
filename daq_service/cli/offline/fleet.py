"""``solimon assess --fleet``: assess many transducers of one kind together, with rows of the same times."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
import scipy  # `scipy.stats` comes when asked for

from analysis.statistics.chart import SLOW_RATE
from analysis.statistics.design import Budget
from analysis.statistics.fleet import (
    FEWEST_SENSORS,
    SHARED_SD,
    compute_running_p_values,
    estimate_gain,
    find_alarm_rows,
    find_shared_changes,
    mean_squared_correlation,
    residual_shift,
    shared_deviation,
    standardize_by_baseline,
    typical_autocorrelation,
    typical_kurtosis,
)
from analysis.statistics.rules import MINIMUM_SETS
from analysis.statistics.sequence import assess_sequence
from analysis.waves.record_reduction import FloatArray
from daq_service.cli.offline.table_file import TableFile
from daq_service.errors import UsageError

DOUBTED_BY_CHANCE = 0.01
"""Probability of this many questionable healthy baselines, below which it is not chance."""
FARTHEST_SD = 1e30
"""Maximum distance of a set from its baseline; limit of float32."""
Read = Callable[[Path], TableFile]
Map = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IndividualResult:
    """Result of a transducer without the deviation that the fleet shares.

    Attributes
    ----------
    chances
        That a healthy one's chart rises as high, shape (rows,); one before its first assessed row.
    alarms
        Whether its chart alarms within the budget of a sensor.
    why_not
        Why its own rate is not guaranteed; empty: it is.
    """

    refused: str | None
    alarms: bool = False
    chances: FloatArray
    why_not: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Deviations:
    """Deviations of a table's sets from its baseline.

    Attributes
    ----------
    in_sd
        Of each set from the baseline, shape (rows, features), float32 since there are many.
    """

    names: tuple[str, ...]
    in_baseline: np.ndarray
    in_sd: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Usual:
    """Common properties of the fleet's baselines: autocorrelation along directions, and kurtosis."""

    phi: FloatArray
    tails: float


class Raised(TypedDict):
    """A transducer that is raised, since which row, and the chance of a healthy one."""

    file: str
    row: int
    chance: float


class SharedAnswer(TypedDict):
    """A deviation that all share; sizes by feature."""

    first_row: int
    last_row: int
    largest_sd: dict[str, float]


class Fleet(TypedDict):
    """Result of a fleet in the JSON."""

    sensors: int
    judged: int
    false_discovery_rate: float
    fdr_guaranteed: bool
    why: str
    beside_the_median: bool
    raised: list[Raised]
    explained: list[str]
    kept_back: int
    shared: list[SharedAnswer]


def read_deviations(path: Path, read: Read) -> Deviations:
    """Read a table and return its deviations from the baseline in SD, clipped to `FARTHEST_SD`.

    Raises UsageError if the table cannot be read.
    """
    table = read(path)
    z, _ = standardize_by_baseline(table.vectors, table.in_baseline)
    z = np.clip(z, -FARTHEST_SD, FARTHEST_SD).astype(np.float32)
    return Deviations(names=table.names, in_baseline=table.in_baseline, in_sd=z)


def assess_individually(
    path: Path, read: Read, shared: FloatArray, usual: Usual, budget: Budget, period: int
) -> IndividualResult:
    """Assess a transducer without the shared deviation, with at least the usual autocorrelation and tails.

    A refused baseline gives chances of 1. Raises UsageError if the table cannot be read.

    Parameters
    ----------
    shared
        Shared deviation in SD of each baseline, shape (rows, features), at least as many rows as the table.
    period
        Number of sets after the baseline that the chances refer to.
    """
    table = read(path)
    _, sd = standardize_by_baseline(table.vectors, table.in_baseline)
    vectors = table.vectors - sd * shared[: len(table.vectors)]
    found = assess_sequence(
        vectors, table.in_baseline, table.names, budget, textbooks=False, least_phi=usual.phi
    )
    if found.refused is not None:
        return IndividualResult(refused=found.refused, chances=np.ones(len(vectors)))
    p = len(table.names) - len(found.features_dropped)
    return IndividualResult(
        refused=None,
        alarms=bool(found.onsets),
        why_not=found.rate_not_verified_reason,
        chances=compute_running_p_values(
            found.unbroken, max(MINIMUM_SETS, int(found.n / usual.tails)), p, period
        ),
    )


def _find_first_assessed_row(table: Deviations) -> int:
    """Return the index of the row after the last baseline row; the number of rows without a baseline."""
    healthy = np.flatnonzero(table.in_baseline)
    return int(healthy[-1]) + 1 if healthy.size else len(table.in_sd)


def assess_fleet(
    paths: Sequence[Path],
    read: Read,
    mapped: Map,
    budget: Budget,
    rate: float,
    own_alarms: Sequence[Sequence[int]],
) -> Fleet:
    """Assess all tables together and return the result for JSON.

    Raises UsageError if the tables differ in features or one cannot be read.

    Parameters
    ----------
    mapped
        Like `map`, possibly over processes.
    rate
        False discovery rate: mean fraction of the raised sensors that may be healthy.
    own_alarms
        Rows at which each sensor's own chart alarms, in the order of ``paths``.
    """
    first: list[Deviations] = list(mapped(partial(read_deviations, read=read), paths))
    names = first[0].names
    for path, table in zip(paths, first, strict=True):
        if table.names != names:
            raise UsageError(
                f"--fleet: {path} has the features {', '.join(table.names)}, {paths[0]} {', '.join(names)}; "
                "sensors of a fleet have the same: choose them by --features"
            )
    n_rows, after = max(len(table.in_sd) for table in first), max(map(_find_first_assessed_row, first))
    shared = shared_deviation(_stack_tables([table.in_sd for table in first], n_rows))
    baselines = [(table.in_sd - shared[: len(table.in_sd)])[table.in_baseline] for table in first]
    usual = Usual(phi=typical_autocorrelation(baselines), tails=typical_kurtosis(baselines))
    period = max(1, *(len(table.in_sd) - _find_first_assessed_row(table) for table in first))
    assess_table = partial(
        assess_individually, read=read, shared=shared, usual=usual, budget=budget, period=period
    )
    results: list[IndividualResult] = list(mapped(assess_table, paths))
    assessed = [k for k, sensor in enumerate(results) if sensor.refused is None]
    held = [
        np.pad(one, (0, n_rows - len(one)), mode="edge") for one in (results[k].chances for k in assessed)
    ]
    rows = find_alarm_rows(np.stack(held), rate) if held else []
    raised = {k: row for k, row in zip(assessed, rows, strict=True) if row is not None}
    causes = find_shared_changes(shared, len(paths), float(usual.phi.max()), after)
    errors = mean_squared_correlation(baselines)
    gains = [estimate_gain(table.in_sd[after:], shared[after : len(table.in_sd)], errors) for table in first]
    n = int(np.median([table.in_baseline.sum() for table in first]))
    kept_sd = residual_shift(gains, causes, phi=float(usual.phi.max()), n=max(1, n), tails=usual.tails)
    why = _describe_unverified_rate([results[k].why_not for k in assessed], len(paths), kept_sd)
    kept_back = [k for k in assessed if own_alarms[k] and k not in raised]
    explained = [
        k
        for k in kept_back
        if not results[k].alarms
        and any(cause.first_row <= row <= cause.last_row for row in own_alarms[k] for cause in causes)
    ]
    return {
        "sensors": len(paths),
        "judged": len(assessed),
        "false_discovery_rate": rate,
        "fdr_guaranteed": not why,
        "why": why,
        "beside_the_median": len(paths) >= FEWEST_SENSORS,
        "raised": [
            {"file": str(paths[k]), "row": row, "chance": float(results[k].chances[-1])}
            for k, row in raised.items()
        ],
        "explained": [str(paths[k]) for k in explained],
        "kept_back": len(kept_back) - len(explained),
        "shared": [
            {
                "first_row": cause.first_row,
                "last_row": cause.last_row,
                "largest_sd": dict(zip(names, cause.largest_sd, strict=True)),
            }
            for cause in causes
        ],
    }


def _describe_unverified_rate(of_sensors: Sequence[str], sensors: int, kept_sd: float) -> str:
    """Return the reason why the false discovery rate is not verified; empty if it is.

    ``of_sensors`` has the reason of each sensor's own rate, empty if verified; these count only if there are
    more than by chance (binomial test, `DOUBTED_BY_CHANCE`). ``kept_sd`` is the shared deviation that is
    left, in SD.
    """
    if sensors < FEWEST_SENSORS:
        return f"fewer than {FEWEST_SENSORS} sensors: what they share is not taken out"
    reasons = [reason for reason in of_sensors if reason]
    if (
        reasons
        and scipy.stats.binom.sf(len(reasons) - 1, len(of_sensors), 2.0 * SLOW_RATE) < DOUBTED_BY_CHANCE
    ):
        (reason, _), *_ = Counter(reasons).most_common(1)
        return f"{len(reasons)} of {len(of_sensors)} sensors: {reason}"
    if kept_sd > SHARED_SD:
        return (
            f"what all share moves them unlike: some keep {kept_sd:.1f} SD of it, which their charts take "
            "for their own"
        )
    return ""


def _stack_tables(parts: Sequence[np.ndarray], n_rows: int) -> np.ndarray:
    """Stack tables (rows, features) to a float32 array (tables, ``n_rows``, features), padded with NaN."""
    stacked = np.full((len(parts), n_rows, parts[0].shape[1]), np.nan, dtype=np.float32)
    for k, part in enumerate(parts):
        stacked[k, : len(part)] = part
    return stacked


def describe_fleet(answer: Fleet) -> str:
    """Format the result of the fleet as lines of text: raised sensors, shared changes, alarms kept back."""
    sensors = f"fleet of {answer['sensors']} sensors, {answer['judged']} assessed"
    raised = (
        f"{len(answer['raised'])} raised, of which at most {answer['false_discovery_rate']:.0%} are false"
    )
    promise = " on average" if answer["fdr_guaranteed"] else f" on average, not verified: {answer['why']}"
    lines = [f"{sensors}: {raised}{promise}"]
    lines += [
        f"  inspect    {sensor_raised['file']}, since row {sensor_raised['row']}"
        for sensor_raised in answer["raised"]
    ]
    for cause in answer["shared"]:
        sizes = ", ".join(f"{name} {size:+.1f} SD" for name, size in cause["largest_sd"].items())
        lines.append(
            f"  all move   rows {cause['first_row']} to {cause['last_row']} ({sizes}): weather, process or "
            "supply, or a wall that goes everywhere; check the temperature"
        )
    if answer["explained"]:
        lines.append(f"  explained  alarms of {len(answer['explained'])} sensors by what all share")
    if answer["kept_back"]:
        lines.append(
            f"  kept back  alarms of {answer['kept_back']} sensors: among so many, chance makes them too"
        )
    return "\n".join(lines)
