"""``solimon replay``: reassess a stored test with other settings and list the changes."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from daq_service.cli.terminal import print_set_progress
from daq_service.errors import UsageError
from daq_service.processes.executors import count_usable_cores, validate_executor_name
from daq_service.processes.printing import print_result
from daq_service.recording.reassessment.changes import Difference, Onset
from daq_service.recording.reassessment.replay import Replayed, replay_test

PROCESS_EVENTS = ("row", "cause", "outlier", "mewma_alarm")
"""Columns that are listed first: the result of a set, before its numbers."""


def run_replay(
    *,
    data_dir: Path,
    given: tuple[str, ...],
    extract: bool,
    executor: str | None,
    workers: int | None,
    as_json: bool,
) -> None:
    """Run `solimon replay`: reassess a stored test with changed settings and print the differences.

    The folder is only read. ``given`` are settings ``KEY=VALUE``; with ``extract`` features are extracted
    from the waveforms again, by ``workers`` of an executor.

    Raises
    ------
    UsageError
        A setting or an option is invalid, or stored features differ in extractor.
    StorageError
        There is no test, or a set of it cannot be read.
    """
    if not extract and (executor or workers):
        raise UsageError("--executor and --workers do the work of --extract; give it, or leave them out")
    by = None
    if extract:
        by = validate_executor_name(executor or "threads", workers), workers or count_usable_cores()
    found = replay_test(data_dir, given, extract_by=by, progress=print_set_progress)
    print_result(asdict(found), describe_replay(found), as_json=as_json)


def describe_replay(found: Replayed) -> Iterable[str]:
    """Yield lines of text: settings, extractor, alarms, changed baselines and sets, positions not assessed.

    One line at the end states if nothing changes.
    """
    source = "from the waveforms" if found.extracted else "as stored"
    settings_text = ", ".join(f"{key} = {json.dumps(value)}" for key, value in found.changed.items())
    yield f"{found.experiment}: {found.sets} sets reassessed with {settings_text or 'the same settings'}"
    yield f"features {source}, extractor {found.extractor_version}"
    alarms = found.alarms
    for one in alarms.moved:
        by_h = one.again.hour - one.stored.hour
        yield (
            f"moves  {one.stored.position} {one.stored.kind}: {_format_onset(one.stored)} -> "
            f"{_format_onset(one.again)}, {abs(by_h):.2f} h {'later' if by_h > 0.0 else 'earlier'}"
        )
    for change, onsets_of_change in (("comes", alarms.come), ("goes", alarms.go), ("stays", alarms.kept)):
        for onset in onsets_of_change:
            yield f"{change:<6} {onset.position} {onset.kind}: {_format_onset(onset)}"
    for row in found.differences:
        if row.table == "baseline" and isinstance(row.stored, int | float | None):
            before, after = _format_six_digits(row.stored), _format_six_digits(row.again)
            yield f"baseline {row.position}: {row.column} {before} -> {after}"
    yield from _count_differing_sets(found.differences)
    for position in found.not_assessed:
        yield position.description
    if not (alarms.moved or alarms.come or alarms.go or found.differences):
        yield "nothing changes: all alarms, limits and assessments are as stored"


def _count_differing_sets(found: Iterable[Difference]) -> Iterable[str]:
    """Yield one line per table and position with the number of differing sets per column.

    A column of named values is represented by the name that differs in most sets. Baselines are left out.
    """
    by_place: dict[tuple[str, str], dict[str, Difference]] = {}
    for row in found:
        if row.table != "baseline":
            columns = by_place.setdefault((row.table, row.position), {})
            name = row.column.partition(".")[0]
            columns[name] = max(columns.get(name, row), row, key=lambda one: one.n_rows)
    for (table, position), columns in by_place.items():
        alike: dict[tuple[int, int], list[str]] = {}
        for name in sorted(columns, key=lambda name: (*PROCESS_EVENTS, name).index(name)):
            row = columns[name]
            alike.setdefault((row.n_rows, row.first_set_index), []).append(row.column)
        parts = [
            f"{', '.join(names)} in {f'{n} sets from set {first} on' if n > 1 else f'set {first}'}"
            for (n, first), names in alike.items()
        ]
        yield f"{table} {position}: {'; '.join(parts)}"


def _format_onset(onset: Onset) -> str:
    """Format the set and the hour of an alarm's onset: ``set 12, hour 6.00``."""
    return f"set {onset.set_index}, hour {onset.hour:.2f}"


def _format_six_digits(value: float | None) -> str:
    """Format a value with six significant digits; None gives "none"."""
    return "none" if value is None else f"{value:.6g}"
