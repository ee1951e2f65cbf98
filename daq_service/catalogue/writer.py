"""What the recorder writes: one transaction a set, events, and answers to commands."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Table, bindparam, func, insert, select, update

from daq_service.catalogue.connection import translated, writing
from daq_service.catalogue.errors import CatalogueWriteError
from daq_service.catalogue.reader import Catalogue, Row
from daq_service.catalogue.rows import storable
from daq_service.catalogue.tables import (
    alarms,
    baselines,
    commands,
    environment,
    events,
    experiment,
    features,
    sets,
    shots,
    thickness,
    verdicts,
)

Rows = Sequence[Mapping[str, Any]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SetCommit:
    """Everything one set says, as rows keyed by the names of the columns.

    Attributes
    ----------
    alarms
        A row with an ``id`` changes that alarm, one without raises a new one.
    events
        ``wall_utc_ns`` may be left out: it is the time of the commit. A row may have the key
        ``alarm_index``, which alarm of ``alarms`` it tells of: ``alarm_id`` is put into its payload.
    verdicts
        A row ``in_baseline`` replaces that of the same set and position: the baseline's own
        distances are known only when it is complete. Every other verdict is final.
    """

    sets: Rows = ()
    shots: Rows = ()
    features: Rows = ()
    thickness: Rows = ()
    baselines: Rows = ()
    verdicts: Rows = ()
    environment: Rows = ()
    alarms: Rows = ()
    events: Rows = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Committed:
    """Ids that a commit gave out, in the order of its rows."""

    event_ids: list[int]
    alarm_ids: list[int]
    baseline_ids: list[int]


class RecorderCatalogue(Catalogue):
    """The catalogue in the hands of its one writer, the recorder."""

    @contextmanager
    def _writing(self, doing: str) -> Iterator[Connection]:
        with translated(self._path, doing), writing(self._engine) as connection:
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
    ) -> Row:
        """Make this folder the experiment's, or find that it is already, and return its row.

        Raises
        ------
        OtherExperimentError
            The folder belongs to another configuration.
        """
        row = {
            "id": 1,
            "name": name,
            "configuration_hash": configuration_hash,
            "configuration": dict(configuration),
            "created_utc_ns": time.time_ns(),
            "epoch_utc_ns": epoch_utc_ns,
            "clock": clock,
            "solimon_version": solimon_version,
        }
        with self._writing("beginning the experiment") as connection:
            if connection.execute(select(experiment.c.id)).first() is None:
                connection.execute(insert(experiment), storable(experiment, [row]))
        self.check_owner(configuration_hash)
        return self.experiment_row()

    def committed_sets(self) -> set[int]:
        """Return the indices of the sets whose rows are stored: those a restart leaves out."""
        with self._reading() as connection:
            return set(connection.execute(select(sets.c.set_index).distinct()).scalars())

    def next_sequence(self) -> int:
        """Sequence of the next shot, 1 in a new catalogue."""
        with self._reading() as connection:
            return int(connection.execute(select(func.max(shots.c.sequence))).scalar_one() or 0) + 1

    # A set

    def commit_set(self, commit: SetCommit) -> Committed:
        """Store everything a set says in one transaction: all of it, or nothing.

        Raises
        ------
        CatalogueError
            Nothing was stored.
        """
        with self._writing("storing a set") as connection:
            _insert(connection, sets, commit.sets)
            _insert(connection, shots, commit.shots)
            _insert(connection, features, commit.features)
            _insert(connection, thickness, commit.thickness)
            baseline_ids = _insert_for_ids(connection, baselines, commit.baselines)
            _judge(connection, commit.verdicts)
            _insert(connection, environment, commit.environment)
            alarm_ids = [_store_alarm(connection, row) for row in commit.alarms]
            event_ids = _insert_for_ids(connection, events, _event_rows(commit.events, alarm_ids))
        return Committed(event_ids=event_ids, alarm_ids=alarm_ids, baseline_ids=baseline_ids)

    def add_event(
        self,
        *,
        utc_ns: int,
        topic: str,
        kind: str,
        payload: Mapping[str, Any],
        position: str | None = None,
        set_index: int | None = None,
    ) -> int:
        """Append one event and return its id."""
        row = {
            "utc_ns": utc_ns,
            "topic": topic,
            "kind": kind,
            "position": position,
            "set_index": set_index,
            "payload": dict(payload),
        }
        return self.commit_set(SetCommit(events=[row])).event_ids[0]

    # Commands

    def pending_commands(self) -> list[Row]:
        """Orders that wait for an answer, oldest first."""
        return self._rows(select(commands).where(commands.c.state == "pending").order_by(commands.c.id))

    def finish_command(self, command_id: int, state: str, result: str | None = None) -> None:
        """Answer an order: ``state`` is "done" or "refused".

        Raises
        ------
        CatalogueWriteError
            No such order, or it was answered before.
        """
        if state not in ("done", "refused"):
            raise CatalogueWriteError(f"state is {state!r}; a finished command is 'done' or 'refused'")
        statement = (
            update(commands)
            .where(commands.c.id == command_id, commands.c.state == "pending")
            .values(state=state, result=result, finished_wall_utc_ns=time.time_ns())
        )
        with self._writing("answering a command") as connection:
            if connection.execute(statement).rowcount != 1:
                raise CatalogueWriteError(f"{self._path}: there is no pending command {command_id}")


def _insert(connection: Connection, table: Table, rows: Rows) -> None:
    if rows:
        connection.execute(insert(table), storable(table, rows))


def _judge(connection: Connection, rows: Rows) -> None:
    """Insert verdicts; those of the baseline's sets replace the ones that waited for the baseline."""
    new = []
    for row in storable(verdicts, rows):
        waiting = update(verdicts).where(
            verdicts.c.position == row["position"],
            verdicts.c.set_index == row["set_index"],
            verdicts.c.in_baseline,
        )
        if not (row["in_baseline"] and connection.execute(waiting.values(row)).rowcount):
            new.append(row)
    _insert(connection, verdicts, new)


def _insert_for_ids(connection: Connection, table: Table, rows: Rows) -> list[int]:
    """Insert rows and return their ids in the same order."""
    if not rows:
        return []
    statement = insert(table).returning(table.c.id, sort_by_parameter_order=True)
    return [int(identity) for identity in connection.execute(statement, storable(table, rows)).scalars()]


def _store_alarm(connection: Connection, row: Mapping[str, Any]) -> int:
    if row.get("id") is None:
        new = {key: value for key, value in row.items() if key != "id"}
        return _insert_for_ids(connection, alarms, [new])[0]
    (values,) = storable(alarms, [row])
    alarm_id = int(values.pop("id"))
    changed = connection.execute(
        update(alarms).where(alarms.c.id == bindparam("changed_id")), {**values, "changed_id": alarm_id}
    )
    if changed.rowcount != 1:
        raise CatalogueWriteError(f"there is no alarm {alarm_id} to change; nothing of the set was stored")
    return alarm_id


def _event_rows(rows: Rows, alarm_ids: Sequence[int]) -> list[Row]:
    now_ns = time.time_ns()
    complete = []
    for given in rows:
        row = {"wall_utc_ns": now_ns, **given}
        alarm_index = row.pop("alarm_index", None)
        if alarm_index is not None:
            row["payload"] = {**row["payload"], "alarm_id": alarm_ids[alarm_index]}
        complete.append(row)
    return complete


__all__ = ["Committed", "RecorderCatalogue", "SetCommit"]
