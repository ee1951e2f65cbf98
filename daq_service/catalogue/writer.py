"""Write the catalogue as the recorder: one transaction per set, events, and answers to commands."""

from __future__ import annotations

import time
import uuid
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from sqlalchemy import ColumnElement, Connection, Select, bindparam, case, func, select

from daq_service.catalogue.errors import CatalogueConflictError, OtherExperimentError
from daq_service.catalogue.reader import Catalogue, is_scheduled, store_command
from daq_service.catalogue.rollups import collect_changed_sets, find_last_sets, update_trends
from daq_service.catalogue.rows import (
    AlarmRow,
    AnnotationRow,
    AssessmentRow,
    AssessorStateRow,
    BaselineRow,
    CommandRow,
    CommandState,
    CountsRow,
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
from daq_service.catalogue.stored_rows import (
    begin_write,
    compile_sql,
    insert_rows,
    read_rows,
    replace_row,
    translate_errors,
)
from daq_service.catalogue.tables import (
    TABLES,
    assessments,
    commands,
    counts,
    events,
    experiment,
    sets,
    shots,
)
from hardware_drivers.measurement import SetKey
from hardware_drivers.methods import PULSE_ECHO

R = TypeVar("R", bound=Row)

ANSWERS: tuple[CommandState, ...] = ("done", "rejected", "expired", "failed")


@dataclass(slots=True, kw_only=True, eq=False)
class SetCommit:
    """Rows that are stored in one commit, such as those of one set.

    Attributes
    ----------
    alarms
        A row with an id changes that alarm, one without raises a new one.
    events
        Without ``wall_utc_ns`` an event is dated when it is stored.
    alarm_of_event
         Index of an event to the index of its alarm: ``alarm_id`` is added to its payload.
    annotations
        A row with an id changes that annotation, one without is a new one.
    baselines
         A row with a stored id replaces that row: the baseline's state has changed.
    annotation_of_event
        As ``alarm_of_event``, with ``annotation_id``.
    order
         Command that this commit executes, with its answer; one with id 0 gets its id.
    states
        States of assessors after the set by ``place``; they replace the stored ones.
    assessments
        A row ``in_baseline`` replaces that of the same set and position: the baseline's own
        distances are known only when it is complete. Every other assessment is final.
    """

    sets: list[SetRow] = field(default_factory=list)
    shots: list[ShotRow] = field(default_factory=list)
    features: list[FeatureRow] = field(default_factory=list)
    thickness: list[ThicknessRow] = field(default_factory=list)
    wall: list[WallRow] = field(default_factory=list)
    baselines: list[BaselineRow] = field(default_factory=list)
    assessments: list[AssessmentRow] = field(default_factory=list)
    environment: list[EnvironmentRow] = field(default_factory=list)
    alarms: list[AlarmRow] = field(default_factory=list)
    events: list[EventRow] = field(default_factory=list)
    alarm_of_event: dict[int, int] = field(default_factory=dict)
    annotations: list[AnnotationRow] = field(default_factory=list)
    annotation_of_event: dict[int, int] = field(default_factory=dict)
    order: CommandRow | None = None
    states: dict[str, AssessorStateRow] = field(default_factory=dict)

    def add_alarm(self, row: AlarmRow, event: EventRow) -> None:
        """Add a new or changed alarm with its event; the row's columns are added to the event's payload."""
        self.alarm_of_event[len(self.events)] = len(self.alarms)
        self.alarms.append(row)
        self.events.append(replace(event, payload=event.payload | build_event_payload(row, last="id")))

    def add_annotation(self, row: AnnotationRow, event: EventRow) -> None:
        """Add a new or changed annotation with its event, whose payload becomes the row's columns."""
        self.annotation_of_event[len(self.events)] = len(self.annotations)
        self.annotations.append(row)
        self.events.append(replace(event, payload=build_event_payload(row, last="id")))

    def add_baseline(self, row: BaselineRow, event: EventRow, *, last: str = "") -> None:
        """Add a new or changed baseline with its event, whose payload becomes the row's columns.

        Column ``last`` is the last of them (empty: as in the row).
        """
        self.baselines.append(row)
        self.events.append(replace(event, payload=build_event_payload(row, last=last)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Committed:
    """Ids that a commit assigned, in the order of its rows."""

    event_ids: list[int]
    alarm_ids: list[int]
    baseline_ids: list[int]
    annotation_ids: list[int]
    order_id: int | None = None


class RecorderCatalogue(Catalogue):
    """Catalogue of the recorder, its only writer."""

    newest = SetCommit()
    """Rows of the set that this process stored last."""

    @contextmanager
    def _open_transaction(self, action: str) -> Iterator[Connection]:
        """Open a write transaction; an error inside rolls it back, one of SQL becomes `CatalogueError`.

        ``action`` names the step in the message.
        """
        with translate_errors(self._path, action), begin_write(self._engine) as connection:
            yield connection

    # The experiment

    def create_experiment(
        self,
        *,
        name: str,
        configuration_hash: str,
        configuration: Mapping[str, Any],
        epoch_utc_ns: int,
        clock: str,
        solimon_version: str,
        site: str | None = None,
    ) -> ExperimentRow:
        """Store the experiment of this folder with a new UUID, unless one is stored; return the stored row.

        Raises
        ------
        OtherExperimentError
            The stored experiment has another configuration hash.
        CatalogueError
            It cannot be written.
        """
        row = ExperimentRow(
            name=name,
            configuration_hash=configuration_hash,
            configuration=dict(configuration),
            created_utc_ns=time.time_ns(),
            epoch_utc_ns=epoch_utc_ns,
            clock=clock,
            solimon_version=solimon_version,
            uuid=str(uuid.uuid4()),
            site=site,
        )
        with self._open_transaction("beginning the experiment") as connection:
            if connection.execute(select(experiment.c.id)).first() is None:
                insert_rows(connection, [row])
        stored = self.read_experiment()
        if stored.configuration_hash != configuration_hash:
            raise OtherExperimentError(
                f"{self._path} belongs to configuration {stored.configuration_hash}, "
                f"not to {configuration_hash}"
            )
        return stored

    def list_committed_sets(self, among: Collection[SetKey] | None = None) -> set[SetKey]:
        """List the keys of the sets with stored rows, of all sets or (``among``) of the given ones."""
        statement = select(sets.c.set_index, sets.c.unscheduled_index).distinct()
        if among is not None:
            statement = statement.where(sets.c.set_index.in_(sorted({key.set_index for key in among})))
        with self.open_snapshot() as connection:
            found = {SetKey(*key) for key in connection.execute(statement)}
        return found if among is None else found & set(among)

    def find_last_end_utc_ns(self) -> int | None:
        """Find the latest end of a set in ns of UTC; None if no set has a record."""
        with self.open_snapshot() as connection:
            last: int | None = connection.execute(select(func.max(sets.c.ended_utc_ns))).scalar_one()
        return last

    def next_sequence(self) -> int:
        """Return the sequence number for the next shot: the highest stored one plus 1, at first 1."""
        with self.open_snapshot() as connection:
            return int(connection.execute(select(func.max(shots.c.sequence))).scalar_one() or 0) + 1

    # A set

    def commit_set(self, commit: SetCommit) -> Committed:
        """Store all rows of a commit in one transaction, update counts and trends, and return the new ids.

        Rows of sets become `newest`, the rows of the set stored last.

        Raises
        ------
        CatalogueError
            Nothing was stored; CatalogueConflictError if a row exists or a row to change does not.
        """
        indices = {row.set_index for row in commit.sets}
        rows = [*commit.sets, *commit.features, *commit.thickness, *commit.assessments, *commit.alarms]
        touched = collect_changed_sets(rows)
        with self._open_transaction("storing a set") as connection:
            last_before = find_last_sets(connection, touched)
            before = count_due_times(connection, indices) if indices else {}
            insert_rows(connection, commit.sets)
            insert_rows(connection, commit.shots)
            insert_rows(connection, commit.features)
            insert_rows(connection, commit.thickness)
            insert_rows(connection, commit.wall)
            baseline_ids = [_replace_or_insert_row(connection, row) for row in commit.baselines]
            _insert_assessments(connection, commit.assessments)
            insert_rows(connection, commit.environment)
            for state in commit.states.values():
                _replace_or_insert_row(connection, state)
            alarm_ids = [_store_new_or_changed(connection, row) for row in commit.alarms]
            annotation_ids = [_store_new_or_changed(connection, row) for row in commit.annotations]
            event_ids = insert_rows(connection, _build_dated_events(commit, alarm_ids, annotation_ids))
            after = count_due_times(connection, indices) if indices else {}
            _update_counts(connection, commit, before, after)
            update_trends(connection, touched, last_before)
            order_id = _store_answer(connection, commit.order) if commit.order else None
        if commit.sets:
            self.newest = commit
        return Committed(
            event_ids=event_ids,
            alarm_ids=alarm_ids,
            baseline_ids=baseline_ids,
            annotation_ids=annotation_ids,
            order_id=order_id,
        )

    def add_service_event(self, *, utc_ns: int, kind: str, payload: Mapping[str, Any]) -> int:
        """Commit an event of topic ``service`` at a time of the test (ns of UTC) and return its id.

        Raises CatalogueError if it is not stored.
        """
        event = EventRow(utc_ns=utc_ns, topic="service", kind=kind, payload=dict(payload))
        return self.commit_set(SetCommit(events=[event])).event_ids[0]

    def list_sets_without_digest(self) -> dict[SetKey, str]:
        """List the files of sets that have a file but no stored SHA-256, by set key; reads all such rows."""
        statement = select(sets.c.set_index, sets.c.unscheduled_index, sets.c.file)
        with self.open_snapshot() as connection:
            rows = connection.execute(statement.where(sets.c.file.is_not(None), sets.c.file_sha256.is_(None)))
            return {SetKey(*key): str(file) for *key, file in rows}

    def store_digest(self, set_key: SetKey, file: str, sha256: str) -> None:
        """Store the SHA-256 (hexadecimal) of a set's file in its rows that name this file and have none yet.

        Raises CatalogueError if it cannot be stored.
        """
        with self._open_transaction("noting a file") as connection:
            of_file = (*_build_set_condition(set_key), sets.c.file == file)
            its_sets = select(sets).where(*of_file, sets.c.file_sha256.is_(None))
            for row in list(read_rows(connection, SetRow, its_sets)):
                replace_row(connection, replace(row, file_sha256=sha256))

    def read_digest(self, set_key: SetKey) -> str | None:
        """Read the stored SHA-256 of a set's file in hexadecimal; None if no row of the set has one."""
        has_digest = sets.c.file_sha256.is_not(None)
        statement = select(sets.c.file_sha256).where(*_build_set_condition(set_key), has_digest)
        with self.open_snapshot() as connection:
            digest: str | None = connection.execute(statement.limit(1)).scalar_one_or_none()
        return digest

    def recompute_counts(self) -> None:
        """Recompute and store the numbers of scheduled sets, shots and records, and of events, from all rows.

        It reads the complete tables in one transaction, which blocks other writers. Raises CatalogueError.
        """
        echoes = select(sets.c.position).where(sets.c.method == PULSE_ECHO)
        with self._open_transaction("counting") as connection:
            numbers = {
                "shots": select(func.count()).where(shots.c.position.not_in(echoes), is_scheduled(shots)),
                "pulse_echo_records": select(func.count()).where(
                    shots.c.position.in_(echoes), is_scheduled(shots)
                ),
                "events": select(func.count()).select_from(events),
            }
            counted = {name: connection.execute(number).scalar_one() for name, number in numbers.items()}
            replace_row(connection, CountsRow(**count_due_times(connection), **counted))

    def restore_rows(self, rows: Iterable[Row]) -> None:
        """Store rows with their ids in one transaction, replacing existing ones; update the trends.

        The counts stay as they are: call `recompute_counts` afterwards. Raises CatalogueError; nothing is
        stored then.
        """
        restored = list(rows)
        touched = collect_changed_sets(row for row in restored if not isinstance(row, EventRow))
        with self._open_transaction("restoring rows") as connection:
            last_before = find_last_sets(connection, touched)
            for row in restored:
                _replace_or_insert_row(connection, row)
            update_trends(connection, touched, last_before)

    # Commands

    def list_open_commands(self) -> list[CommandRow]:
        """List the commands without an answer (state pending or started), oldest first."""
        return self.rows(CommandRow, states={"pending", "started"})

    def start_command(self, command_id: int) -> None:
        """Mark a pending command as started, durably, before it is executed.

        Raises
        ------
        CatalogueConflictError
             There is no such command, or it is not pending.
        CatalogueError
             It cannot be written; the command stays pending.
        """
        self._advance_command(command_id, "pending", state="started")

    def finish_command(self, command_id: int, state: CommandState, result: str | None = None) -> None:
        """Store the answer to a pending or started command, with the computer's present time.

        Raises
        ------
        CatalogueConflictError
             There is no such command, it was answered before, or ``state`` is not an answer.
        CatalogueError
             It cannot be written.
        """
        if state not in ANSWERS:
            raise CatalogueConflictError(f"state is {state!r}; an answer is one of {', '.join(ANSWERS)}")
        self._advance_command(
            command_id, "pending", "started", state=state, result=result, finished_wall_utc_ns=time.time_ns()
        )

    def _advance_command(self, command_id: int, *before: CommandState, **values: object) -> None:
        """Change ``values`` of a command in one of the states ``before``; else CatalogueConflictError."""
        with self._open_transaction("answering a command") as connection:
            statement = select(commands).where(commands.c.id == command_id, commands.c.state.in_(before))
            rows = list(read_rows(connection, CommandRow, statement))
            if not rows:
                raise CatalogueConflictError(
                    f"{self._path}: there is no command {command_id} that is {' or '.join(before)}"
                )
            replace_row(connection, replace(rows[0], **values))  # type: ignore[arg-type] # names of its columns


def _build_set_condition(key: SetKey) -> tuple[ColumnElement[bool], ...]:
    """Build the two conditions (set index, unscheduled index) that select the rows of a set in ``sets``."""
    return sets.c.set_index == key.set_index, sets.c.unscheduled_index == key.unscheduled_index


def build_event_payload(row: Row, *, last: str = "") -> dict[str, object]:
    """Convert a row to its event's payload: its columns, without a missing id, ``last`` as the last one."""
    names = [name for name in row.__slots__ if name != "id" or getattr(row, name) is not None]
    return {name: getattr(row, name) for name in sorted(names, key=last.__eq__)}


def _build_due_time_query(*of: ColumnElement[bool]) -> Select[int, int, int]:
    """Build the query that counts scheduled due times: with records, missed, incomplete with records.

    ``of`` are further conditions on table ``sets``.
    """
    lacking = case(((sets.c.state == "partial") | (sets.c.state == "missed"), 1), else_=0)
    missed = case((sets.c.state == "missed", 1), else_=0)
    due_times = select(
        func.sum(sets.c.n_taken).label("taken"),
        func.sum(lacking).label("lacking"),
        func.sum(missed).label("missed"),
    )
    found = due_times.where(is_scheduled(sets), *of).group_by(sets.c.set_index).subquery()
    has_data = found.c.taken > 0
    return select(
        func.count().filter(has_data).label("sets"),
        func.count().filter(~has_data, found.c.missed > 0).label("missed_sets"),
        func.count().filter(has_data, found.c.lacking > 0).label("partial_sets"),
    ).select_from(found)


_OF_ALL_SETS = compile_sql(_build_due_time_query())
_OF_ONE_SET = compile_sql(_build_due_time_query(sets.c.set_index == bindparam("of_set")))
_COUNTS = compile_sql(select(counts))
_OF_BASELINE = compile_sql(
    select(assessments.c.id).where(
        assessments.c.position == bindparam("of_position"),
        assessments.c.set_index == bindparam("of_set"),
        assessments.c.unscheduled_index == bindparam("unscheduled"),
        assessments.c.in_baseline,
    )
)


def count_due_times(connection: Connection, indices: Collection[int] | None = None) -> dict[str, int]:
    """Count due times with records, missed and incomplete ones from rows of sets, named as in `CountsRow`.

    ``indices`` selects some sets (at least one, else ValueError); None: all.
    """
    found = (
        _OF_ALL_SETS.execute(connection)
        if indices is None
        else (_OF_ONE_SET.execute(connection, of_set=index).fetchone() for index in indices)
    )
    return dict(zip(("sets", "missed_sets", "partial_sets"), map(sum, zip(*found, strict=True)), strict=True))


def _update_counts(
    connection: Connection, commit: SetCommit, before: Mapping[str, int], after: Mapping[str, int]
) -> None:
    """Add the numbers of a commit's rows to the stored counts, in the caller's transaction.

    ``before`` and ``after`` are the due times of its sets without and with the commit.
    """
    echoes = {row.position for row in commit.sets if row.method == PULSE_ECHO}
    of_plan = [row for row in commit.shots if not row.unscheduled_index]
    n_echoes = sum(row.position in echoes for row in of_plan)
    added = {name: after[name] - before[name] for name in after} | {
        "shots": len(of_plan) - n_echoes,
        "pulse_echo_records": n_echoes,
        "events": len(commit.events),
    }
    (row,) = read_rows(connection, CountsRow, _COUNTS)
    changed = replace(row, **{name: getattr(row, name) + number for name, number in added.items()})
    replace_row(connection, changed)


def _insert_assessments(connection: Connection, rows: Sequence[AssessmentRow]) -> None:
    """Insert assessments; one ``in_baseline`` replaces the preliminary one of its set and position."""
    new = []
    for row in rows:
        found = (
            _OF_BASELINE.execute(
                connection,
                of_position=row.position,
                of_set=row.set_index,
                unscheduled=row.unscheduled_index,
            ).fetchone()
            if row.in_baseline
            else None
        )
        if found is None:
            new.append(row)
        else:
            replace_row(connection, replace(row, id=found[0]))
    insert_rows(connection, new)


def _store_new_or_changed(connection: Connection, row: AlarmRow | AnnotationRow) -> int:
    """Insert a row without id, or replace the stored row of its id; return the id.

    Raises CatalogueConflictError if there is no row of the given id.
    """
    return _replace_existing_row(connection, row, row.id) if row.id else insert_rows(connection, [row])[0]


def _replace_or_insert_row(connection: Connection, row: Row) -> int:
    """Replace the stored row of the same primary key, or insert a new row; return its id.

    Returns 0 for a replaced row of a kind without id.
    """
    row_id: int | None = getattr(row, "id", 0)
    if row_id is not None and replace_row(connection, row):
        return row_id
    return insert_rows(connection, [row])[0]


def _store_answer(connection: Connection, row: CommandRow) -> int:
    """Store a command with its answer and return its id; id 0 is a new command, which gets the next id.

    Raises CatalogueConflictError if there is no command of the given id.
    """
    return _replace_existing_row(connection, row, row.id) if row.id else store_command(connection, row)


def _replace_existing_row(connection: Connection, row: Row, row_id: int) -> int:
    """Replace the row of an id and return the id; CatalogueConflictError if there is none."""
    if not replace_row(connection, row):
        row_text = f"row {row_id} of table {TABLES[type(row)].name}"
        raise CatalogueConflictError(f"there is no {row_text} to change; nothing was stored")
    return row_id


def _build_dated_events(
    commit: SetCommit, alarm_ids: Sequence[int], annotation_ids: Sequence[int]
) -> list[EventRow]:
    """Build the events of a commit for storing: dated with the present time where they have none.

    Payloads get the ids of their alarms and annotations (``alarm_id``, ``annotation_id``).
    """
    now_ns = time.time_ns()
    complete = []
    for number, event in enumerate(commit.events):
        payload = event.payload
        if number in commit.alarm_of_event:
            payload = {**payload, "alarm_id": alarm_ids[commit.alarm_of_event[number]]}
        if number in commit.annotation_of_event:
            payload = {**payload, "annotation_id": annotation_ids[commit.annotation_of_event[number]]}
        complete.append(replace(event, wall_utc_ns=event.wall_utc_ns or now_ns, payload=payload))
    return complete


__all__ = ["Committed", "RecorderCatalogue", "SetCommit", "build_event_payload"]
