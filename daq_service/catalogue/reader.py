"""Questions to the catalogue; every answer is rows whose values are ready for JSON."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from sqlalchemy import ColumnElement, Connection, Engine, Select, Table, case, func, insert, select

from daq_service.catalogue.connection import make_engine, translated, writing
from daq_service.catalogue.errors import CatalogueError, NoDataYetError, OtherExperimentError
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

Row = dict[str, Any]
Scope = Literal["set", "shot"]


class Catalogue:
    """A catalogue open for reading; the one thing it writes is commands.

    Made by `open_catalogue`. It may be shared between threads; close it, or use it as a context
    manager. ``limit=None`` means all rows, ``after_id`` pages behind a row.
    """

    def __init__(self, path: Path, engine: Engine) -> None:
        self._path = path
        self._engine = engine
        self._command_engine: Engine | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close every connection; may be called again."""
        self._engine.dispose()
        if self._command_engine is not None:
            self._command_engine.dispose()

    @contextmanager
    def _reading(self) -> Iterator[Connection]:
        with translated(self._path, "reading"), self._engine.begin() as connection:
            yield connection

    def _rows(self, statement: Select[Any]) -> list[Row]:
        with self._reading() as connection:
            return _as_dicts(connection, statement)

    def _row(self, statement: Select[Any]) -> Row | None:
        rows = self._rows(statement.limit(1))
        return rows[0] if rows else None

    # The experiment as a whole

    def experiment_row(self) -> Row:
        """Name, configuration and its hash, epoch, clock.

        Raises
        ------
        NoDataYetError
            The experiment has not begun.
        """
        row = self._row(select(experiment))
        if row is None:
            raise NoDataYetError(
                f"{self._path}: the experiment has not begun; start `solimon record` or wait for it"
            )
        return row

    def check_owner(self, configuration_hash: str) -> None:
        """Compare the folder's configuration with ours; a folder without an experiment is anybody's.

        Raises
        ------
        OtherExperimentError
            The folder belongs to another configuration.
        """
        row = self._row(select(experiment.c.configuration_hash, experiment.c.name))
        if row is not None and row["configuration_hash"] != configuration_hash:
            raise OtherExperimentError(
                f"{self._path.parent} belongs to the experiment {row['name']!r} with configuration "
                f"{row['configuration_hash']}, not to configuration {configuration_hash}; go on with the "
                "configuration that began it, or choose another folder with --data-dir"
            )

    def counts(self) -> dict[str, int]:
        """Sizes of the experiment so far.

        Returns
        -------
        dict
            ``sets``: due times with at least one record, ``missed_sets``: due times that were
            missed altogether, ``partial_sets``: of the ``sets``, those that lack something;
            ``shots``: solitary-wave shots, ``pulse_echo_records``, ``events``, ``active_alarms``.
        """
        lacking = case((sets.c.state.in_(("partial", "missed")), 1), else_=0)
        missed = case((sets.c.state == "missed", 1), else_=0)
        due_times = (
            select(
                func.sum(sets.c.n_taken).label("taken"),
                func.sum(lacking).label("lacking"),
                func.sum(missed).label("missed"),
            )
            .group_by(sets.c.set_index)
            .subquery()
        )
        has_data = due_times.c.taken > 0
        with self._reading() as connection:
            n_taken, n_missed, n_partial = connection.execute(
                select(
                    func.count().filter(has_data),
                    func.count().filter(~has_data, due_times.c.missed > 0),
                    func.count().filter(has_data, due_times.c.lacking > 0),
                ).select_from(due_times)
            ).one()
            methods = dict(
                connection.execute(
                    select(sets.c.position, func.max(sets.c.method)).group_by(sets.c.position)
                ).all()
            )
            per_position = connection.execute(
                select(shots.c.position, func.count()).group_by(shots.c.position)
            ).all()
            n_events = connection.execute(select(func.count()).select_from(events)).scalar_one()
            n_alarms = connection.execute(
                select(func.count()).select_from(alarms).where(alarms.c.state != "normal")
            ).scalar_one()
        echoes = sum(count for position, count in per_position if methods.get(position) == "pulse_echo")
        return {
            "sets": n_taken,
            "missed_sets": n_missed,
            "partial_sets": n_partial,
            "shots": sum(count for _, count in per_position) - echoes,
            "pulse_echo_records": echoes,
            "events": n_events,
            "active_alarms": n_alarms,
        }

    def positions_state(self) -> dict[str, Row]:
        """Last word on each position.

        Returns
        -------
        dict
            Position to ``method``, ``last_set``, ``last_feature`` (of a set), ``last_verdict``,
            ``last_thickness`` (rows, or None where there is none) and ``active_alarms`` (rows).
        """
        of_a_set = features.c.shot_index.is_(None)
        with self._reading() as connection:
            last_sets = _newest(connection, sets)
            last_features = _newest(connection, features, of_a_set)
            last_verdicts = _newest(connection, verdicts)
            last_thicknesses = _newest(connection, thickness)
            active = _as_dicts(
                connection, select(alarms).where(alarms.c.state != "normal").order_by(alarms.c.id)
            )
        return {
            position: {
                "position": position,
                "method": row["method"],
                "last_set": row,
                "last_feature": last_features.get(position),
                "last_verdict": last_verdicts.get(position),
                "last_thickness": last_thicknesses.get(position),
                "active_alarms": [alarm for alarm in active if alarm["position"] == position],
            }
            for position, row in sorted(last_sets.items())
        }

    # Measurements

    def list_sets(
        self,
        position: str | None = None,
        state: str | None = None,
        after_id: int = 0,
        limit: int | None = 100,
        since_utc_ns: int | None = None,
        until_utc_ns: int | None = None,
    ) -> list[Row]:
        """List sets in the order in which they were stored; ``since <= due < until``."""
        statement = select(sets).where(sets.c.id > after_id).order_by(sets.c.id).limit(limit)
        statement = _where_equal(statement, sets, position=position, state=state)
        if since_utc_ns is not None:
            statement = statement.where(sets.c.due_utc_ns >= since_utc_ns)
        if until_utc_ns is not None:
            statement = statement.where(sets.c.due_utc_ns < until_utc_ns)
        return self._rows(statement)

    def list_shots(self, position: str, set_index: int) -> list[Row]:
        """List the stored shots of a set in the order in which they were taken."""
        statement = _where_equal(select(shots), shots, position=position, set_index=set_index)
        return self._rows(statement.order_by(shots.c.sequence))

    def list_environment(
        self,
        after_id: int = 0,
        limit: int | None = None,
        first_h: float | None = None,
        last_h: float | None = None,
    ) -> list[Row]:
        """List what supply and climate probe said, a row a set; ``first_h <= due_h <= last_h``."""
        statement = select(environment).where(environment.c.id > after_id).order_by(environment.c.id)
        if first_h is not None:
            statement = statement.where(environment.c.due_h >= first_h)
        if last_h is not None:
            statement = statement.where(environment.c.due_h <= last_h)
        return self._rows(statement.limit(limit))

    def last_environment(self) -> Row | None:
        """Return the newest row of the environment, None where there is none."""
        rows = self._rows(select(environment).order_by(environment.c.id.desc()).limit(1))
        return rows[0] if rows else None

    def list_features(
        self,
        position: str | None = None,
        scope: Scope = "set",
        first_h: float | None = None,
        last_h: float | None = None,
        after_id: int = 0,
        limit: int | None = None,
        set_index: int | None = None,
    ) -> list[Row]:
        """Features of sets, or of single shots; ``first_h <= due_h <= last_h``."""
        statement = select(features).where(_of_scope(scope))
        return self._rows(_page(statement, features, position, first_h, last_h, after_id, limit, set_index))

    def list_thickness(
        self,
        position: str | None = None,
        first_h: float | None = None,
        last_h: float | None = None,
        after_id: int = 0,
        limit: int | None = None,
        set_index: int | None = None,
    ) -> list[Row]:
        """Pulse-echo results."""
        return self._rows(
            _page(select(thickness), thickness, position, first_h, last_h, after_id, limit, set_index)
        )

    def list_verdicts(
        self,
        position: str | None = None,
        first_h: float | None = None,
        last_h: float | None = None,
        after_id: int = 0,
        limit: int | None = None,
        set_index: int | None = None,
    ) -> list[Row]:
        """Verdicts."""
        return self._rows(
            _page(select(verdicts), verdicts, position, first_h, last_h, after_id, limit, set_index)
        )

    def feature_columns(
        self,
        position: str,
        names: Sequence[str],
        *,
        scope: Scope = "set",
        first_h: float | None = None,
        last_h: float | None = None,
        limit: int | None = None,
    ) -> dict[str, list[Any]]:
        """Features by column, for trends: name to the values of all rows in order."""
        return self._columns(features, position, names, _of_scope(scope), first_h, last_h, limit)

    def thickness_columns(
        self,
        position: str,
        names: Sequence[str],
        *,
        first_h: float | None = None,
        last_h: float | None = None,
        limit: int | None = None,
    ) -> dict[str, list[Any]]:
        """Pulse-echo results by column."""
        return self._columns(thickness, position, names, None, first_h, last_h, limit)

    def verdict_columns(
        self,
        position: str,
        names: Sequence[str],
        *,
        first_h: float | None = None,
        last_h: float | None = None,
        limit: int | None = None,
    ) -> dict[str, list[Any]]:
        """Verdicts by column."""
        return self._columns(verdicts, position, names, None, first_h, last_h, limit)

    def _columns(
        self,
        table: Table,
        position: str,
        names: Sequence[str],
        condition: ColumnElement[bool] | None,
        first_h: float | None,
        last_h: float | None,
        limit: int | None,
    ) -> dict[str, list[Any]]:
        if unknown := set(names) - set(table.columns.keys()):
            raise CatalogueError(
                f"{sorted(unknown)} are no columns of {table.name!r}; it has {sorted(table.columns.keys())}"
            )
        if not names:
            return {}
        statement = select(*(table.c[name] for name in names))
        if condition is not None:
            statement = statement.where(condition)
        statement = _page(statement, table, position, first_h, last_h, 0, limit, None)
        with self._reading() as connection:
            rows = connection.execute(statement).all()
        return {name: [row[k] for row in rows] for k, name in enumerate(names)}

    # Judgement

    def baseline(self, position: str) -> Row | None:
        """Newest baseline of a position."""
        return self._row(
            select(baselines).where(baselines.c.position == position).order_by(baselines.c.id.desc())
        )

    def list_baselines(self, position: str | None = None) -> list[Row]:
        """Every baseline ever frozen, oldest first."""
        return self._rows(
            _where_equal(select(baselines), baselines, position=position).order_by(baselines.c.id)
        )

    def list_alarms(
        self,
        position: str | None = None,
        active: bool | None = None,
        after_id: int = 0,
        limit: int | None = None,
    ) -> list[Row]:
        """Alarms in the order they were raised; ``active`` False: those back to normal, True: the others."""
        statement = select(alarms).where(alarms.c.id > after_id).order_by(alarms.c.id).limit(limit)
        statement = _where_equal(statement, alarms, position=position)
        if active is not None:
            statement = statement.where(
                (alarms.c.state != "normal") if active else (alarms.c.state == "normal")
            )
        return self._rows(statement)

    def alarms_of(self, position: str | None) -> dict[str, Row]:
        """Newest alarm of each kind of a position (None: of the service itself), by kind."""
        here = alarms.c.position.is_(None) if position is None else alarms.c.position == position
        return {row["kind"]: row for row in self._rows(select(alarms).where(here).order_by(alarms.c.id))}

    def alarm(self, alarm_id: int) -> Row | None:
        """One alarm, None where there is no such id."""
        return self._row(select(alarms).where(alarms.c.id == alarm_id))

    # Events and commands

    def events_after(
        self, event_id: int, topics: Collection[str] | None = None, limit: int | None = 500
    ) -> list[Row]:
        """Events behind an id, in order."""
        statement = select(events).where(events.c.id > event_id).order_by(events.c.id).limit(limit)
        if topics is not None:
            statement = statement.where(events.c.topic.in_(sorted(topics)))
        return self._rows(statement)

    def last_told(self, *kinds: str) -> Row | None:
        """Newest event of the service itself of one of these kinds, None where there is none."""
        statement = select(events).where(events.c.topic == "service", events.c.kind.in_(kinds))
        return self._row(statement.order_by(events.c.id.desc()))

    def held(self) -> str | None:
        """Who holds the test and why, None while nobody does."""
        told = self.last_told("hold", "release")
        return None if told is None else told["payload"]["held"] or None

    def last_event_id(self) -> int:
        """Id of the newest event, 0 before the first."""
        with self._reading() as connection:
            return int(connection.execute(select(func.max(events.c.id))).scalar_one() or 0)

    def command(self, command_id: int) -> Row | None:
        """One command, None where there is no such id."""
        return self._row(select(commands).where(commands.c.id == command_id))

    def add_command(self, author: str, kind: str, arguments: dict[str, Any]) -> int:
        """Write an operator's order for the recorder and return its id.

        Raises
        ------
        CatalogueBusyError, CatalogueWriteError
            Nothing was written.
        """
        with translated(self._path, "writing a command"), writing(self._for_commands()) as connection:
            result = connection.execute(
                insert(commands),
                {
                    "wall_utc_ns": time.time_ns(),
                    "author": author,
                    "kind": kind,
                    "arguments": arguments,
                    "state": "pending",
                },
            )
            return int(result.inserted_primary_key[0])  # type: ignore[index]

    def _for_commands(self) -> Engine:
        if self._command_engine is None:
            self._command_engine = make_engine(self._path, writable=True)
        return self._command_engine


def _as_dicts(connection: Connection, statement: Select[Any]) -> list[Row]:
    result = connection.execute(statement)
    # SQL's quoted names are a kind of str that JSON refuses as a key.
    names = [str(name) for name in result.keys()]  # noqa: SIM118 not a dict
    return [dict(zip(names, row, strict=True)) for row in result]


def _newest(
    connection: Connection, table: Table, condition: ColumnElement[bool] | None = None
) -> dict[str, Row]:
    """Row of the highest set index of each position."""
    newest = select(table.c.position, func.max(table.c.set_index).label("set_index")).group_by(
        table.c.position
    )
    if condition is not None:
        newest = newest.where(condition)
    last = newest.subquery()
    statement = select(table).join(
        last, (table.c.position == last.c.position) & (table.c.set_index == last.c.set_index)
    )
    if condition is not None:
        statement = statement.where(condition)
    return {row["position"]: row for row in _as_dicts(connection, statement)}


def _of_scope(scope: Scope) -> ColumnElement[bool]:
    return features.c.shot_index.is_(None) if scope == "set" else features.c.shot_index.is_not(None)


def _where_equal(statement: Select[Any], table: Table, **values: Any) -> Select[Any]:
    for name, value in values.items():
        if value is not None:
            statement = statement.where(table.c[name] == value)
    return statement


def _page(
    statement: Select[Any],
    table: Table,
    position: str | None,
    first_h: float | None,
    last_h: float | None,
    after_id: int,
    limit: int | None,
    set_index: int | None,
) -> Select[Any]:
    statement = _where_equal(statement, table, position=position, set_index=set_index)
    if after_id:
        statement = statement.where(table.c.id > after_id)
    if first_h is not None:
        statement = statement.where(table.c.due_h >= first_h)
    if last_h is not None:
        statement = statement.where(table.c.due_h <= last_h)
    return statement.order_by(table.c.id).limit(limit)
