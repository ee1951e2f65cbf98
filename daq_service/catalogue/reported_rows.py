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

from daq_service.catalogue.rows import (
    AssessmentRow,
    EnvironmentRow,
    EventRow,
    FeatureRow,
    Row,
    SetRow,
    ThicknessRow,
    WallRow,
    as_dict,
)
from daq_service.catalogue.stored_rows import DamagedRow, read_values, to_json_text
from daq_service.catalogue.tables import TABLES, events
from hardware_drivers.measurement import SetKey

R = TypeVar("R", bound=Row)
Key = tuple[type[Row], str | None, SetKey | None]
Payload = dict[str, Any]

ROW_OF_EVENT: Mapping[str, type[Row]] = MappingProxyType(
    {
        "set_done": SetRow,
        "set_partial": SetRow,
        "set_missed": SetRow,
        "set_disabled": SetRow,
        "set_features": FeatureRow,
        "thickness_read": ThicknessRow,
        "wall_estimated": WallRow,
        "set_assessed": AssessmentRow,
        "environment_read": EnvironmentRow,
    }
)
"""Kind of row that an event reports, by the kind of the event."""
_SETS_AT_ONCE = 500


def to_payload(row: Row) -> Payload:
    """Convert a row of a set to its event's payload: its columns without id, ``file_sha256`` as None."""
    return _to_payload_columns(as_dict(row))


def _to_payload_columns(columns: Payload) -> Payload:
    """Remove the id from a row's columns and set an existing ``file_sha256`` to None, both in place.

    Returns the same dictionary.
    """
    columns.pop("id")
    if "file_sha256" in columns:  # it comes when the file is made, which differs between two runs of one test
        columns["file_sha256"] = None
    return columns


def lacks_row(event: EventRow) -> bool:
    """Return whether an event is stored without payload because it reports a row that is stored elsewhere."""
    return not event.payload and event.kind in ROW_OF_EVENT


def strip_payloads(reports: Iterable[EventRow], rows: Iterable[Row]) -> list[EventRow]:
    """Return the events as they are stored: with an empty payload where it repeats one of the rows.

    A row of a collecting baseline may change, so its event keeps the payload.
    """
    payloads = to_payloads(row for row in rows if not (isinstance(row, AssessmentRow) and row.in_baseline))
    return [
        replace(event, payload={})
        if event.payload and _is_payload_of_row(event.payload, payloads.get(_build_event_key(event), {}))
        else event
        for event in reports
    ]


def join_rows(reports: Iterable[R], payloads: Mapping[Key, Payload]) -> list[R]:
    """Return the events with the payloads of the rows that they report, in order.

    ``payloads`` has them by row key; events whose row it lacks, and other kinds of rows, are unchanged.
    """
    return [
        replace(event, payload=payloads[_build_event_key(event)])
        if isinstance(event, EventRow) and lacks_row(event) and _build_event_key(event) in payloads
        else event
        for event in reports
    ]


def to_payloads(rows: Iterable[Row]) -> dict[Key, Payload]:
    """Build event payloads from rows of sets, by the key of each row; rows of single shots are omitted."""
    return {_build_row_key(row): to_payload(row) for row in rows if getattr(row, "shot_index", None) is None}


def join_reported_rows(connection: sa.Connection, reports: list[R]) -> list[R]:
    """Read the rows that events report and add them as payloads; keep the order and other kinds of rows.

    Returns the given list itself if no event lacks its row. Rows of 500 sets are read at a time.

    Raises
    ------
    DamagedRow
        The row of an event is lost, or one does not match its checksum.
    """
    reporting = [event for event in reports if isinstance(event, EventRow) and lacks_row(event)]
    payloads: dict[Key, Payload] = {}
    for kind in dict.fromkeys(ROW_OF_EVENT[event.kind] for event in reporting):
        of_kind = [event for event in reporting if ROW_OF_EVENT[event.kind] is kind]
        positions = sorted({event.position for event in of_kind if event.position is not None})
        indices = sorted({event.set_index for event in of_kind if event.set_index is not None})
        for start in range(0, len(indices), _SETS_AT_ONCE):
            some = indices[start : start + _SETS_AT_ONCE]
            statement = _OF_SOME_SETS[kind].params(positions=positions, indices=some)
            for stored in read_values(connection, kind, statement):
                payload = _to_payload_columns(dict(zip(kind.__slots__, stored, strict=False)))
                set_key = SetKey(payload["set_index"], payload.get("unscheduled_index", 0))
                # A corrupt entry of the partial index of sets can lead to the row of a single shot.
                if payload.get("shot_index") is None:
                    payloads[kind, payload.get("position"), set_key] = payload
    reports = join_rows(reports, payloads) if reporting else reports
    for event in reports:
        if isinstance(event, EventRow) and lacks_row(event):
            raise DamagedRow(_describe_lost_row(event.id, ROW_OF_EVENT[event.kind]))
    return reports


def select_rows(kind: type[Row]) -> sa.Select[Any]:
    """Build the query for all rows of a kind; of features, only rows of sets, which alone events report."""
    table = TABLES[kind]
    statement = sa.select(table)
    return statement.where(table.c.shot_index.is_(None)) if kind is FeatureRow else statement


def _build_some_rows_query(kind: type[Row]) -> sa.Select[Any]:
    """Build the query for rows of sets by parameters ``indices`` and (if in the table) ``positions``."""
    table = TABLES[kind]
    statement = select_rows(kind).where(table.c.set_index.in_(sa.bindparam("indices", expanding=True)))
    if "position" in table.c:
        return statement.where(table.c.position.in_(sa.bindparam("positions", expanding=True)))
    return statement


_OF_SOME_SETS = {kind: _build_some_rows_query(kind) for kind in ROW_OF_EVENT.values()}


def find_events_without_row(connection: sa.Connection) -> Iterator[tuple[int, str]]:
    """Yield id and description of each event without payload whose row is missing, kind by kind."""
    for event_kind, kind in ROW_OF_EVENT.items():
        table = TABLES[kind]
        names = [name for name in ("position", *SetKey._fields) if name in table.c]
        of_event = [table.c[name] == events.c[name] for name in names]
        row = select_rows(kind).where(*of_event).correlate(events)
        statement = sa.select(events.c.id).where(
            events.c.kind == event_kind, events.c.payload == {}, ~row.exists()
        )
        for (event_id,) in connection.execute(statement):
            yield event_id, _describe_lost_row(event_id, kind)


def _describe_lost_row(event_id: int | None, kind: type[Row]) -> str:
    """Format the message that the row of an event is missing, with both tables."""
    return f"row {event_id} of table {events.name} lacks its row of table {TABLES[kind].name}"


def _is_payload_of_row(payload: Payload, columns: Payload) -> bool:
    """Return whether a row has all values of a payload, as stored; that of an earlier version has fewer."""
    part = {name: columns[name] for name in payload if name in columns}
    return part == payload or _to_stored_form(part) == _to_stored_form(payload)


def _to_stored_form(payload: Payload) -> object:
    """Convert a payload to the form in which it is read: numbers that are not finite become null."""
    return orjson.loads(to_json_text(payload))


def _build_event_key(event: EventRow) -> Key:
    """Build the key of the row that an event reports: kind of row, position and key of the set.

    Of an event that reports no row, the kind is `EventRow`.
    """
    return ROW_OF_EVENT.get(event.kind, EventRow), event.position, event.set_key


def _build_row_key(row: Any) -> Key:
    """Build the key of a row of a set, equal to that of `_build_event_key` for the event that reports it."""
    return type(row), getattr(row, "position", None), getattr(row, "set_key", SetKey(row.set_index))
