"""``solimon replay``: reassess a stored test with other settings and list the changes."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click

from analysis.waves.features import EXTRACTOR_VERSION
from daq_service.archive import FolderSetReader
from daq_service.assessment.baseline_lifecycle import baseline_range
from daq_service.catalogue import Catalogue, open_catalogue
from daq_service.catalogue.rows import AssessmentRow, FeatureRow
from daq_service.errors import UsageError
from daq_service.processes.data_folder import refuse_other_folders
from daq_service.processes.executors import checked_name, opened_executor, usable_cores, workers_of
from daq_service.recording.reassessment.changes import (
    ASSESSED,
    EXTRACTED,
    AlarmChanges,
    Difference,
    Onset,
    alarm_changes,
    differences,
    onsets,
)
from daq_service.recording.reassessment.features_ahead import ExtractedAhead
from daq_service.recording.reassessment.other_settings import changed, parsed
from daq_service.recording.reassessment.reassess import (
    Progress,
    assess_again,
    printed_progress,
    stored_features,
    temporary_catalogue,
)
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import in_order
from hardware_drivers.methods import SOLITARY_WAVE

PROCESS_EVENTS = ("row", "cause", "outlier", "chart_alarm")
"""Columns that are listed first: the result of a set, before its numbers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NotAssessed:
    """All sets of a position belong to its baseline, or to one that is never complete.

    Attributes
    ----------
    first_set_index, last_set_index
        Sets that the baseline takes.
    last_set
        The position's last one.
    told
         Message with the remedy.
    """

    position: str
    first_set_index: int
    last_set_index: int
    last_set: int
    told: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Replayed:
    """Result of a reassessment with other settings.

    Attributes
    ----------
    extractor_version
        Extractor of the assessed features.
    """

    experiment: str
    changed: Mapping[str, Any]
    extracted: bool
    extractor_version: str
    sets: int
    not_assessed: list[NotAssessed]
    alarms: AlarmChanges
    differences: list[Difference]


def run_replay(
    *,
    data_dir: Path,
    given: tuple[str, ...],
    extract: bool,
    executor: str | None,
    workers: int | None,
    as_json: bool,
) -> None:
    """Reassess a stored test and print the changes; the folder is only read."""
    if not extract and (executor or workers):
        raise UsageError("--executor and --workers do the work of --extract; give it, or leave them out")
    by = None
    if extract:
        by = checked_name(executor or "threads", workers), workers or usable_cores()
    found = replayed(data_dir, given, extract_by=by, progress=printed_progress)
    if as_json:
        click.echo(json.dumps(asdict(found)))
        return
    for line in in_words(found):
        click.echo(line)


def replayed(
    folder: Path,
    given: Iterable[str],
    *,
    extract_by: tuple[str, int] | None = None,
    progress: Progress = lambda done, total: None,
) -> Replayed:
    """Reassess a stored test with changed settings, and compare with the stored results.

    Parameters
    ----------
    given
        ``KEY=VALUE`` each; without any the test's own settings are used.
    extract_by
        Executor and number of workers that take the features from the waveforms again; None: the stored ones.

    Raises
    ------
    UsageError
        A setting is invalid or does not concern the assessment, or stored features differ in extractor.
    StorageError
        There is no test, or a set of it cannot be read.
    """
    settings_given = parsed(tuple(given))
    refuse_other_folders(folder)
    with ExitStack() as stack:
        stored = stack.enter_context(open_catalogue(folder))
        experiment = stored.experiment_row()
        settings = changed(experiment.configuration, settings_given)
        again = stack.enter_context(temporary_catalogue(experiment))
        assess_set = partial(assess_again, stored, again, folder, settings, progress=progress)
        if extract_by is None:
            versions = stored.columns(FeatureRow, ("extractor_version",))["extractor_version"]
            extractor = _one_extractor(versions)
            sets = assess_set(partial(stored_features, stored))
        else:
            extractor, (name, workers) = EXTRACTOR_VERSION, extract_by
            executor = stack.enter_context(opened_executor(name, workers))
            archive = FolderSetReader(folder)
            files = archive.sets()
            ahead = ExtractedAhead(
                executor=executor,
                workers=workers_of(executor, workers),
                rehearsal=settings.rig.dry_run,
                read=archive.read_set,
                references=iter([files[index] for index in sorted(files, key=in_order)]),
            )
            sets = assess_set(ahead.features, read_set=ahead.read_set)
        last = max(sets, key=in_order, default=None)
        return Replayed(
            experiment=experiment.name,
            changed={".".join(path): value for path, value in settings_given.items()},
            extracted=extract_by is not None,
            extractor_version=extractor,
            sets=len(sets),
            not_assessed=[
                one
                for name in settings.names_of(SOLITARY_WAVE)
                for one in _not_assessed(name, again, settings)
            ],
            alarms=alarm_changes(onsets(stored, last), onsets(again, last)),
            differences=differences(
                (*EXTRACTED, *ASSESSED) if extract_by else ASSESSED, stored, again, up_to_set=last
            ),
        )


def _not_assessed(position: str, recomputed: Catalogue, settings: Settings) -> Iterator[NotAssessed]:
    """Yield a message if no set of a position follows its baseline, since no alarm reports it."""
    found = recomputed.columns(AssessmentRow, ("set_index", "in_baseline"), position=position)
    if not all(found["in_baseline"]) or not found["set_index"]:
        return
    sets, last_set = (
        baseline_range(position, settings, recomputed.baseline(position)),
        max(found["set_index"]),
    )
    yield NotAssessed(
        position=position,
        first_set_index=sets.first_set,
        last_set_index=sets.last_set,
        last_set=last_set,
        told=f"nothing is judged at {position}: baseline.hours = {settings.baseline.hours:g} makes the sets "
        f"{sets.first_set} to {sets.last_set} the baseline, and the last one there is set {last_set}; "
        "give fewer hours",
    )


def _one_extractor(versions: Iterable[str]) -> str:
    """Raise an error for features of different extractors, which are different quantities."""
    found = sorted(set(versions))
    if len(found) > 1:
        raise UsageError(
            f"the stored features are of the extractors {' and '.join(found)}, which are different "
            "quantities; take them all from the waveforms with --extract"
        )
    return found[0] if found else EXTRACTOR_VERSION


def in_words(found: Replayed) -> Iterable[str]:
    """Yield the lines of the result."""
    source = "from the waveforms" if found.extracted else "as stored"
    settings_text = ", ".join(f"{key} = {json.dumps(value)}" for key, value in found.changed.items())
    yield f"{found.experiment}: {found.sets} sets judged again with {settings_text or 'the same settings'}"
    yield f"features {source}, extractor {found.extractor_version}"
    alarms = found.alarms
    for one in alarms.moved:
        by_h = one.again.hour - one.stored.hour
        yield (
            f"moves  {one.stored.position} {one.stored.kind}: {_where(one.stored)} -> {_where(one.again)}, "
            f"{abs(by_h):.2f} h {'later' if by_h > 0.0 else 'earlier'}"
        )
    for change, onsets_of_change in (("comes", alarms.come), ("goes", alarms.go), ("stays", alarms.kept)):
        for onset in onsets_of_change:
            yield f"{change:<6} {onset.position} {onset.kind}: {_where(onset)}"
    for row in found.differences:
        if row.table == "baseline" and isinstance(row.stored, int | float | None):
            yield f"baseline {row.position}: {row.column} {_short(row.stored)} -> {_short(row.again)}"
    yield from _of_sets(found.differences)
    for position in found.not_assessed:
        yield position.told
    if not (alarms.moved or alarms.come or alarms.go or found.differences):
        yield "nothing changes: every alarm, limit and verdict is what is stored"


def _of_sets(found: Iterable[Difference]) -> Iterable[str]:
    """Yield the number of differing sets per column, one line per position; `--json` has the values.

    A column of named values is represented by the name that differs in most sets.
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


def _where(onset: Onset) -> str:
    return f"set {onset.set_index}, hour {onset.hour:.2f}"


def _short(value: float | None) -> str:
    return "none" if value is None else f"{value:.6g}"
