"""Store a row of a set once: the event that reports it has no payload, and a reader joins the row.

A row that changes later is not joined: the event of an alarm, a baseline, an annotation or an assessment of a
collecting baseline keeps the row as it was reported.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, TypeVar

import orjson
import sqlalchemy as sa

from daq_service.catalogue.connection import json_text
from daq_service.catalogue.row_checksum import DamagedRow, checked_rows
from daq_service.catalogue.rows import (
    AssessmentRow,
    EnvironmentRow,
    EventRow,
    FeatureRow,
    Row,
    SetRow,
    ThicknessRow,
    values,
)
from daq_service.catalogue.tables import events, table_of
from hardware_drivers.measurement import SetKey

R = TypeVar("R", bound=Row)
Key = tuple[type[Row], str | None, SetKey | None]

ROW_OF_EVENT: Mapping[str, type[Row]] = MappingProxyType(
    {
        "set_done": SetRow,
        "set_partial": SetRow,
        "set_missed": SetRow,
        "set_disabled": SetRow,
        "set_features": FeatureRow,
        "thickness_read": ThicknessRow,
        "set_assessed": AssessmentRow,
        "environment_read": EnvironmentRow,
    }
)
"""Kind of row that an event reports, by the kind of the event."""
_SETS_AT_ONCE = 500


def reported(row: Row) -> dict[str, Any]:
    """Return a row of a set as the payload of its event."""
    # The SHA-256 comes when the file is made, which differs between two runs of one test.
    return {
        name: None if name == "file_sha256" else value for name, value in values(row).items() if name != "id"
    }


def is_joined(event: EventRow) -> bool:
    """Return whether an event is stored without its row."""
    return not event.payload and event.kind in ROW_OF_EVENT


def without_rows(reports: Iterable[EventRow], rows: Iterable[Row]) -> list[EventRow]:
    """Return events as they are stored with rows: without a payload that is one of them and never changes."""
    payloads = {
        _key_of_row(row): reported(row)
        for row in rows
        if not (isinstance(row, AssessmentRow) and row.in_baseline)
    }
    return [
        replace(event, payload={})
        if event.payload and _is_part(event.payload, payloads.get(_key(event), {}))
        else event
        for event in reports
    ]


def joined(reports: Iterable[R], rows: Iterable[Row]) -> list[R]:
    """Return events with the rows that they report; everything else unchanged."""
    by_key = {_key_of_row(row): row for row in rows}
    return [
        replace(event, payload=reported(by_key[_key(event)]))
        if isinstance(event, EventRow) and is_joined(event) and _key(event) in by_key
        else event
        for event in reports
    ]


def with_rows(connection: sa.Connection, reports: list[R]) -> list[R]:
    """Return events as they are read: with the rows that they report; other kinds of rows unchanged.

    Raises
    ------
    DamagedRow
        The row of an event is lost, or one does not match its checksum.
    """
    reporting = [event for event in reports if isinstance(event, EventRow) and is_joined(event)]
    rows: list[Row] = []
    for kind in dict.fromkeys(ROW_OF_EVENT[event.kind] for event in reporting):
        of_kind = [event for event in reporting if ROW_OF_EVENT[event.kind] is kind]
        positions = sorted({event.position for event in of_kind if event.position is not None})
        indices = sorted({event.set_index for event in of_kind if event.set_index is not None})
        for start in range(0, len(indices), _SETS_AT_ONCE):
            some = indices[start : start + _SETS_AT_ONCE]
            statement = _OF_SOME_SETS[kind].params(positions=positions, indices=some)
            rows += checked_rows(connection, kind, statement)
    reports = joined(reports, rows) if reporting else reports
    for event in reports:
        if isinstance(event, EventRow) and is_joined(event):
            raise DamagedRow(_lost_row(event.id, ROW_OF_EVENT[event.kind]))
    return reports


def of_sets(kind: type[Row]) -> sa.Select[Any]:
    """Return the query for the rows of a kind that events report."""
    table = table_of(kind)
    statement = sa.select(table)
    return statement.where(table.c.shot_index.is_(None)) if kind is FeatureRow else statement


def _of_some_sets(kind: type[Row]) -> sa.Select[Any]:
    """Return the query for the rows of some positions and sets, which finds each in an index."""
    table = table_of(kind)
    statement = of_sets(kind).where(table.c.set_index.in_(sa.bindparam("indices", expanding=True)))
    if "position" in table.c:
        return statement.where(table.c.position.in_(sa.bindparam("positions", expanding=True)))
    return statement


_OF_SOME_SETS = {kind: _of_some_sets(kind) for kind in ROW_OF_EVENT.values()}


def lost_rows(connection: sa.Connection) -> Iterator[tuple[int, str]]:
    """Yield id and description of the events whose row is lost."""
    for event_kind, kind in ROW_OF_EVENT.items():
        table = table_of(kind)
        names = [name for name in ("position", *SetKey._fields) if name in table.c]
        of_event = [table.c[name] == events.c[name] for name in names]
        row = of_sets(kind).where(*of_event).correlate(events)
        statement = sa.select(events.c.id).where(
            events.c.kind == event_kind, events.c.payload == {}, ~row.exists()
        )
        for (event_id,) in connection.execute(statement):
            yield event_id, _lost_row(event_id, kind)


def _lost_row(event_id: int | None, kind: type[Row]) -> str:
    return f"row {event_id} of table {events.name} lacks its row of table {table_of(kind).name}"


def _is_part(payload: Mapping[str, Any], columns: Mapping[str, Any]) -> bool:
    """Return whether a payload has no other values than a row: an earlier version had fewer columns."""
    part = {name: columns[name] for name in payload if name in columns}
    return part == payload or _as_stored(part) == _as_stored(payload)


def _as_stored(payload: Mapping[str, Any]) -> Any:
    """Return a payload as it is read again: what is not finite is not available."""
    return orjson.loads(json_text(payload))


def _key(event: EventRow) -> Key:
    return ROW_OF_EVENT.get(event.kind, EventRow), event.position, event.set_key


def _key_of_row(row: Any) -> Key:
    return type(row), getattr(row, "position", None), getattr(row, "set_key", SetKey(row.set_index))
