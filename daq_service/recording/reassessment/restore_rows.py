"""Fill an empty catalogue with the rows of a stored test.

Rows come from the events and, those of single shots, from the tables of the set files; the assessors follow
them. A set is assessed from its records only where one of both is missing or not as it was stored.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeVar

import orjson

from analysis.waves.quality_gate import ACCEPTED, SUPERSEDED
from daq_service.acquisition.shot_features import FeaturesOf, choose_extraction
from daq_service.alarms.delays import DELAY_EVENT
from daq_service.alarms.states import index_alarm
from daq_service.archive import (
    ArchiveError,
    CorruptArchiveError,
    FolderSetReader,
    SetRecord,
    SetReference,
    SetTables,
)
from daq_service.assessment.assessor import StoredResult
from daq_service.assessment.baseline_lifecycle import STEPS
from daq_service.assessment.confirmation import CONFIRMATION_ASKED
from daq_service.assessment.follow_rows import replay_stored_set
from daq_service.assessment.restore_state import affects_state, read_first_waveform
from daq_service.assessment.results_in_file import build_result_tables, find_differences
from daq_service.catalogue import RecorderCatalogue, SetCommit
from daq_service.catalogue.reported_rows import ROW_OF_EVENT, join_rows, strip_payloads, to_payloads
from daq_service.catalogue.rows import (
    MEASURED,
    AlarmRow,
    AnnotationRow,
    AssessmentRow,
    BaselineRow,
    EnvironmentRow,
    EventRow,
    ExperimentRow,
    FeatureRow,
    Row,
    SetRow,
    ShotRow,
    ThicknessRow,
    WallRow,
)
from daq_service.recording.experiment import find_foreign_reason
from daq_service.recording.reassessment.changes import drop_diagnosis_state
from daq_service.recording.reassessment.stored_runs import Progress, Run, full_row, group_sets, repeat_action
from daq_service.recording.set_assessor import SetAssessor
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import DueSet

R = TypeVar("R", bound=Row)

_STORED_ROWS: Mapping[str, type[Row]] = {**ROW_OF_EVENT, "baseline_frozen": BaselineRow}
"""Kinds of events that report a complete row."""
_RESTORED_ROWS = ("sets", "shots", "features", "thickness", "wall", "baselines", "assessments", "environment")
_SETS_OF_A_COMMIT = 64
"""Restored sets are stored together: a commit costs more than the rows of a set."""
_COMPUTED = ("set_features", "thickness_read", "baseline_frozen", "set_assessed")


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredHistory:
    """Events and checksums of a test that its sets do not hold.

    Attributes
    ----------
    events
        By id.
    digests
        SHA-256 by the name of a set's file.
    """

    events: Mapping[int, EventRow] = field(default_factory=dict)
    digests: Mapping[str, str] = field(default_factory=dict)


@dataclass(slots=True, kw_only=True, eq=False)
class Restored:
    """Result of a restoration.

    Attributes
    ----------
    sets, computed
        Numbers of sets with a file, and of those that were assessed from their records.
    damaged
        Sets that cannot be read completely: their rows are those of the history.
    foreign
        Sets of another experiment.
    differing
        Results that differ from those stored when the set was taken.
    """

    sets: int = 0
    computed: int = 0
    damaged: list[str] = field(default_factory=list)
    foreign: list[str] = field(default_factory=list)
    differing: list[str] = field(default_factory=list)


def restore_rows(
    settings: Settings,
    experiment: ExperimentRow,
    archive: FolderSetReader,
    catalogue: RecorderCatalogue,
    history: StoredHistory,
    progress: Progress,
    features_of: FeaturesOf | None = None,
) -> Restored:
    """Fill a catalogue that has its experiment and nothing else; return counts and findings.

    The caller recomputes the counts of the catalogue. A set that cannot be read gets the rows of the history.
    ``progress`` is called with the numbers of done and of all files.

    Raises
    ------
    StorageError
        The catalogue refuses, or the journal cannot be read.
    """
    return _Restoration(settings, experiment, archive, catalogue, history, features_of).run(progress)


class _Restoration:
    """Restores the sets of a test one after the other; stores their rows in commits of 64 sets."""

    def __init__(
        self,
        settings: Settings,
        experiment: ExperimentRow,
        archive: FolderSetReader,
        catalogue: RecorderCatalogue,
        history: StoredHistory,
        features_of: FeaturesOf | None,
    ) -> None:
        """Create the assessor that follows the restored sets; store nothing yet."""
        self._settings, self._experiment = settings, experiment
        self._archive, self._catalogue, self._history = archive, catalogue, history
        rehearsal = settings.rig.dry_run
        self._features_of = choose_extraction(settings.positions, rehearsal=rehearsal, given=features_of)
        self._set_assessor = SetAssessor(settings, archive, catalogue, None, rehearsal=rehearsal)
        self._alarms: dict[int, AlarmRow] = {}
        self._late: list[EventRow] = []
        self._pending, self._n_pending = SetCommit(), 0
        self._result = Restored()

    def run(self, progress: Progress) -> Restored:
        """Restore or compute the rows of every set, in the order of the history, and store them.

        Sets without events come in before the next set; ``progress`` gets the numbers of done and of all
        files.
        """
        files = dict(self._archive.sets())
        total = len(files)
        runs = list(group_sets(event for _, event in sorted(self._history.events.items())))
        without_events = sorted(files.keys() - {key for key, _ in runs})
        for number, (set_key, events) in enumerate(runs):
            if set_key is None:
                self._apply_events(events)
                continue
            # A set without any event is assessed before the next one.
            while without_events and without_events[0] < set_key:
                self._assess_file(files.pop(without_events.pop(0)), [], range(0))
            free = _find_free_ids(
                events, runs[number - 1][1] if number else [], runs[number + 1 : number + 2]
            )
            reference = files.pop(set_key, None)
            if reference is None:
                self._restore_rows(SetCommit(), events)
            elif free or not self._restore_from_tables(reference, events):
                self._assess_file(reference, events, free)
            progress(total - len(files), total)
        for reference in files.values():
            self._assess_file(reference, [], range(0))
            progress(total, total)
        self._pending.events += self._late
        self._store_pending()
        self._catalogue.restore_rows(self._alarms.values())
        return self._result

    def _apply_events(self, events: Sequence[EventRow]) -> None:
        """Queue consecutive events without a set; store annotations and baselines and repeat actions."""
        self._pending.events += events
        for event in events:
            self._apply_alarm_event(event)
            if event.topic == "annotations":
                self._catalogue.restore_rows([full_row(AnnotationRow, event, "annotation_id")])
            if event.kind in STEPS:
                self._store_pending()
                self._catalogue.restore_rows([full_row(BaselineRow, event)])
            repeat_action(event, self._set_assessor.assessors, self._settings.positions)

    def _apply_alarm_event(self, event: EventRow) -> None:
        """Update alarms, delays and requested sets in memory with an event of the history."""
        self._set_assessor.apply_stored_event(event)
        if event.topic == "alarms" and event.kind != DELAY_EVENT:
            row = full_row(AlarmRow, event, "alarm_id")
            self._alarms[row.id or 0] = row
            index_alarm(self._set_assessor.alarms, row)

    # Rows that are stored -------------------------------------------------------------------------

    def _restore_from_tables(self, reference: SetReference, events: Sequence[EventRow]) -> bool:
        """Restore a set from its events and the tables of its file; False if one of them lacks something.

        Then nothing is changed. The file must have the stored SHA-256. Features of a set that are not means
        of its shots are never restored so.
        """
        digest = self._history.digests.get(reference)
        averaged = self._settings.features.of_set != "mean_of_shots"
        tables = None if digest is None or averaged else self._archive.read_tables(reference, digest)
        if tables is None:
            return False
        rows = build_shot_rows(tables, due_h=float(_collect_rows(SetRow, events)[0].due_h))
        if rows is None:
            return False
        shots, features = rows
        self._restore_rows(SetCommit(shots=shots, features=features), events)
        self._result.sets += 1
        return True

    def _restore_rows(self, transaction: SetCommit, events: Sequence[EventRow]) -> None:
        """Queue the stored rows of a set and update the assessors with them; list a lost file as damaged.

        ``transaction`` has the rows of its shots, if there are any, and gets the others from the events.
        """
        transaction = _replace_computed_rows(transaction, events, all_rows=True)
        # The events of a set with all its records are complete: a position without one was left out.
        left_out = dict.fromkeys(self._settings.positions, "disabled") if transaction.shots else {}
        transaction.sets = self._add_disabled_rows(transaction.sets, left_out | self._set_assessor.disabled())
        places = list(self._settings.positions)  # as a recorder orders them
        transaction.features.sort(key=lambda row: (places.index(row.position), row.shot_index is None))
        if any(row.n_taken for row in transaction.sets) and not transaction.shots:
            self._result.damaged.append(f"set {transaction.sets[0].set_key}: its file is gone")
        self._update_states(transaction)
        self._queue_rows(transaction, events)

    def _update_states(self, transaction: SetCommit) -> None:
        """Update the assessors with the rows of a set; add the assessments of a baseline that it completes.

        They precede those of the set in ``transaction``.
        """
        results: dict[str, FeatureRow | ThicknessRow] = {row.position: row for row in transaction.thickness}
        results |= {row.position: row for row in transaction.features if row.shot_index is None}
        completed: list[AssessmentRow] = []
        for row in filter(affects_state, transaction.sets):
            followed = replay_stored_set(
                self._set_assessor.assessors[row.position],
                StoredResult(
                    its_set=row,
                    result=results.get(row.position),
                    flags=[
                        shot.flags
                        for shot in transaction.shots
                        if shot.position == row.position and shot.outcome == ACCEPTED
                    ],
                    waveform=partial(read_first_waveform, self._archive, row),
                ),
            )
            own = [item for item in transaction.assessments if item.position == row.position]
            known = {item.set_key for item in own}
            completed += [*(item for item in followed if item.set_key not in known), *own]
        transaction.assessments = completed

    def _add_disabled_rows(self, stored: Sequence[SetRow], left_out: Mapping[str, str]) -> list[SetRow]:
        """Return a set's rows with those of disabled positions and the SHA-256 of its file, by position.

        Each position in ``left_out`` (with its reason) without a row gets a disabled one, unless the set is
        unscheduled or has no row at all. Rows of positions that the settings lack are dropped.
        """
        rows = {row.position: row for row in stored}
        of_the_plan = stored and stored[0].purpose is None
        for position, reason in left_out.items() if of_the_plan else ():
            first = stored[0]
            due = DueSet(set_index=first.set_index, due_h=first.due_h, due_utc_ns=first.due_utc_ns)
            disabled = self._set_assessor.build_empty_row(due, position, disabled=True, reason=reason)
            rows.setdefault(position, disabled)
        digests = self._history.digests
        rows = {name: replace(row, file_sha256=digests.get(row.file or "")) for name, row in rows.items()}
        return [rows[position] for position in self._settings.positions if position in rows]

    # Sets that are assessed -----------------------------------------------------------------------

    def _assess_file(self, reference: SetReference, events: Sequence[EventRow], free: Sequence[int]) -> None:
        """Restore the rows of a set from its file, and compute those that the history lacks.

        Of a corrupt file the readable records and the stored rows are used; a foreign set is listed and left
        out. ``free`` are the unused event ids of the set. Differences from the stored results are listed.
        """
        damage = ""
        try:
            record = self._archive.read_set(reference)
        except CorruptArchiveError as error:
            damage = str(error)
            self._result.damaged.append(damage)
            try:
                record = self._archive.read_set(reference, skip_damaged=True)
            except ArchiveError:
                if events:
                    self._restore_rows(SetCommit(), events)
                return
        if why := find_foreign_reason(record, self._experiment):
            self._result.foreign.append(f"{reference}: {why}")
            return
        due = record.due
        features = {shot.sequence: self._features_of(shot) for shot in record.shots}
        sha256 = self._find_file_digest(reference)
        states = self._set_assessor.assessors.states
        transaction = self._set_assessor.assessed(due, record, reference, features, sha256=sha256)
        if record.results and not damage:
            again = build_result_tables(transaction.features, transaction.thickness, transaction.shots)
            found = find_differences(record.results, again)
            self._result.differing += [f"set {due.set_key}, its file: {difference}" for difference in found]
        self._add_environment(transaction, record)
        computed = join_rows(transaction.events, to_payloads(_collect_reported_rows(transaction)))
        if events:
            if not damage:
                self._result.differing += _find_differences(computed, events)
            _replace_computed_rows(transaction, events, all_rows=bool(damage))
            if damage:  # the state follows the stored rows, which are of all records
                self._set_assessor.assessors.states = states
                self._update_states(transaction)
        self._queue_rows(transaction, self._merge_events(computed, events, free), computed_alarms=not events)
        self._result.sets += 1
        self._result.computed += 1

    def _find_file_digest(self, reference: SetReference) -> str | None:
        """Return the SHA-256 of a set's file in the history, else that of the file; None without both.

        A difference between the two is listed as damage. Raises ArchiveError if the file cannot be read.
        """
        found, expected = self._archive.digest(reference), self._history.digests.get(reference)
        if found is not None and expected not in (None, found):
            self._result.damaged.append(f"{reference} is not the file that was stored: its SHA-256 differs")
        return expected or found

    def _add_environment(self, transaction: SetCommit, record: SetRecord) -> None:
        """Add the row of supply and climate from a scheduled set's file, unless the transaction has one."""
        if record.environment and not transaction.environment and not record.unscheduled_index:
            row = EnvironmentRow(set_index=record.set_index, due_h=record.due_h, **record.environment)  # type: ignore[arg-type] # its columns
            transaction.environment.append(row)

    def _queue_rows(
        self, transaction: SetCommit, events: Sequence[EventRow], *, computed_alarms: bool = False
    ) -> None:
        """Queue the rows and events of a set; store them after 64 sets.

        Those queued before a new baseline are stored first. ``computed_alarms`` True: the set has no stored
        events, so it is stored at once with its computed alarms.
        """
        if computed_alarms:
            # This set has no events: its alarms follow from its assessment.
            self._store_pending()
            self._catalogue.restore_rows(self._alarms.values())
            transaction.events = strip_payloads(events, _collect_reported_rows(transaction))
            self._set_assessor.commit(transaction)
            self._alarms |= {row.id or 0: row for row in self._set_assessor.alarms.values()}
            return
        if transaction.baselines:  # their assessments replace those of the sets before
            self._store_pending()
        for name in _RESTORED_ROWS:
            getattr(self._pending, name).extend(getattr(transaction, name))
        self._pending.events += events
        self._n_pending += 1
        if self._n_pending == _SETS_OF_A_COMMIT:
            self._store_pending()
        self._set_assessor.confirmations.apply_rows(transaction)
        for event in events:
            self._apply_alarm_event(event)

    def _store_pending(self) -> None:
        """Store the queued rows and events in one commit, with the states after them, and empty the queue.

        Raises CatalogueError.
        """
        self._pending.states = self._set_assessor.assessors.collect_changed_states()
        self._pending.events = strip_payloads(self._pending.events, _collect_reported_rows(self._pending))
        self._catalogue.commit_set(self._pending)
        self._pending, self._n_pending = SetCommit(), 0

    def _merge_events(
        self, computed: Sequence[EventRow], stored: Sequence[EventRow], free: Sequence[int]
    ) -> list[EventRow]:
        """Return the stored events of a set with the computed ones that the history lost in between.

        The lost ones get the ids in ``free``, if there are as many; else they are stored at the end of the
        restoration. Without stored events all computed ones are returned.
        """
        if not stored:
            return list(computed)
        known = {_build_key(event) for event in stored}
        # The request of an unscheduled set is stored, never computed.
        lost = [
            event
            for event in computed
            if _build_key(event) not in known and event.topic != "alarms" and event.kind != CONFIRMATION_ASKED
        ]
        if len(lost) == len(free):
            again = [replace(event, id=row_id) for event, row_id in zip(lost, free, strict=True)]
            return sorted([*stored, *again], key=lambda event: event.id or 0)
        self._late += lost
        return list(stored)


def _find_free_ids(
    events: Sequence[EventRow],
    before: Sequence[EventRow],
    following: Sequence[Run],
) -> list[int]:
    """List the unused event ids, in order, between the events before a set and those of the next run."""
    first = (before[-1].id or 0) if before else 0
    last = (following[0][1][0].id or 0) if following else (events[-1].id or 0) + 1
    return sorted(set(range(first + 1, last)) - {event.id for event in events if event.id is not None})


def _build_key(event: EventRow) -> tuple[str, str, str | None]:
    """Return topic, kind and position, which identify an event within its set."""
    return event.topic, event.kind, event.position


def build_shot_rows(tables: SetTables, *, due_h: float) -> tuple[list[ShotRow], list[FeatureRow]] | None:
    """Build the rows of a set's shots, and their features, from the tables of its file, in order.

    Returns None if a shot has no result there. ``due_h`` is the hour at which the set was due.
    """
    results = {
        int(row["shot_id"]): row for name in ("features", "thickness") for row in tables.results.get(name, ())
    }
    shots, features = [], []
    for row in tables.shots:
        result = results.get(row["shot_id"])
        if result is None:
            return None
        key = {**tables.set_key._asdict(), "position": row["position"], "shot_index": row["shot_index"]}
        stamp = {name: row[name] for name in ("attempt", "utc_ns", "mono_ns", "boot_id", "crc32")}
        shots.append(
            ShotRow(
                sequence=row["shot_id"],
                **key,
                **stamp,
                valid=bool(result["valid"]),
                flags=str(result["flags"]).split(),
                outcome=SUPERSEDED if row["outcome"] == SUPERSEDED else ACCEPTED,
            )
        )
        if "tof_pp_s" in result:
            values = {name: result[name] for name in ("extractor_version", "quality", "n_valid")}
            measured_values: dict[str, Any] = {
                name: _none_if_not_finite(result.get(name)) for name in MEASURED[FeatureRow]
            }
            features.append(
                FeatureRow(**key, sequence=row["shot_id"], due_h=due_h, **values, **measured_values)
            )
    return shots, features


def _none_if_not_finite(value: float | None) -> float | None:
    """Return the value, or None if it is None, NaN or infinite."""
    return value if value is not None and math.isfinite(value) else None


def _replace_computed_rows(
    transaction: SetCommit, events: Sequence[EventRow], *, all_rows: bool = False
) -> SetCommit:
    """Replace computed rows in a transaction by the stored ones of a set's events; return the transaction.

    Rows of sets and environment are replaced, the results only if the set has no shots.

    Parameters
    ----------
    all_rows
        Replace the results, too: the records are not there, or not all.
    """
    transaction.sets = _merge_set_rows(transaction.sets, _collect_rows(SetRow, events))
    transaction.environment = _collect_rows(EnvironmentRow, events) or transaction.environment
    transaction.wall = _collect_rows(WallRow, events)
    if all_rows or not transaction.shots:
        single = [row for row in transaction.features if row.shot_index is not None]
        transaction.features = [*single, *_collect_rows(FeatureRow, events)]
        stored = {row.sequence for row in transaction.shots}
        transaction.thickness = [
            row if row.sequence in stored else replace(row, sequence=None)
            for row in _collect_rows(ThicknessRow, events)
        ]
        transaction.baselines = _collect_rows(BaselineRow, events)
        transaction.assessments = _collect_rows(AssessmentRow, events)
    return transaction


def _collect_reported_rows(transaction: SetCommit) -> list[Row]:
    """List the rows of a transaction that events report; of features only those of sets."""
    of_set = [row for row in transaction.features if row.shot_index is None]
    of_waves = (transaction.sets, of_set, transaction.wall, transaction.assessments)
    return list(itertools.chain(*of_waves, transaction.thickness, transaction.environment))


def _merge_set_rows(computed: Sequence[SetRow], stored: Sequence[SetRow]) -> list[SetRow]:
    """Return the stored rows of a set with the computed SHA-256, and computed rows of other positions.

    Computed positions come first, in their order.
    """
    digests = {row.position: row.file_sha256 for row in computed}
    rows = {row.position: row for row in computed}
    rows |= {row.position: replace(row, file_sha256=digests.get(row.position)) for row in stored}
    return list(rows.values())


def _collect_rows(kind: type[R], events: Sequence[EventRow]) -> list[R]:
    """Build the rows of one kind that events contain, in the order of the events; ignore other events."""
    return [full_row(kind, event) for event in events if _STORED_ROWS.get(event.kind) is kind]


def _find_differences(computed: Sequence[EventRow], stored: Sequence[EventRow]) -> list[str]:
    """List set, position and kind of each stored event whose computed result differs.

    Columns that the stored event lacks, and diagnosis states in averages, are not compared.
    """
    found = {_build_key(event): event for event in computed if event.kind in _COMPUTED}
    return [
        f"set {event.set_key}, {event.position}: {event.kind}"
        for event in stored
        if _build_key(event) in found
        and _select_stored_columns(event, found[_build_key(event)])
        != _encode_sorted(drop_diagnosis_state(event.payload))
    ]


def _select_stored_columns(stored: EventRow, computed: EventRow) -> bytes:
    """Encode the computed payload with only the columns of the stored one: an earlier version had fewer."""
    return _encode_sorted({name: value for name, value in computed.payload.items() if name in stored.payload})


def _encode_sorted(payload: Mapping[str, Any]) -> bytes:
    """Encode a payload as JSON bytes with sorted keys, to compare it; NaN and infinities become null."""
    return orjson.dumps(payload, option=orjson.OPT_SORT_KEYS | orjson.OPT_SERIALIZE_NUMPY)
