"""Replay a stored test: reassess its sets in commit order, with all actions of people and devices.

Events give the order: their ids are those of the commits. The events of one set are consecutive; a single
event is a command, an alarm of a device or a message of the recorder.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any, TypeVar

import orjson

from analysis.waves.features import ShotFeatures
from daq_service.acquisition.schedule import DueSet
from daq_service.acquisition.taken_set import due_of, features_of, features_of_a_rehearsal
from daq_service.alarms.delays import DELAY_EVENT
from daq_service.alarms.states import RETIRING
from daq_service.archive import ArchiveError, CorruptArchiveError, SetReader, SetRecord, SetReference
from daq_service.assessment.baseline_lifecycle import STEPS
from daq_service.assessment.confirmation import CONFIRMATION_ASKED
from daq_service.assessment.results_in_file import find_differences, results_of
from daq_service.assessment.transaction import Transaction
from daq_service.catalogue import RecorderCatalogue
from daq_service.catalogue.rows import (
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
    ThicknessRow,
)
from daq_service.recording.cost import Cost
from daq_service.recording.experiment import foreign_reason
from daq_service.recording.set_assessor import SetAssessor, without_records
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import Shot, in_order, purpose_of

log = logging.getLogger(__name__)

R = TypeVar("R", bound=Row)
FeaturesOf = Callable[[Shot], ShotFeatures]

_STORED_ROWS: Mapping[str, type[Row]] = {
    "set_done": SetRow,
    "set_partial": SetRow,
    "set_missed": SetRow,
    "set_retired": SetRow,
    "set_features": FeatureRow,
    "thickness_read": ThicknessRow,
    "baseline_frozen": BaselineRow,
    "set_judged": AssessmentRow,
    "environment_read": EnvironmentRow,
}
"""Kinds of events that hold a complete row."""
_COMPUTED = ("set_features", "thickness_read", "baseline_frozen", "set_judged")


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
class Replayed:
    """What came of it.

    Attributes
    ----------
    damaged
        Sets that cannot be read completely: their rows are those of the history.
    foreign
        Sets of another experiment.
    differing
        Results that differ from those stored when the set was taken.
    """

    sets: int = 0
    damaged: list[str] = field(default_factory=list)
    foreign: list[str] = field(default_factory=list)
    differing: list[str] = field(default_factory=list)


def replay(
    settings: Settings,
    experiment: ExperimentRow,
    archive: SetReader,
    catalogue: RecorderCatalogue,
    history: StoredHistory,
    progress: Callable[[int, int], None],
    features_of: FeaturesOf = features_of,
) -> Replayed:
    """Fill a catalogue that has its experiment and nothing else.

    Parameters
    ----------
    progress
        Called with the sets that are done and their number.
    """
    return _Replay(settings, experiment, archive, catalogue, history, features_of).run(progress)


class _Replay:
    def __init__(
        self,
        settings: Settings,
        experiment: ExperimentRow,
        archive: SetReader,
        catalogue: RecorderCatalogue,
        history: StoredHistory,
        features_of: FeaturesOf,
    ) -> None:
        self._settings, self._experiment = settings, experiment
        self._archive, self._catalogue, self._history = archive, catalogue, history
        self._rehearsal = settings.rig.dry_run
        self._features_of = features_of_a_rehearsal if self._rehearsal else features_of
        self._set_assessor = self._new_ledger()
        self._alarms: dict[int, AlarmRow] = {}
        self._late: list[EventRow] = []
        self._result = Replayed()

    def _new_ledger(self) -> SetAssessor:
        return SetAssessor(
            self._settings, self._archive, self._catalogue, None, Cost(), rehearsal=self._rehearsal
        )

    def run(self, progress: Callable[[int, int], None]) -> Replayed:
        files = dict(self._archive.sets())
        total = len(files)
        with_events = {
            event.set_index for event in self._history.events.values() if event.set_index is not None
        }
        without_events = sorted(files.keys() - with_events, key=in_order)
        runs = list(_runs(self._history.events))
        for number, (set_index, events) in enumerate(runs):
            if set_index is None:
                self._pass(events)
                continue
            # A set without any event is assessed before the next one.
            while without_events and in_order(without_events[0]) < in_order(set_index):
                self._assess(without_events[0], files.pop(without_events.pop(0)), [], range(0))
            free = _free_ids(events, runs[number - 1][1] if number else [], runs[number + 1 : number + 2])
            reference = files.pop(set_index, None)
            if reference is None:
                self._restore_rows(events)
            else:
                self._assess(set_index, reference, events, free)
            progress(total - len(files), total)
        for set_index in sorted(files, key=in_order):
            reference = files[set_index]
            self._assess(set_index, reference, [], range(0))
            progress(total, total)
        self._catalogue.restore(self._alarms.values())
        self._catalogue.commit_set(Transaction(events=self._late))
        return self._result

    def _pass(self, events: Sequence[EventRow]) -> None:
        """Apply an event without a set, such as a command that changes later assessments."""
        self._catalogue.restore(events)
        for event in events:
            self._take_alarm(event)
            if event.topic == "annotations":
                self._catalogue.restore([_row_with_id(AnnotationRow, event, "annotation_id")])
            if event.kind in STEPS:
                self._catalogue.restore([_row_with_id(BaselineRow, event, "id")])
                self._set_assessor.renewed(str(event.position))
            retired = event.kind == "alarm_reset" and event.payload["kind"] in RETIRING
            if retired and event.position in self._settings.positions:
                self._set_assessor.reinstated(event.position)

    def _take_alarm(self, event: EventRow) -> None:
        self._set_assessor.take_stored(event)
        if event.topic == "alarms" and event.kind != DELAY_EVENT:
            row = _row_with_id(AlarmRow, event, "alarm_id")
            self._alarms[row.id or 0] = row
            self._set_assessor.alarms[(row.position, row.kind)] = row

    def _restore_rows(self, events: Sequence[EventRow]) -> None:
        """Restore the stored rows of a set without waveforms."""
        transaction = _with_stored_rows(Transaction(), events)
        transaction.sets = self._completed_sets(transaction.sets)
        self._commit(transaction, events)
        for row in transaction.sets:
            if row.purpose is None and row.state != "retired" and not row.n_taken and row.n_missed:
                self._set_assessor.passed(row)
        if any(row.n_taken for row in transaction.sets):
            self._result.damaged.append(f"set {transaction.sets[0].set_index}: its file is gone")
            self._set_assessor = self._renewed()

    def _completed_sets(self, stored: Sequence[SetRow]) -> list[SetRow]:
        """Complete the stored rows: a position that a set leaves out has no event."""
        rows = {row.position: row for row in stored}
        of_the_plan = stored and stored[0].purpose is None
        for position, cause in self._set_assessor.retired().items() if of_the_plan else ():
            first = stored[0]
            due = DueSet(set_index=first.set_index, due_h=first.due_h, due_utc_ns=first.due_utc_ns)
            retired = without_records(self._settings, due, position, retired=True, cause=cause)
            rows.setdefault(position, retired)
        digests = self._history.digests
        rows = {name: replace(row, file_sha256=digests.get(row.file or "")) for name, row in rows.items()}
        return [rows[position] for position in self._settings.positions if position in rows]

    def _renewed(self) -> SetAssessor:
        """Continue as after a restart, from the stored rows, since waveforms are missing."""
        self._catalogue.restore(self._alarms.values())
        try:
            return self._new_ledger()
        except ArchiveError as error:
            self._result.damaged.append(f"judged on without it: {error}")
            return self._set_assessor

    def _assess(
        self, set_index: int, reference: SetReference, events: Sequence[EventRow], free: Sequence[int]
    ) -> None:
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
                    self._restore_rows(events)
                return
        if why := foreign_reason(record, self._experiment):
            self._result.foreign.append(f"{reference}: {why}")
            return
        due = due_of(record)
        features = {shot.sequence: self._features_of(shot) for shot in record.shots}
        sha256 = self._digest(reference)
        transaction = self._set_assessor.assessed(due, record, reference, features, sha256=sha256)
        if record.results and not damage:
            again = results_of(transaction.features, transaction.thickness, transaction.shots)
            found = find_differences(record.results, again)
            self._result.differing += [f"set {set_index}, its file: {difference}" for difference in found]
        self._add_environment(transaction, record)
        computed = list(transaction.events)
        if events:
            if not damage:
                self._result.differing += _differences(computed, events)
            _with_stored_rows(transaction, events, all_rows=bool(damage))
        self._commit(transaction, self._placed(computed, events, free), computed_alarms=not events)
        self._result.sets += 1
        if damage:
            self._set_assessor = self._renewed()

    def _digest(self, reference: SetReference) -> str | None:
        found, expected = self._archive.digest(reference), self._history.digests.get(reference)
        if found is not None and expected not in (None, found):
            self._result.damaged.append(f"{reference} is not the file that was stored: its SHA-256 differs")
        return expected or found

    def _add_environment(self, transaction: Transaction, record: SetRecord) -> None:
        if record.environment and not transaction.environment and purpose_of(record.set_index) == "planned":
            row = EnvironmentRow(set_index=record.set_index, due_h=record.due_h, **record.environment)  # type: ignore[arg-type] # its columns
            transaction.environment.append(row)

    def _commit(
        self, transaction: Transaction, events: Sequence[EventRow], *, computed_alarms: bool = False
    ) -> None:
        if computed_alarms:
            # This set has no events: its alarms follow from its assessment.
            self._catalogue.restore(self._alarms.values())
            transaction.events = list(events)
            self._set_assessor.commit(transaction)
            self._alarms |= {row.id or 0: row for row in self._set_assessor.alarms.values()}
            return
        transaction.alarms, transaction.events, transaction.alarm_of_event = [], list(events), {}
        self._catalogue.commit_set(transaction)
        self._set_assessor.confirmations.take_rows(transaction)
        for event in events:
            self._take_alarm(event)

    def _placed(
        self, computed: Sequence[EventRow], stored: Sequence[EventRow], free: Sequence[int]
    ) -> list[EventRow]:
        """Return the stored events; a lost one gets its old id if that can be derived."""
        if not stored:
            return list(computed)
        known = {_key(event) for event in stored}
        # The request of an unscheduled set is stored, never computed.
        lost = [
            event
            for event in computed
            if _key(event) not in known and event.topic != "alarms" and event.kind != CONFIRMATION_ASKED
        ]
        if len(lost) == len(free):
            again = [replace(event, id=row_id) for event, row_id in zip(lost, free, strict=True)]
            return sorted([*stored, *again], key=lambda event: event.id or 0)
        self._late += lost
        return list(stored)


def _runs(events: Mapping[int, EventRow]) -> Iterator[tuple[int | None, list[EventRow]]]:
    in_order = (event for _, event in sorted(events.items()))
    for set_index, run in groupby(in_order, key=lambda event: event.set_index):
        yield set_index, list(run)


def _free_ids(
    events: Sequence[EventRow],
    before: Sequence[EventRow],
    following: Sequence[tuple[int | None, Sequence[EventRow]]],
) -> list[int]:
    """Return the unused ids around and between the events of a set."""
    first = (before[-1].id or 0) if before else 0
    last = (following[0][1][0].id or 0) if following else (events[-1].id or 0) + 1
    return sorted(set(range(first + 1, last)) - {event.id for event in events if event.id is not None})


def _row_with_id(kind: type[R], event: EventRow, name: str) -> R:
    """Return the complete row of an event, whose id has a name of its own."""
    columns = {column: event.payload[column] for column in kind.__slots__ if column in event.payload}
    return kind(**{**columns, "id": event.payload[name]})


def _key(event: EventRow) -> tuple[str, str, str | None]:
    return event.topic, event.kind, event.position


def _with_stored_rows(
    transaction: Transaction, events: Sequence[EventRow], *, all_rows: bool = False
) -> Transaction:
    """Replace computed rows by stored ones: those of how a set ended.

    Parameters
    ----------
    all_rows
        Those that follow from the records, too: the records are not there, or not all.
    """
    transaction.sets = _merged(transaction.sets, _rows(SetRow, events))
    transaction.environment = _rows(EnvironmentRow, events) or transaction.environment
    if all_rows or not transaction.shots:
        single = [row for row in transaction.features if row.shot_index is not None]
        transaction.features = [*single, *_rows(FeatureRow, events)]
        stored = {row.sequence for row in transaction.shots}
        transaction.thickness = [
            row if row.sequence in stored else replace(row, sequence=None)
            for row in _rows(ThicknessRow, events)
        ]
        transaction.baselines = _rows(BaselineRow, events)
        transaction.assessments = _rows(AssessmentRow, events)
    return transaction


def _merged(computed: Sequence[SetRow], stored: Sequence[SetRow]) -> list[SetRow]:
    digests = {row.position: row.file_sha256 for row in computed}
    rows = {row.position: row for row in computed}
    rows |= {row.position: replace(row, file_sha256=digests.get(row.position)) for row in stored}
    return list(rows.values())


def _rows(kind: type[R], events: Sequence[EventRow]) -> list[R]:
    return [
        kind(**{name: event.payload[name] for name in kind.__slots__ if name in event.payload})
        for event in events
        if _STORED_ROWS.get(event.kind) is kind
    ]


def _differences(computed: Sequence[EventRow], stored: Sequence[EventRow]) -> list[str]:
    found = {_key(event): event for event in computed if event.kind in _COMPUTED}
    return [
        f"set {event.set_index}, {event.position}: {event.kind}"
        for event in stored
        if _key(event) in found and _stored_columns(event, found[_key(event)]) != _json(event.payload)
    ]


def _stored_columns(stored: EventRow, computed: EventRow) -> bytes:
    """Return the payload with the stored columns: an earlier version had fewer."""
    return _json({name: value for name, value in computed.payload.items() if name in stored.payload})


def _json(payload: Mapping[str, Any]) -> bytes:
    return orjson.dumps(payload, option=orjson.OPT_SORT_KEYS | orjson.OPT_SERIALIZE_NUMPY)
