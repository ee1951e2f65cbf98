"""Questions to the catalogue; every answer is rows (`catalogue.rows`) whose values are ready for JSON."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, TypedDict, TypeVar, Unpack

from sqlalchemy import ColumnElement, Connection, Engine, Select, Table, case, func, insert, select

from daq_service.catalogue.connection import make_engine, translated, writing
from daq_service.catalogue.errors import CatalogueError, NoDataYetError
from daq_service.catalogue.rows import (
    AlarmRow,
    BaselineRow,
    CommandRow,
    EnvironmentRow,
    EventRow,
    ExperimentRow,
    FeatureRow,
    Row,
    SetRow,
    ThicknessRow,
    VerdictRow,
)
from daq_service.catalogue.sealed import checked_rows, storable
from daq_service.catalogue.tables import alarms, commands, events, sets, shots, table_of
from daq_service.clock import boot_name, elapsed_ns
from hardware_drivers.methods import PULSE_ECHO
from hardware_drivers.nanoseconds import NS_PER_S

R = TypeVar("R", bound=Row)
OfSet = TypeVar("OfSet", SetRow, FeatureRow, ThicknessRow, VerdictRow)
Scope = Literal["set", "shot"]

_ASKED_AT_ONCE = 500
"""Values in one condition."""
ORDER_WITHIN_S = 60.0
"""An order that nobody has begun to carry out within this time expires, if its giver says nothing else."""


class Filters(TypedDict, total=False):
    """Which rows of a table are meant; what is left out or None excludes nothing.

    ``active`` False: alarms back to normal, True: the others. ``scope``: features of sets, or of
    single shots. ``first_h <= due_h <= last_h``, ``since_utc_ns <= due_utc_ns (or utc_ns) < until_utc_ns``.
    """

    position: str | None
    set_index: int | None
    state: str | None
    states: Collection[str] | None
    scope: Scope | None
    active: bool | None
    topics: Collection[str] | None
    first_h: float | None
    last_h: float | None
    since_utc_ns: int | None
    until_utc_ns: int | None
    after_id: int | None


_CONDITIONS: Mapping[str, Callable[[Table, Any], ColumnElement[bool]]] = {
    "scope": lambda table, scope: (
        table.c.shot_index.is_(None) if scope == "set" else table.c.shot_index.is_not(None)
    ),
    "active": lambda table, active: table.c.state != "normal" if active else table.c.state == "normal",
    "states": lambda table, states: table.c.state.in_(sorted(states)),
    "topics": lambda table, topics: table.c.topic.in_(sorted(topics)),
    "first_h": lambda table, hour: table.c.due_h >= hour,
    "last_h": lambda table, hour: table.c.due_h <= hour,
    "since_utc_ns": lambda table, utc_ns: _date(table) >= utc_ns,
    "until_utc_ns": lambda table, utc_ns: _date(table) < utc_ns,
    "after_id": lambda table, row_id: table.c.id > row_id,
}
"""A filter that is not listed asks for a column's value."""


def _date(table: Table) -> ColumnElement[int]:
    return table.c.due_utc_ns if "due_utc_ns" in table.c else table.c.utc_ns


@dataclass(frozen=True, slots=True, kw_only=True)
class LastWord:
    """Newest rows of a position; ``last_feature`` is of a set."""

    position: str
    method: str
    last_set: SetRow | None = None
    last_feature: FeatureRow | None = None
    last_verdict: VerdictRow | None = None
    last_thickness: ThicknessRow | None = None
    active_alarms: Sequence[AlarmRow] = ()


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

    # Rows of every kind

    def rows(self, kind: type[R], /, *, limit: int | None = None, **filters: Unpack[Filters]) -> list[R]:
        """Rows of a table in the order in which they were stored."""
        return self._rows(kind, _chosen(select(table_of(kind)), table_of(kind), filters).limit(limit))

    def columns(
        self, kind: type[Row], names: Sequence[str], *, limit: int | None = None, **filters: Unpack[Filters]
    ) -> dict[str, list[Any]]:
        """Rows by column: name to the values of all rows in order.

        Raises
        ------
        CatalogueError
            A name is no column of the table.
        """
        if unknown := set(names) - set(kind.__slots__):
            of_table = f"{table_of(kind).name!r}; it has {sorted(kind.__slots__)}"
            raise CatalogueError(f"{sorted(unknown)} are no columns of {of_table}")
        if not names:
            return {}
        # Whole rows: only these can be compared with their checksums.
        found = self.rows(kind, limit=limit, **filters)
        return {name: [getattr(row, name) for row in found] for name in names}

    def _rows(self, kind: type[R], statement: Select[Any]) -> list[R]:
        with self._reading() as connection:
            return _made(connection, kind, statement)

    def _newest_row(self, kind: type[R], condition: ColumnElement[bool] | None = None) -> R | None:
        """Return the last stored row, of those that meet a condition; None where there is none."""
        table = table_of(kind)
        statement = select(table).order_by(table.c.id.desc()).limit(1)
        rows = self._rows(kind, statement if condition is None else statement.where(condition))
        return rows[0] if rows else None

    # The experiment as a whole

    def experiment_row(self) -> ExperimentRow:
        """Name, configuration and its hash, epoch, clock.

        Raises
        ------
        NoDataYetError
            The experiment has not begun.
        """
        row = self._newest_row(ExperimentRow)
        if row is None:
            raise NoDataYetError(
                f"{self._path}: the experiment has not begun; start `solimon record` or wait for it"
            )
        return row

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
        echoes = sum(count for position, count in per_position if methods.get(position) == PULSE_ECHO)
        return {
            "sets": n_taken,
            "missed_sets": n_missed,
            "partial_sets": n_partial,
            "shots": sum(count for _, count in per_position) - echoes,
            "pulse_echo_records": echoes,
            "events": n_events,
            "active_alarms": n_alarms,
        }

    def files_but_of(self, indices: Collection[int]) -> dict[int, str]:
        """Files that rows point at, by set index, of all sets but these; a few looks into an index."""
        positions = list(self.experiment_row().configuration.get("positions", ()))
        found: dict[int, str] = {}
        with self._reading() as connection:
            newest = [
                connection.execute(select(func.max(sets.c.set_index)).where(sets.c.position == name)).scalar()
                for name in positions
            ]
            last = max((index for index in newest if index is not None), default=-1)
            left = sorted(set(range(last + 1)) - set(indices))
            for start in range(0, len(left), _ASKED_AT_ONCE):
                some = left[start : start + _ASKED_AT_ONCE]
                statement = select(sets.c.set_index, sets.c.file).where(
                    sets.c.position.in_(positions), sets.c.set_index.in_(some), sets.c.file.is_not(None)
                )
                found |= {row.set_index: row.file for row in connection.execute(statement)}
        return found

    def positions_state(self) -> dict[str, LastWord]:
        """Last word on each position that has a row in ``sets``."""
        with self._reading() as connection:
            last_sets = _newest(connection, SetRow)
            last_features = _newest(connection, FeatureRow, "set")
            last_verdicts = _newest(connection, VerdictRow)
            last_thicknesses = _newest(connection, ThicknessRow)
            active = _made(connection, AlarmRow, _chosen(select(alarms), alarms, {"active": True}))
        return {
            position: LastWord(
                position=position,
                method=row.method,
                last_set=row,
                last_feature=last_features.get(position),
                last_verdict=last_verdicts.get(position),
                last_thickness=last_thicknesses.get(position),
                active_alarms=[alarm for alarm in active if alarm.position == position],
            )
            for position, row in sorted(last_sets.items())
        }

    def last_environment(self) -> EnvironmentRow | None:
        """Return the newest row of the environment, None where there is none."""
        return self._newest_row(EnvironmentRow)

    def baseline(self, position: str) -> BaselineRow | None:
        """Newest baseline of a position."""
        return self._newest_row(BaselineRow, table_of(BaselineRow).c.position == position)

    def alarm(self, alarm_id: int) -> AlarmRow | None:
        """One alarm, None where there is no such id."""
        return self._newest_row(AlarmRow, alarms.c.id == alarm_id)

    # Events and commands

    def events_after(
        self, event_id: int, topics: Collection[str] | None = None, limit: int | None = 500
    ) -> list[EventRow]:
        """Events behind an id, in order."""
        return self.rows(EventRow, after_id=event_id, topics=topics, limit=limit)

    def last_told(self, *kinds: str) -> EventRow | None:
        """Newest event of the service itself of one of these kinds, None where there is none."""
        return self._newest_row(EventRow, (events.c.topic == "service") & events.c.kind.in_(kinds))

    def held(self) -> str | None:
        """Who holds the test and why, None while nobody does."""
        told = self.last_told("hold", "release")
        return None if told is None else told.payload["held"] or None

    def last_event_id(self) -> int:
        """Id of the newest event, 0 before the first."""
        with self._reading() as connection:
            return int(connection.execute(select(func.max(events.c.id))).scalar_one() or 0)

    def command(self, command_id: int) -> CommandRow | None:
        """One command, None where there is no such id."""
        return self._newest_row(CommandRow, commands.c.id == command_id)

    def add_command(
        self, author: str, kind: str, arguments: dict[str, Any], *, within_s: float = ORDER_WITHIN_S
    ) -> int:
        """Write an operator's order for the recorder and return its id.

        Parameters
        ----------
        within_s
            An order that is not begun within this time expires.

        Raises
        ------
        CatalogueBusyError, CatalogueWriteError
            Nothing was written.
        """
        with translated(self._path, "writing a command"), writing(self._for_commands()) as connection:
            now_ns, within_ns = time.time_ns(), round(within_s * NS_PER_S)
            row = CommandRow(
                id=int(connection.execute(select(func.max(commands.c.id))).scalar_one() or 0) + 1,
                wall_utc_ns=now_ns,
                author=author,
                kind=kind,
                arguments=arguments,
                state="pending",
                deadline_wall_utc_ns=now_ns + within_ns,
                deadline_boot_ns=elapsed_ns() + within_ns,
                boot_id=boot_name(),
            )
            connection.execute(insert(commands), storable(row))
            return row.id

    def _for_commands(self) -> Engine:
        if self._command_engine is None:
            self._command_engine = make_engine(self._path, writable=True)
        return self._command_engine


def _chosen(statement: Select[Any], table: Table, filters: Filters) -> Select[Any]:
    for name, value in filters.items():
        if value is not None:
            condition = _CONDITIONS.get(name)
            statement = statement.where(condition(table, value) if condition else table.c[name] == value)
    return statement.order_by(*table.primary_key.columns)


def _made(connection: Connection, kind: type[R], statement: Select[Any]) -> list[R]:
    return list(checked_rows(connection, kind, statement))


def _newest(connection: Connection, kind: type[OfSet], scope: Scope | None = None) -> dict[str, OfSet]:
    """Row of the highest set index of each position."""
    table, filters = table_of(kind), Filters(scope=scope)
    newest = select(table.c.position, func.max(table.c.set_index).label("set_index"))
    last = _chosen(newest, table, filters).order_by(None).group_by(table.c.position).subquery()
    statement = select(table).join(
        last, (table.c.position == last.c.position) & (table.c.set_index == last.c.set_index)
    )
    return {row.position: row for row in _made(connection, kind, _chosen(statement, table, filters))}
