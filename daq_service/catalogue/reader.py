"""Query the catalogue; results are rows (`catalogue.rows`) with JSON-ready values."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, Self, TypedDict, TypeVar, Unpack

import sqlalchemy as sa

from daq_service.catalogue.connection import create_sqlite_engine
from daq_service.catalogue.errors import CatalogueError, NoDataYetError
from daq_service.catalogue.published_columns import Purposes
from daq_service.catalogue.reported_rows import join_reported_rows
from daq_service.catalogue.rows import (
    AlarmRow,
    AssessmentRow,
    BaselineRow,
    CommandRow,
    CountsRow,
    EnvironmentRow,
    EventRow,
    ExperimentRow,
    FeatureRow,
    Row,
    SetRow,
    ThicknessRow,
    WallRow,
    as_dict,
)
from daq_service.catalogue.stored_rows import (
    DamagedRow,
    begin_write,
    insert_rows,
    read_rows,
    read_values,
    translate_errors,
)
from daq_service.catalogue.tables import (
    RARE_TOPICS,
    TABLES,
    alarms,
    annotated,
    commands,
    counts,
    events,
    features,
    sets,
)
from daq_service.clock import boot_name, elapsed_ns
from hardware_drivers.measurement import SetKey
from hardware_drivers.methods import Method
from hardware_drivers.nanoseconds import NS_PER_S

R = TypeVar("R", bound=Row)
OfSet = TypeVar("OfSet", SetRow, FeatureRow, ThicknessRow, WallRow, AssessmentRow)
Scope = Literal["set", "shot"]

_MAX_VALUES = 500
"""Maximum number of values in one condition."""
ACTIVE_STATES = ("acknowledged", "returned_unacknowledged", "unacknowledged")
GAP_STATES = ("missed", "partial")
ORDER_WITHIN_S = 60.0
"""Default time after which a command that has not started expires."""


class Filters(TypedDict, total=False):
    """Conditions that select rows of a table; a missing or None condition selects all.

    Only rows of scheduled sets are selected, unless an ``unscheduled_index`` or a ``purpose`` is given:
    charts, trends and counts must not include a confirmation set.
    ``active`` False: alarms back to normal, True: the others. ``scope``: features of sets, or of
    single shots. ``tried``: sets with a strike or a record. ``first_h <= due_h <= last_h`` (of annotations
    any of their hours, of alarms when they were raised), ``withdrawn`` annotations or the others,
    ``first_set <= set_index <= last_set``.
    """

    position: str | None
    set_index: int | None
    unscheduled_index: int | None
    state: str | None
    priority: str | None
    states: Collection[str] | None
    scope: Scope | None
    active: bool | None
    topics: Collection[str] | None
    topic: str | None
    kind: str | None
    first_h: float | None
    last_h: float | None
    tried: bool | None
    withdrawn: bool | None
    first_set: int | None
    last_set: int | None
    after_id: int | None
    purpose: Purposes | None


_HOURS: Mapping[sa.Table, tuple[str, str]] = {annotated: ("from_h", "to_h"), alarms: ("raised_h", "raised_h")}
"""Columns of the first and last hour in tables without sets."""
_CONDITIONS: Mapping[str, Callable[[sa.Table, Any], sa.ColumnElement[bool]]] = {
    "scope": lambda table, scope: (
        table.c.shot_index.is_(None) if scope == "set" else table.c.shot_index.is_not(None)
    ),
    "active": lambda table, active: table.c.state.in_(ACTIVE_STATES) if active else table.c.state == "normal",
    "states": lambda table, states: table.c.state.in_(sorted(states)),
    "topics": lambda table, topics: table.c.topic.in_(sorted(topics)),
    "first_h": lambda table, hour: (
        table.c[_HOURS[table][1]] >= hour
        if table in _HOURS
        else (table.c.due_h >= hour) & (table.c.set_index >= build_set_at_query(table, hour, "first"))
    ),
    "last_h": lambda table, hour: (
        table.c[_HOURS[table][0]] <= hour
        if table in _HOURS
        else (table.c.due_h <= hour) & (table.c.set_index <= build_set_at_query(table, hour, "last"))
    ),
    "withdrawn": lambda table, withdrawn: (
        table.c.withdrawn_utc_ns.is_not(None) if withdrawn else table.c.withdrawn_utc_ns.is_(None)
    ),
    "tried": lambda table, _: table.c.n_taken + table.c.n_missed > 0,
    "first_set": lambda table, index: table.c.set_index >= index,
    "last_set": lambda table, index: table.c.set_index <= index,
    # Literal in the statement: only then SQLite uses the index of this topic.
    "topic": lambda table, topic: table.c.topic == sa.literal(topic, literal_execute=True),
    "purpose": lambda table, purpose: (
        sa.true()
        if purpose == "any"
        else is_scheduled(table)
        if purpose == "planned"
        else table.c.unscheduled_index > sa.literal_column("0")  # literal, as in the index
    ),
}
"""A filter that is not listed compares a column; ``after_id`` uses `_build_after_condition`."""
_HOURS_OF_UNSCHEDULED: Mapping[str, Callable[[sa.Table, Any], sa.ColumnElement[bool]]] = {
    "first_h": lambda table, hour: table.c.due_h >= hour,
    "last_h": lambda table, hour: table.c.due_h <= hour,
}
"""Hours of unscheduled sets do not increase with the index; there are few such sets."""


def is_scheduled(table: sa.FromClause) -> sa.ColumnElement[bool]:
    """Build the condition that selects rows of scheduled sets; true if a table has no unscheduled ones."""
    return table.c.unscheduled_index == 0 if "unscheduled_index" in table.c else sa.true()


def build_set_at_query(table: sa.Table, hour: float, which: Literal["first", "last"]) -> sa.ScalarSelect[int]:
    """Build the subquery for the first scheduled set due at an hour or later, or the last one due until then.

    The result is a set index, NULL if there is no such set. Hours increase with the set index, so a range of
    hours is a range of sets and uses an index.
    """
    due = sets if "position" in table.c else table
    found = sa.select(due.c.set_index).where(is_scheduled(due)).limit(1)
    if which == "first":
        found = found.where(due.c.due_h >= hour).order_by(due.c.due_h)
    else:
        found = found.where(due.c.due_h <= hour).order_by(due.c.due_h.desc())
    return found.scalar_subquery()


@dataclass(frozen=True, slots=True, kw_only=True)
class LatestRows:
    """Newest rows of a position; ``last_feature`` is of a set."""

    position: str
    method: Method
    last_set: SetRow | None = None
    last_feature: FeatureRow | None = None
    last_assessment: AssessmentRow | None = None
    last_thickness: ThicknessRow | None = None
    last_wall: WallRow | None = None
    active_alarms: Sequence[AlarmRow] = ()


class Catalogue:
    """Catalogue for reading; it writes only commands.

     Created by `open_catalogue`. Threads may share it; close it, or use it as a context
    manager. ``limit=None`` means all rows, ``after_id`` pages behind a row.
    """

    def __init__(self, path: Path, engine: sa.Engine) -> None:
        """Store the file's path and the engine for reading; connect to nothing."""
        self._path = path
        self._engine = engine
        self._command_engine: sa.Engine | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close every connection for reading and for commands; may be called again."""
        self._engine.dispose()
        if self._command_engine is not None:
            self._command_engine.dispose()

    @contextmanager
    def open_snapshot(self) -> Iterator[sa.Connection]:
        """Open a read transaction of one state for queries; errors of SQL in it become `CatalogueError`."""
        with translate_errors(self._path, "reading"), self._engine.begin() as connection:
            yield connection

    # Rows of every kind

    def rows(self, kind: type[R], /, *, limit: int | None = None, **filters: Unpack[Filters]) -> list[R]:
        """Read at most ``limit`` rows that meet the filters, in the order of `filter_by`.

        Raises CatalogueDamagedError at a corrupt row.
        """
        return self._read_rows(kind, _build_query(kind, limit, filters), _find_required(kind, filters))

    def read_last_rows(
        self, kind: type[R], position: str, count: int | None, /, **filters: Unpack[Filters]
    ) -> list[R]:
        """Read the newest ``count`` scheduled rows (None: all) of a position in set order, newest last."""
        table = TABLES[kind]
        statement = filter_by(sa.select(table), table, {**filters, "position": position})
        newest_first = statement.order_by(None).order_by(*(column.desc() for column in _list_set_key(table)))
        required = _find_required(kind, {**filters, "position": position})
        return self._read_rows(kind, newest_first.limit(count), required)[::-1]

    def read_newest_gaps(self, count: int) -> list[SetRow]:
        """Read the newest ``count`` missed and the newest ``count`` partial sets of each position."""
        return self._read_rows(SetRow, _build_newest_gaps_query(count))

    def read_newest_recorded(self) -> SetRow | None:
        """Read a row of the newest scheduled set that has a file; None if there is none."""
        return self._read_newest_row(SetRow, sets.c.file.is_not(None) & is_scheduled(sets))

    def list_newest_files(self, n_rows: int) -> dict[SetKey, str]:
        """List the distinct files that the newest ``n_rows`` rows of sets name, by set key in order."""
        with self.open_snapshot() as connection:
            return _read_files_by_key(connection, _build_newest_files_query(n_rows))

    def count_stored_sets(self, position: str, first_set: int, last_set: int) -> int:
        """Count the scheduled sets of a position that have records, ``first_set`` to ``last_set``."""
        in_range = is_scheduled(sets) & sets.c.set_index.between(first_set, last_set)
        filtered_sets = (sets.c.position == position) & in_range
        with self.open_snapshot() as connection:
            return connection.execute(
                sa.select(sa.func.count()).where(
                    filtered_sets & sets.c.file.is_not(None) & (sets.c.n_taken > 0)
                )
            ).scalar_one()

    def read_first_thickness(self, position: str) -> ThicknessRow | None:
        """Read a position's first scheduled pulse-echo result with a travel time; None without one."""
        table = TABLES[ThicknessRow]
        statement = filter_by(sa.select(table), table, {"position": position})
        rows = self._read_rows(ThicknessRow, statement.where(table.c.travel_time_s.is_not(None)).limit(1))
        return rows[0] if rows else None

    def read_baselines_by_id(self) -> dict[int, BaselineRow]:
        """Read all baselines in any state, also retired ones, as a dictionary by id."""
        return {row.id: row for row in self.rows(BaselineRow) if row.id is not None}

    def columns(
        self,
        kind: type[Row],
        names: Sequence[str],
        /,
        *,
        limit: int | None = None,
        **filters: Unpack[Filters],
    ) -> dict[str, list[Any]]:
        """Read columns as lists of equal length by name; filters, order and errors as in `rows`.

        Raises CatalogueError if a name is no column of the table.
        """
        if unknown := set(names) - set(kind.__slots__):
            of_table = f"{TABLES[kind].name!r}; it has {sorted(kind.__slots__)}"
            raise CatalogueError(f"{sorted(unknown)} are not columns of {of_table}")
        if not names:
            return {}
        # Complete rows: only these can be compared with their checksums.
        with self.open_snapshot() as connection:
            rows = list(read_values(connection, kind, _build_query(kind, limit, filters)))
            columns = dict(zip(kind.__slots__, zip(*rows, strict=True), strict=False))
            _raise_if_values_differ(kind, _find_required(kind, filters), lambda name: columns.get(name, ()))
        return {name: list(columns.get(name, ())) for name in names}

    def _read_rows(
        self, kind: type[R], statement: sa.Select[Any], required: Mapping[str, object] = MappingProxyType({})
    ) -> list[R]:
        """Read the rows of a query, events with the rows they report; CatalogueDamagedError if corrupt."""
        with self.open_snapshot() as connection:
            return join_reported_rows(
                connection, _collect_checked_rows(kind, required, read_rows(connection, kind, statement))
            )

    def _read_newest_row(self, kind: type[R], condition: sa.ColumnElement[bool] | None = None) -> R | None:
        """Read the row with the highest id that meets a condition (None: any); None if there is none."""
        table = TABLES[kind]
        statement = sa.select(table).order_by(table.c.id.desc()).limit(1)
        rows = self._read_rows(kind, statement if condition is None else statement.where(condition))
        return rows[0] if rows else None

    # The experiment as a whole

    def read_experiment(self) -> ExperimentRow:
        """Read the row that identifies the test: name, configuration and its hash, hour 0, clock.

        Raises NoDataYetError if the experiment has not started.
        """
        row = self._read_newest_row(ExperimentRow)
        if row is None:
            raise NoDataYetError(
                f"{self._path}: the test has not started; start `solimon record` or wait for it",
                self._path.parent,
            )
        return row

    def list_position_names(self) -> list[str]:
        """List the configured positions in their order; NoDataYetError before the test starts."""
        return list(self.read_experiment().configuration.get("positions", ()))

    def counts(self) -> dict[str, int]:
        """Read the numbers of stored sets, shots, records and events, and of active alarms.

        Returns
        -------
        dict
            ``sets``: due times with at least one record, ``missed_sets``: due times that were
            missed altogether, ``partial_sets``: of the ``sets``, those that lack something;
            ``shots``: solitary-wave shots, ``pulse_echo_records``: likewise of scheduled sets;
            ``events`` and ``active_alarms``: all.
        """
        with self.open_snapshot() as connection:
            (row,) = read_rows(connection, CountsRow, sa.select(counts))
            n_alarms = connection.execute(
                filter_by(sa.select(sa.func.count()), alarms, {"active": True}).order_by(None)
            ).scalar_one()
        return {name: number for name, number in as_dict(row).items() if name != "id"} | {
            "active_alarms": n_alarms
        }

    def list_files_except(self, known: Collection[SetKey]) -> dict[SetKey, str]:
        """List the files of all sets except the ``known`` ones by set key, in no fixed order.

        Sets without a file are omitted.
        """
        positions = self.list_position_names()
        scheduled = {set_index for set_index, unscheduled_index in known if not unscheduled_index}
        with self.open_snapshot() as connection:
            unscheduled = _read_files_by_key(connection, _build_unscheduled_query())
            files = {key: file for key, file in unscheduled.items() if key not in known}
            last = connection.execute(_build_last_index_query()).scalar()
            remaining = sorted(set(range(0 if last is None else last + 1)) - scheduled)
            for start in range(0, len(remaining), _MAX_VALUES):
                indices_of_step = remaining[start : start + _MAX_VALUES]
                statement = _FILES.where(
                    sets.c.position.in_(positions),
                    sets.c.set_index.in_(indices_of_step),
                    is_scheduled(sets),
                    sets.c.file.is_not(None),
                ).distinct()  # a row a position
                files |= _read_files_by_key(connection, statement)
        return files

    def read_latest_rows(self) -> dict[str, LatestRows]:
        """Read the newest scheduled rows and active alarms of each position in ``sets``, in its order."""
        with self.open_snapshot() as connection:
            last_sets = _read_newest_rows(connection, SetRow)
            last_features = _read_newest_rows(connection, FeatureRow)
            last_assessments = _read_newest_rows(connection, AssessmentRow)
            last_thicknesses = _read_newest_rows(connection, ThicknessRow)
            last_walls = _read_newest_rows(connection, WallRow)
            active = list(
                read_rows(connection, AlarmRow, filter_by(sa.select(alarms), alarms, {"active": True}))
            )
        return {
            position: LatestRows(
                position=position,
                method=row.method,
                last_set=row,
                last_feature=last_features.get(position),
                last_assessment=last_assessments.get(position),
                last_thickness=last_thicknesses.get(position),
                last_wall=last_walls.get(position),
                active_alarms=[alarm for alarm in active if alarm.position == position],
            )
            for position, row in sorted(last_sets.items())
        }

    def read_last_environment(self) -> EnvironmentRow | None:
        """Read the newest stored row of supply and climate, of any earlier set; None without one."""
        return self._read_newest_row(EnvironmentRow)

    def baseline(self, position: str) -> BaselineRow | None:
        """Read the newest baseline of a position, in any state, also retired; None if there is none."""
        return self._read_newest_row(BaselineRow, TABLES[BaselineRow].c.position == position)

    def read_newest_baselines(self) -> dict[str, BaselineRow]:
        """Read the newest baseline, in any state, of each position that has one, by position."""
        return {row.position: row for row in self.rows(BaselineRow)}  # the newest is last

    def find_newest_id(self, kind: type[AlarmRow] | type[CommandRow]) -> int:
        """Return the id of the newest alarm or command, 0 before the first; no row is ever deleted."""
        with self.open_snapshot() as connection:
            return int(connection.execute(sa.select(sa.func.max(TABLES[kind].c.id))).scalar_one() or 0)

    def alarm(self, alarm_id: int) -> AlarmRow | None:
        """Read an alarm by its id; None if there is none."""
        return self._read_newest_row(AlarmRow, alarms.c.id == alarm_id)

    # Events and commands

    def read_events_after(
        self, event_id: int, topics: Collection[str] | None = None, limit: int | None = 500
    ) -> list[EventRow]:
        """Read at most ``limit`` events (None: all) with higher ids, by id, of ``topics`` (None: all)."""
        return self.rows(EventRow, after_id=event_id, topics=topics, limit=limit)

    def read_last_service_event(self, *kinds: str) -> EventRow | None:
        """Read the newest event of topic ``service`` of one of these kinds; None if there is none."""
        last_id = filter_by(sa.select(sa.func.max(events.c.id)), events, {"topic": "service"}).order_by(None)
        newest = last_id.where(events.c.kind.in_(kinds)).scalar_subquery()
        return self._read_newest_row(EventRow, events.c.id == newest)

    def read_last_event(self, topic: str) -> EventRow | None:
        """Read the newest event of a topic; None if there is none. Slow for a topic with few events."""
        return self._read_newest_row(EventRow, events.c.topic == topic)

    def paused(self) -> str | None:
        """Return who paused the test and why as one text; None if it is not paused now."""
        event = self.read_last_service_event("pause", "resume")
        return None if event is None else event.payload["paused"] or None

    def last_event_id(self) -> int:
        """Return the id of the newest event, 0 before the first."""
        with self.open_snapshot() as connection:
            return int(connection.execute(sa.select(sa.func.max(events.c.id))).scalar_one() or 0)

    def command(self, command_id: int) -> CommandRow | None:
        """Read a command by its id; None if there is none."""
        return self._read_newest_row(CommandRow, commands.c.id == command_id)

    def add_command(
        self, author: str, kind: str, arguments: dict[str, Any], *, within_s: float = ORDER_WITHIN_S
    ) -> int:
        """Store a command as pending for the recorder and return its id.

        It expires if it has not started ``within_s`` later. Raises CatalogueBusyError or CatalogueWriteError
        if nothing was written.
        """
        with (
            translate_errors(self._path, "writing a command"),
            begin_write(self._open_writer()) as connection,
        ):
            now_ns, within_ns = time.time_ns(), round(within_s * NS_PER_S)
            row = CommandRow(
                id=0,
                wall_utc_ns=now_ns,
                author=author,
                kind=kind,
                arguments=arguments,
                state="pending",
                deadline_wall_utc_ns=now_ns + within_ns,
                deadline_boot_ns=elapsed_ns() + within_ns,
                boot_id=boot_name(),
            )
            return store_command(connection, row)

    def _open_writer(self) -> sa.Engine:
        """Return the engine that writes commands, which the first call creates; it connects on first use."""
        if self._command_engine is None:
            self._command_engine = create_sqlite_engine(self._path, writable=True)
        return self._command_engine


def filter_by(statement: sa.Select[Any], table: sa.Table, filters: Filters) -> sa.Select[Any]:
    """Add the conditions of filters, and an order, to a query of a table.

    Only scheduled sets are selected unless a filter names others. The order is that of the sets if a filter
    selects some of them, else that of the ids; ``after_id`` keeps the rows behind that one. The table must
    have the column of each filter (KeyError, AttributeError).
    """
    values = {name: value for name, value in filters.items() if value is not None and name != "after_id"}
    after_id = filters.get("after_id")
    if table is not events and "unscheduled_index" in table.c and "unscheduled_index" not in values:
        values.setdefault("purpose", "planned")
    hour_conditions = _HOURS_OF_UNSCHEDULED if values.get("purpose", "planned") != "planned" else {}
    for name, value in values.items():
        condition = hour_conditions.get(name) or _CONDITIONS.get(name)
        statement = statement.where(condition(table, value) if condition else table.c[name] == value)
    # Indices start with the filtered column, then the set: so a page needs no sorting.
    is_complete_test = values.keys() <= {"scope", "purpose"} and values.get("purpose") != "confirmation"
    by_set = "set_index" in table.c and table is not events and not is_complete_test
    order = (*(_list_set_key(table) if by_set else []), *table.primary_key.columns)
    if after_id is not None:
        statement = statement.where(_build_after_condition(table, order, after_id))
    elif values.get("topic") in RARE_TOPICS:
        # In the order of ids SQLite would read all events; sorting the few events of a topic is fast.
        return statement.order_by(sa.text("+events.id"))
    return statement.order_by(*order)


def _find_required(kind: type[Row], filters: Filters) -> dict[str, object]:
    """Collect the values by column that every row of filters must have, to detect a corrupt index."""
    columns = [name for name in filters if name == "topic" or name not in _CONDITIONS]
    required = {name: filters.get(name) for name in columns if name in kind.__slots__}
    required = {name: value for name, value in required.items() if value is not None}
    of_sets = kind is FeatureRow and filters.get("scope") == "set"
    return {**required, "shot_index": None} if of_sets else required


def _raise_if_values_differ(
    kind: type[Row], required: Mapping[str, object], values_of: Callable[[str], Iterable[object]]
) -> None:
    """Raise DamagedRow if a column has another value than the required one in any row.

    ``values_of`` returns all values of a column. SQLite does not compare the row that an index leads to with
    the condition of the query.
    """
    for name, value in required.items():
        for found in values_of(name):
            if found != value:
                raise DamagedRow(
                    f"an index of table {TABLES[kind].name} is corrupt: it leads to a row "
                    f"where {name} is {found!r}, not {value!r}"
                )


def _collect_checked_rows(kind: type[R], required: Mapping[str, object], found: Iterable[R]) -> list[R]:
    """Collect rows in a list; raise DamagedRow at one without a ``required`` value (by column)."""
    rows = list(found)
    _raise_if_values_differ(kind, required, lambda name: (getattr(row, name) for row in rows))
    return rows


def _list_set_key(table: sa.Table) -> list[sa.Column[int]]:
    """List those columns of a table that form a set's key, index first; empty if it has none."""
    return [table.c[name] for name in SetKey._fields if name in table.c]


def _read_files_by_key(connection: sa.Connection, statement: sa.Select[int, int, str]) -> dict[SetKey, str]:
    """Run a query with the columns of `_FILES` and return the files by set key, in the order of its rows."""
    return {SetKey(*key): file for *key, file in connection.execute(statement)}


def _build_after_condition(
    table: sa.Table, order: Sequence[sa.ColumnElement[Any]], row_id: int
) -> sa.ColumnElement[bool]:
    """Build the condition for the rows that follow row ``row_id`` in an order that ends with the id.

    If there is no such row, an order by more than the id selects nothing.
    """
    if len(order) == 1:
        return order[0] > row_id
    values = [sa.select(column).where(table.c.id == row_id).scalar_subquery() for column in order]
    return (order[0] >= values[0]) & (sa.tuple_(*order) > sa.tuple_(*values))


def store_command(connection: sa.Connection, row: CommandRow) -> int:
    """Store a command under the next free id, not its own, and return it; the caller has the lock."""
    row = replace(
        row, id=int(connection.execute(sa.select(sa.func.max(commands.c.id))).scalar_one() or 0) + 1
    )
    return insert_rows(connection, [row])[0]


def _build_query(kind: type[Row], limit: int | None, filters: Filters) -> sa.Select[Any]:
    """Build the query for at most ``limit`` filtered rows of a kind (None: all), ordered by `filter_by`."""
    return filter_by(sa.select(TABLES[kind]), TABLES[kind], filters).limit(limit)


def _read_newest_rows(connection: sa.Connection, kind: type[OfSet]) -> dict[str, OfSet]:
    """Read the newest scheduled row of each position in ``sets``, by position; of features only rows of sets.

    Raises DamagedRow at a corrupt row or index.
    """
    required = _find_required(kind, {"scope": "set"})
    newest = read_rows(connection, kind, _build_newest_query(TABLES[kind]))
    return {row.position: row for row in _collect_checked_rows(kind, required, newest)}


# Statements of several steps: building one takes longer than executing it ------------------------------


def _build_positions_query() -> sa.CTE:
    """Build the recursive query for the names of positions in ``sets``, in order, with a final NULL."""
    # One index step finds the next name, independent of the number of sets.
    first = sa.select(sa.func.min(sets.c.position).label("position")).cte("places", recursive=True)
    following = sa.select(sa.func.min(sets.c.position)).where(sets.c.position > first.c.position)
    return first.union_all(sa.select(following.scalar_subquery()).where(first.c.position.is_not(None)))


@cache
def _build_newest_query(table: sa.Table) -> sa.Select[Any]:
    """Build the cached query for the newest scheduled row of each position; of features, that of a set."""
    names, of_position = _build_positions_query(), table.alias("of_place")
    newest = sa.select(of_position.c.id).where(
        of_position.c.position == names.c.position, is_scheduled(of_position)
    )
    if table is features:  # of a set
        newest = newest.where(of_position.c.shot_index.is_(None))
    last = newest.order_by(of_position.c.set_index.desc()).limit(1).scalar_subquery()
    return sa.select(table).join(names, table.c.id == last)


@cache
def _build_last_index_query() -> sa.Select[Any]:
    """Build the cached query for the highest index of a scheduled set; its result is NULL without one."""
    names = _build_positions_query()
    newest = sa.select(sa.func.max(sets.c.set_index)).where(
        sets.c.position == names.c.position, is_scheduled(sets)
    )
    return sa.select(sa.func.max(newest.scalar_subquery())).select_from(names)


_FILES = sa.select(sets.c.set_index, sets.c.unscheduled_index, sets.c.file)


@cache
def _build_unscheduled_query() -> sa.Select[int, int, str]:
    """Build the cached query for the files of unscheduled sets that have one, in the order of their keys."""
    unscheduled = _CONDITIONS["purpose"](sets, "confirmation")
    return _FILES.where(unscheduled, sets.c.file.is_not(None)).order_by(*_list_set_key(sets))


@cache
def _build_newest_files_query(n_rows: int) -> sa.Select[int, int, str]:
    """Build the query for the distinct files of the newest ``n_rows`` rows of sets, in the order of keys."""
    newest = _FILES.order_by(sets.c.id.desc()).limit(n_rows).subquery().c
    statement = sa.select(newest.set_index, newest.unscheduled_index, newest.file)
    order = (newest.set_index, newest.unscheduled_index)
    return statement.where(newest.file.is_not(None)).distinct().order_by(*order)


@cache
def _build_newest_gaps_query(count: int) -> sa.Select[Any]:
    """Build the cached query for the newest ``count`` missed and the newest ``count`` partial scheduled sets.

    It selects so many of each position, in no order.
    """
    names, of_position = _build_positions_query(), sets.alias("of_place")
    states = sa.union_all(*(sa.select(sa.literal(state).label("state")) for state in GAP_STATES)).cte(
        "states"
    )
    newest = (
        sa.select(of_position.c.id)
        .where(
            of_position.c.position == names.c.position,
            of_position.c.state == states.c.state,
            is_scheduled(of_position),
        )
        .order_by(of_position.c.set_index.desc())
        .limit(count)
    )
    return sa.select(sets).select_from(names.join(states, sa.true()).join(sets, sets.c.id.in_(newest)))
