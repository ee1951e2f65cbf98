"""``solimon assess``: assess tables of features as the service does, one transducer per table."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypedDict

import click

from analysis.statistics.design import Budget
from analysis.statistics.named_limits import LIMITS
from analysis.statistics.sequence import Assessed, assess_sequence
from daq_service.cli.offline.csv_lines import NoTableError, finite_or_none
from daq_service.cli.offline.fleet import Map, Read, assess_fleet, describe_fleet
from daq_service.cli.offline.table_file import LeftOut, read_table
from daq_service.cli.sweep.progress import Progress
from daq_service.errors import UsageError
from daq_service.processes.executors import count_usable_cores, open_executor

FEW_FILES = 8
"""Minimum number of files for worker processes, which take a second to start."""
FILES_A_TASK = 8
LONGEST_RUN = 1e9
"""Maximum sets between false alarms; far above, the equation of the chart's limit is inaccurate."""


class AlarmAnswer(TypedDict):
    """Alarms of the chart, and whether their rate is within the budget."""

    rows: list[int]
    rate_guaranteed: bool
    why: str
    limit: float | None


def _build_refused_alarm() -> AlarmAnswer:
    """Return the alarm entry of a table that could not be assessed: no rows, no guaranteed rate."""
    return {"rows": [], "rate_guaranteed": False, "why": "refused", "limit": None}


class Anomaly(TypedDict):
    """Rows of the baseline that differ from the others."""

    kind: str
    rows: list[int]


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """Result of a transducer in the JSON; values are None and lists empty where it is refused."""

    file: str
    refused: str | None = None
    features_dropped: Sequence[str] = ()
    columns_assessed: Sequence[str] = ()
    columns_left_out: Sequence[LeftOut] = ()
    nothing_judged: str | None = None
    n: int | None = None
    n_eff: float | None = None
    phi_pooled: float | None = None
    tail: float | None = None
    suspects: Sequence[dict[str, int]] = ()
    named: Sequence[Anomaly] = ()
    left_out: Sequence[dict[str, object]] = ()
    limits: Mapping[str, float] = field(default_factory=dict)
    default_because: str | None = None
    count: Mapping[str, int] = field(default_factory=dict)
    first: Mapping[str, int | None] = field(default_factory=dict)
    alarm: AlarmAnswer = field(default_factory=_build_refused_alarm)
    rows: Sequence[dict[str, float | None]] | None = None

    def as_json(self) -> dict[str, object]:
        """Convert the result to a JSON object, without optional keys that are None."""
        optional = ("default_because", "rows")
        return {
            name: value for name, value in vars(self).items() if name not in optional or value is not None
        }


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
    """Run `solimon assess`: assess every table and print the results as text or JSON.

    One of ``baseline_rows`` and ``baseline_where`` must be given. A file that is no table gets a result with
    the reason. ``budget`` is in false alarms per year.

    Raises
    ------
    UsageError
        Invalid options, at once; a missing file or column, after the other results are printed.
    """
    if (baseline_rows is None) == (baseline_where is None):
        raise UsageError("the baseline is not given: use --baseline-rows N or --baseline-where COLUMN=VALUE")
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
            f"--budget {budget:g} at {sets_per_day:g} sets per day is an alarm in {design.run_length:.3g} "
            f"sets; charts are designed for more than 1 and at most {LONGEST_RUN:.0e}"
        )
    with _open_parallel_map(tables) as mapped:
        assess_table = partial(
            try_to_assess_table, read=read, budget=design, with_rows=as_json and not no_rows
        )
        results: list[tuple[Sensor, UsageError | None]] = list(mapped(assess_table, tables))
        readable = {path: one for path, (one, error) in zip(tables, results, strict=True) if error is None}
        of_fleet = None
        if fleet and readable:
            own_alarms = [one.alarm["rows"] for one in readable.values()]
            of_fleet = assess_fleet([*readable], read, mapped, design, false_discovery_rate, own_alarms)
    if as_json:
        answer = {
            "sensors": [one.as_json() for one, _ in results],
            **({"fleet": of_fleet} if of_fleet else {}),
        }
        click.echo(json.dumps(answer, allow_nan=False))
    else:
        for one, _ in results:
            click.echo(describe_sensor(one, budget, sets_per_day))
        if of_fleet:
            click.echo(describe_fleet(of_fleet))
    for _, error in results:
        if error is not None and not isinstance(error, NoTableError):
            raise error  # no fault of a file's content: the line asked for what is not there


@contextmanager
def _open_parallel_map(tables: tuple[Path, ...]) -> Iterator[Map]:
    """Provide a function like `map`, with processes and, on a terminal, progress for many files.

    Fewer than `FEW_FILES` files or one core give `map` itself. The processes end with the context.
    """
    workers = min(count_usable_cores(), -(-len(tables) // FILES_A_TASK))
    if len(tables) < FEW_FILES or workers < 2:
        yield map
        return
    with open_executor("processes", workers) as executor:

        def map_in_processes(function: Callable[[Any], Any], paths: Sequence[Any]) -> Iterator[Any]:
            """Apply a function to paths in processes and yield the results in order."""
            progress = Progress(len(paths), 0, what="tables") if sys.stderr.isatty() else None
            for result in executor.map(function, paths, chunksize=FILES_A_TASK):
                if progress is not None:
                    progress.advance(1)
                yield result

        yield map_in_processes


def try_to_assess_table(
    path: Path, *, read: Read, budget: Budget, with_rows: bool
) -> tuple[Sensor, UsageError | None]:
    """Assess one table; return its result and None, or a refused result and the UsageError of reading it.

    ``with_rows`` adds the statistics of each row.
    """
    try:
        return assess_one_table(path, read=read, budget=budget, with_rows=with_rows), None
    except UsageError as error:
        return Sensor(file=str(path), refused=str(error), rows=() if with_rows else None), error


def assess_one_table(path: Path, *, read: Read, budget: Budget, with_rows: bool) -> Sensor:
    """Assess one table and return the result for JSON; a baseline that cannot be used is its ``refused``.

    Warns on standard error if the last row is baseline, so that nothing is assessed. ``with_rows`` adds the
    statistics of each row. Raises UsageError if the table cannot be read.
    """
    table = read(path)
    assessed = assess_sequence(table.vectors, table.in_baseline, table.names, budget, textbooks=with_rows)
    answer = Sensor(
        file=str(path),
        refused=assessed.refused,
        features_dropped=assessed.features_dropped,
        columns_assessed=table.names,
        columns_left_out=table.left_out,
        rows=() if with_rows else None,
    )
    if assessed.refused is not None:
        return answer
    not_assessed, rows = None, len(table.vectors)
    if table.in_baseline[-1]:
        not_assessed = f"the last of {rows} rows is baseline: no row is assessed; give a smaller baseline"
        click.echo(f"{path}: {not_assessed}", err=True)
    return replace(
        answer,
        nothing_judged=not_assessed,
        n=assessed.n,
        n_eff=assessed.n_eff,
        phi_pooled=assessed.phi_pooled,
        tail=assessed.tail,
        suspects=[{"row": row} for row in assessed.suspects],
        named=[{"kind": anomaly.kind, "rows": list(anomaly.rows)} for anomaly in assessed.named],
        left_out=[{"row": row, "reason": reason} for row, reason in assessed.left_out],
        limits=dict(assessed.limits),
        default_because=assessed.default_reason,
        count=dict(assessed.count),
        first=dict(assessed.first),
        alarm={
            "rows": list(assessed.onsets),
            "rate_guaranteed": not assessed.rate_not_verified_reason,
            "why": assessed.rate_not_verified_reason,
            "limit": assessed.chart_limit,
        },
        rows=_build_result_rows(assessed) if with_rows else None,
    )


def _build_result_rows(assessed: Assessed) -> list[dict[str, float | None]]:
    """Return the statistics of each row for JSON: distance, MEWMA, MCUSUM, chart; None replaces NaN."""
    columns = {
        "distance_squared": assessed.distances_squared,
        "mewma_textbook": assessed.mewma_textbook,
        "mcusum_textbook": assessed.mcusum_textbook,
        "chart": assessed.chart,
    }
    return [
        {"row": row, **{name: finite_or_none(float(column[row])) for name, column in columns.items()}}
        for row in range(len(assessed.chart))
    ]


def describe_sensor(answer: Sensor, budget: float, sets_per_day: float) -> str:
    """Format the result of a transducer as text; ``budget`` in false alarms per year at ``sets_per_day``."""
    if answer.refused is not None:
        return f"{answer.file}: refused: {answer.refused}"
    alarm, lines = answer.alarm, [answer.file]
    lines.append(f"  columns    {', '.join(answer.columns_assessed)}")
    for item in answer.columns_left_out:
        lines.append(
            f"  left out   {item['name']!r}: {item['reason']} ({item['cell']!r} in row {item['row']})"
        )
    lines.append(
        f"  baseline   {answer.n} sets, worth {answer.n_eff:.0f} independent ones"
        f" (memory {answer.phi_pooled:.2f}), tails {answer.tail:.2f} x normal"
    )
    if answer.features_dropped:
        lines.append(f"  dropped    {', '.join(answer.features_dropped)}: constant in the baseline")
    for anomaly in answer.named:
        rows, kind = anomaly["rows"], anomaly["kind"]
        row_text = f"{rows[0]} to {rows[-1]}" if kind == "trend" else ", ".join(map(str, rows))
        lines.append(f"  inspect    {kind}, rows {row_text}")
    for name, limit in answer.limits.items():
        first = answer.first[name]
        since = "" if first is None else f", first row {first}"
        caveat = f"; {LIMITS[name].caveat}" if LIMITS[name].caveat else ""
        lines.append(f"  {name:<15} limit {limit:9.2f}  above {answer.count[name]}{since}{caveat}")
    lines.append(f"  default    {answer.default_because}")
    promise = f"{budget:g} false alarms per year at {sets_per_day:g} sets per day"
    rate_text = promise if alarm["rate_guaranteed"] else f"{promise} not promised: {alarm['why']}"
    raised = ", ".join(map(str, alarm["rows"][:10])) + (" ..." if len(alarm["rows"]) > 10 else "")
    lines.append(f"  alarms     {f'at rows {raised}' if alarm['rows'] else 'none'} ({rate_text})")
    return "\n".join(lines)
