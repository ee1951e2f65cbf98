"""``solimon assess``: judge tables of features as the service would, a sensor a table."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import click

from analysis.statistics.design import Budget
from analysis.statistics.named_limits import LIMITS
from analysis.statistics.sequence import Assessed, assess
from daq_service.cli.offline.csv_lines import NoTableError
from daq_service.cli.offline.fleet import Map, Read, assess_fleet, fleet_in_words
from daq_service.cli.offline.table_file import read_table
from daq_service.cli.sweep.progress import Progress
from daq_service.errors import UsageError
from daq_service.processes.executors import opened_executor, usable_cores

FEW_FILES = 8
"""Fewer are judged in this process: another one takes a second to begin."""
FILES_A_TASK = 8
LONGEST_RUN = 1e9
"""Sets from one false alarm to the next; far beyond, the equation of the chart's limit has no digits."""


def run_assess(
    *,
    tables: tuple[Path, ...],
    baseline_rows: int | None,
    baseline_where: str | None,
    features: str | None,
    budget: float,
    sets_per_day: float,
    no_rows: bool,
    fleet: bool,
    false_discovery_rate: float,
    as_json: bool,
) -> None:
    """Judge every table; what cannot be judged is told as refused, with its reason."""
    if (baseline_rows is None) == (baseline_where is None):
        raise UsageError("say what is the baseline: --baseline-rows N or --baseline-where COLUMN=VALUE")
    where = None
    if baseline_where is not None:
        column, equals, value = baseline_where.partition("=")
        if not (column and equals):
            raise UsageError(f"--baseline-where is {baseline_where!r}; it must be COLUMN=VALUE")
        where = (column.strip(), value.strip())
    read = partial(
        read_table,
        features=tuple(name.strip() for name in (features or "").split(",") if name.strip()),
        baseline_rows=baseline_rows,
        baseline_where=where,
    )
    design = Budget(alarms_per_year=budget, sets_per_day=sets_per_day)
    if not 1.0 < design.run_length <= LONGEST_RUN:
        raise UsageError(
            f"--budget {budget:g} at {sets_per_day:g} sets a day is an alarm in {design.run_length:.3g} "
            f"sets; charts are designed for more than 1 and at most {LONGEST_RUN:.0e}"
        )
    with _mapped(tables) as mapped:
        one = partial(answered, read=read, budget=design, with_rows=as_json and not no_rows)
        found: list[tuple[dict[str, Any], UsageError | None]] = list(mapped(one, tables))
        answer: dict[str, Any] = {"sensors": [told for told, _ in found]}
        readable = {path: told for path, (told, error) in zip(tables, found, strict=True) if error is None}
        if fleet and readable:
            alone = [told["alarm"]["rows"] for told in readable.values()]
            answer["fleet"] = assess_fleet([*readable], read, mapped, design, false_discovery_rate, alone)
    if as_json:
        click.echo(json.dumps(answer, allow_nan=False))
    else:
        for told in answer["sensors"]:
            click.echo(in_words(told, budget, sets_per_day))
        if "fleet" in answer:
            click.echo(fleet_in_words(answer["fleet"]))
    for _, error in found:
        if error is not None and not isinstance(error, NoTableError):
            raise error  # no fault of a file's content: the line asked for what is not there


@contextmanager
def _mapped(tables: tuple[Path, ...]) -> Iterator[Map]:
    """Give a `map` over tables: over processes where they are many, with progress where a person looks."""
    workers = min(usable_cores(), -(-len(tables) // FILES_A_TASK))
    if len(tables) < FEW_FILES or workers < 2:
        yield map
        return
    with opened_executor("processes", workers) as executor:

        def spread(one: Callable[[Any], Any], paths: Sequence[Any]) -> Iterator[Any]:
            progress = Progress(len(paths), 0, what="tables") if sys.stderr.isatty() else None
            for found in executor.map(one, paths, chunksize=FILES_A_TASK):
                if progress is not None:
                    progress.advance(1)
                yield found

        yield spread


def answered(
    path: Path, *, read: Read, budget: Budget, with_rows: bool
) -> tuple[dict[str, Any], UsageError | None]:
    """Judge one table, or tell it as refused with the error of reading it: others have answers too."""
    try:
        return sensor(path, read=read, budget=budget, with_rows=with_rows), None
    except UsageError as error:
        lists = ("features_dropped", "columns_assessed", "columns_left_out")
        told = {"file": str(path), "refused": str(error), **{name: [] for name in lists}}
        return told | _nothing(with_rows=with_rows), error


def sensor(
    path: Path,
    *,
    read: Read,
    budget: Budget,
    with_rows: bool,
) -> dict[str, Any]:
    """Judge one table, as it is told."""
    table = read(path)
    found = assess(table.vectors, table.in_baseline, table.names, budget, textbooks=with_rows)
    told: dict[str, Any] = {"file": str(path), "refused": found.refused}
    told["features_dropped"] = list(found.features_dropped)
    told |= {"columns_assessed": list(table.names), "columns_left_out": list(table.left_out)}
    if found.refused is not None:
        return told | _nothing(with_rows=with_rows)
    nothing, rows = None, len(table.vectors)
    if table.in_baseline[-1]:
        nothing = f"the last of {rows} rows is baseline: nothing is judged; give a smaller baseline"
        click.echo(f"{path}: {nothing}", err=True)
    told |= {
        "nothing_judged": nothing,
        "n": found.n,
        "n_eff": found.n_eff,
        "phi_pooled": found.phi_pooled,
        "tail": found.tail,
        "suspects": [{"row": row} for row in found.suspects],
        "named": [{"kind": one.kind, "rows": list(one.rows)} for one in found.named],
        "left_out": [{"row": row, "reason": reason} for row, reason in found.left_out],
        "limits": dict(found.limits),
        "default_because": found.default_reason,
        "count": dict(found.count),
        "first": dict(found.first),
        "alarm": {
            "rows": list(found.onsets),
            "rate_guaranteed": not found.why_not_guaranteed,
            "why": found.why_not_guaranteed,
            "limit": found.chart_limit,
        },
    }
    return told | ({"rows": _rows(found)} if with_rows else {})


def _nothing(*, with_rows: bool) -> dict[str, Any]:
    lists = ("suspects", "named", "left_out", *(("rows",) if with_rows else ()))
    return {
        **dict.fromkeys(("nothing_judged", "n", "n_eff", "phi_pooled", "tail")),
        **{name: [] for name in lists},
        **{name: {} for name in ("limits", "count", "first")},
        "alarm": {"rows": [], "rate_guaranteed": False, "why": "refused", "limit": None},
    }


def _rows(found: Assessed) -> list[dict[str, Any]]:
    columns = {
        "distance_squared": found.distances_squared,
        "mewma_textbook": found.mewma_textbook,
        "mcusum_textbook": found.mcusum_textbook,
        "chart": found.chart,
    }
    told = {name: [_known(value) for value in column.tolist()] for name, column in columns.items()}
    return [
        {"row": row, **dict(zip(told, values, strict=True))}
        for row, values in enumerate(zip(*told.values(), strict=True))
    ]


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def in_words(told: dict[str, Any], budget: float, sets_per_day: float) -> str:
    """Tell a sensor to a person."""
    if told["refused"] is not None:
        return f"{told['file']}: refused: {told['refused']}"
    alarm, lines = told["alarm"], [told["file"]]
    lines.append(f"  columns    {', '.join(told['columns_assessed'])}")
    for one in told["columns_left_out"]:
        lines.append(f"  left out   {one['name']!r}: {one['reason']} ({one['cell']!r} in row {one['row']})")
    lines.append(
        f"  baseline   {told['n']} sets, worth {told['n_eff']:.0f} independent ones"
        f" (memory {told['phi_pooled']:.2f}), tails {told['tail']:.2f} x normal"
    )
    if told["features_dropped"]:
        lines.append(f"  dropped    {', '.join(told['features_dropped'])}: constant in the baseline")
    for one in told["named"]:
        rows = one["rows"]
        which = f"{rows[0]} to {rows[-1]}" if one["kind"] == "trend" else ", ".join(map(str, rows))
        lines.append(f"  look at    {one['kind']}, rows {which}")
    for name, limit in told["limits"].items():
        first = told["first"][name]
        since = "" if first is None else f", first row {first}"
        caveat = f"; {LIMITS[name].caveat}" if LIMITS[name].caveat else ""
        lines.append(f"  {name:<15} limit {limit:9.2f}  beyond {told['count'][name]}{since}{caveat}")
    lines.append(f"  default    {told['default_because']}")
    promise = f"{budget:g} false alarms a year at {sets_per_day:g} sets a day"
    kept = promise if alarm["rate_guaranteed"] else f"{promise} not promised: {alarm['why']}"
    raised = ", ".join(map(str, alarm["rows"][:10])) + (" ..." if len(alarm["rows"]) > 10 else "")
    lines.append(f"  alarms     {f'at rows {raised}' if alarm['rows'] else 'none'} ({kept})")
    return "\n".join(lines)
