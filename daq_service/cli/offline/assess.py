"""``solimon assess``: assess tables of features as the service does, one transducer per table."""

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
"""Minimum number of files for worker processes, which take a second to start."""
FILES_A_TASK = 8
LONGEST_RUN = 1e9
"""Maximum sets between false alarms; far above, the equation of the chart's limit is inaccurate."""


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
    """Assess every table; report tables that cannot be assessed with the reason."""
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
        assess_table = partial(answered, read=read, budget=design, with_rows=as_json and not no_rows)
        results: list[tuple[dict[str, Any], UsageError | None]] = list(mapped(assess_table, tables))
        answer: dict[str, Any] = {"sensors": [sensor for sensor, _ in results]}
        readable = {
            path: sensor for path, (sensor, error) in zip(tables, results, strict=True) if error is None
        }
        if fleet and readable:
            own_alarms = [sensor["alarm"]["rows"] for sensor in readable.values()]
            answer["fleet"] = assess_fleet(
                [*readable], read, mapped, design, false_discovery_rate, own_alarms
            )
    if as_json:
        click.echo(json.dumps(answer, allow_nan=False))
    else:
        for sensor in answer["sensors"]:
            click.echo(in_words(sensor, budget, sets_per_day))
        if "fleet" in answer:
            click.echo(fleet_in_words(answer["fleet"]))
    for _, error in results:
        if error is not None and not isinstance(error, NoTableError):
            raise error  # no fault of a file's content: the line asked for what is not there


@contextmanager
def _mapped(tables: tuple[Path, ...]) -> Iterator[Map]:
    """Provide a `map` over tables: with processes for many files, and progress on a terminal."""
    workers = min(usable_cores(), -(-len(tables) // FILES_A_TASK))
    if len(tables) < FEW_FILES or workers < 2:
        yield map
        return
    with opened_executor("processes", workers) as executor:

        def map_in_processes(function: Callable[[Any], Any], paths: Sequence[Any]) -> Iterator[Any]:
            progress = Progress(len(paths), 0, what="tables") if sys.stderr.isatty() else None
            for result in executor.map(function, paths, chunksize=FILES_A_TASK):
                if progress is not None:
                    progress.advance(1)
                yield result

        yield map_in_processes


def answered(
    path: Path, *, read: Read, budget: Budget, with_rows: bool
) -> tuple[dict[str, Any], UsageError | None]:
    """Assess one table, or return the error of reading it, so that other tables are assessed."""
    try:
        return sensor(path, read=read, budget=budget, with_rows=with_rows), None
    except UsageError as error:
        lists = ("features_dropped", "columns_assessed", "columns_left_out")
        answer = {"file": str(path), "refused": str(error), **{name: [] for name in lists}}
        return answer | _empty_results(with_rows=with_rows), error


def sensor(
    path: Path,
    *,
    read: Read,
    budget: Budget,
    with_rows: bool,
) -> dict[str, Any]:
    """Assess one table and return the result for JSON."""
    table = read(path)
    assessed = assess(table.vectors, table.in_baseline, table.names, budget, textbooks=with_rows)
    answer: dict[str, Any] = {"file": str(path), "refused": assessed.refused}
    answer["features_dropped"] = list(assessed.features_dropped)
    answer |= {"columns_assessed": list(table.names), "columns_left_out": list(table.left_out)}
    if assessed.refused is not None:
        return answer | _empty_results(with_rows=with_rows)
    not_assessed, rows = None, len(table.vectors)
    if table.in_baseline[-1]:
        not_assessed = f"the last of {rows} rows is baseline: nothing is judged; give a smaller baseline"
        click.echo(f"{path}: {not_assessed}", err=True)
    answer |= {
        "nothing_judged": not_assessed,
        "n": assessed.n,
        "n_eff": assessed.n_eff,
        "phi_pooled": assessed.phi_pooled,
        "tail": assessed.tail,
        "suspects": [{"row": row} for row in assessed.suspects],
        "named": [{"kind": anomaly.kind, "rows": list(anomaly.rows)} for anomaly in assessed.named],
        "left_out": [{"row": row, "reason": reason} for row, reason in assessed.left_out],
        "limits": dict(assessed.limits),
        "default_because": assessed.default_reason,
        "count": dict(assessed.count),
        "first": dict(assessed.first),
        "alarm": {
            "rows": list(assessed.onsets),
            "rate_guaranteed": not assessed.rate_not_verified_reason,
            "why": assessed.rate_not_verified_reason,
            "limit": assessed.chart_limit,
        },
    }
    return answer | ({"rows": _rows(assessed)} if with_rows else {})


def _empty_results(*, with_rows: bool) -> dict[str, object]:
    """Return empty results."""
    lists = ("suspects", "named", "left_out", *(("rows",) if with_rows else ()))
    return {
        **dict.fromkeys(("nothing_judged", "n", "n_eff", "phi_pooled", "tail")),
        **{name: [] for name in lists},
        **{name: {} for name in ("limits", "count", "first")},
        "alarm": {"rows": [], "rate_guaranteed": False, "why": "refused", "limit": None},
    }


def _rows(assessed: Assessed) -> list[dict[str, Any]]:
    """Return a result per row."""
    columns = {
        "distance_squared": assessed.distances_squared,
        "mewma_textbook": assessed.mewma_textbook,
        "mcusum_textbook": assessed.mcusum_textbook,
        "chart": assessed.chart,
    }
    rows_by_name = {
        name: [_finite_or_none(value) for value in column.tolist()] for name, column in columns.items()
    }
    return [
        {"row": row, **dict(zip(rows_by_name, values, strict=True))}
        for row, values in enumerate(zip(*rows_by_name.values(), strict=True))
    ]


def _finite_or_none(value: float) -> float | None:
    """Return a finite value; None otherwise."""
    return value if math.isfinite(value) else None


def in_words(answer: dict[str, Any], budget: float, sets_per_day: float) -> str:
    """Return the lines about a transducer."""
    if answer["refused"] is not None:
        return f"{answer['file']}: refused: {answer['refused']}"
    alarm, lines = answer["alarm"], [answer["file"]]
    lines.append(f"  columns    {', '.join(answer['columns_assessed'])}")
    for item in answer["columns_left_out"]:
        lines.append(
            f"  left out   {item['name']!r}: {item['reason']} ({item['cell']!r} in row {item['row']})"
        )
    lines.append(
        f"  baseline   {answer['n']} sets, worth {answer['n_eff']:.0f} independent ones"
        f" (memory {answer['phi_pooled']:.2f}), tails {answer['tail']:.2f} x normal"
    )
    if answer["features_dropped"]:
        lines.append(f"  dropped    {', '.join(answer['features_dropped'])}: constant in the baseline")
    for item in answer["named"]:
        rows = item["rows"]
        row_text = f"{rows[0]} to {rows[-1]}" if item["kind"] == "trend" else ", ".join(map(str, rows))
        lines.append(f"  look at    {item['kind']}, rows {row_text}")
    for name, limit in answer["limits"].items():
        first = answer["first"][name]
        since = "" if first is None else f", first row {first}"
        caveat = f"; {LIMITS[name].caveat}" if LIMITS[name].caveat else ""
        lines.append(f"  {name:<15} limit {limit:9.2f}  beyond {answer['count'][name]}{since}{caveat}")
    lines.append(f"  default    {answer['default_because']}")
    promise = f"{budget:g} false alarms a year at {sets_per_day:g} sets a day"
    rate_text = promise if alarm["rate_guaranteed"] else f"{promise} not promised: {alarm['why']}"
    raised = ", ".join(map(str, alarm["rows"][:10])) + (" ..." if len(alarm["rows"]) > 10 else "")
    lines.append(f"  alarms     {f'at rows {raised}' if alarm['rows'] else 'none'} ({rate_text})")
    return "\n".join(lines)
