"""Rows as they are stored: plain values under an id, sealed with a checksum that every reading compares.

The checksum counts what the row's dataclass says, id included, and leaves out what is None: a column that
comes later and may be NULL changes no older row's checksum. A migration that changes anything else sets
`ROW_CRC32` to NULL, and `seal_unsealed` makes it again.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar, get_args

import numpy as np
import orjson
from sqlalchemy import Connection, Select, bindparam, func, select, update

from daq_service.catalogue.rows import Column, Row, columns_of
from daq_service.catalogue.tables import KINDS, ROW_CRC32, table_of

R = TypeVar("R", bound=Row)

_AS_READ: Mapping[Any, Callable[[Any], Any]] = {
    # SQLite keeps no negative zero, and a whole number in a column of real ones comes back as a real one.
    float: lambda value: float(value) + 0.0,
    int: int,
    bool: bool,
    bytes: zlib.crc32,  # JSON has no bytes
}


def _reading_of(column: Column) -> Callable[[Any], Any] | None:
    alternatives = get_args(column.type) if column.nullable else (column.type,)
    return next((_AS_READ[of_type] for of_type in alternatives if of_type in _AS_READ), None)


_COLUMNS = {kind: [(column.name, _reading_of(column)) for column in columns_of(kind)] for kind in KINDS}
_BYTES = {kind: [name for name, as_read in told if as_read is zlib.crc32] for kind, told in _COLUMNS.items()}


_ROWS_AT_ONCE = 256
"""Taken from the driver together: one by one costs an eighth more."""


class DamagedRow(Exception):  # noqa: N818 - an error once the file is known (`connection.translated`)
    """What a table holds is not what was stored."""


def plain(value: Any) -> Any:
    """Return a scalar as Python's own type; what is not a finite number becomes None."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def row_crc32(row: Row) -> int:
    """CRC-32 of a row, the same before it is stored and after it is read."""
    told = {}
    for name, as_read in _COLUMNS[type(row)]:
        value = plain(getattr(row, name))
        if value is not None:
            told[name] = value if as_read is None else as_read(value)
    return zlib.crc32(orjson.dumps(told, option=orjson.OPT_SERIALIZE_NUMPY))


def storable(row: Row) -> dict[str, Any]:
    """Row with its id as it is stored: NaN and infinities as NULL, its checksum beside."""
    stored = {name: plain(getattr(row, name)) for name in row.__slots__}
    return {**stored, ROW_CRC32: row_crc32(row)}


def numbered(connection: Connection, rows: Sequence[R]) -> list[R]:
    """Rows with the ids that they get, which their checksums count; the caller holds the write lock."""
    if not any(getattr(row, "id", 0) is None for row in rows):
        return list(rows)
    table = table_of(type(rows[0]))
    following = int(connection.execute(select(func.max(table.c.id))).scalar_one() or 0) + 1
    done = []
    for row in rows:
        if row.id is not None:  # type: ignore[attr-defined] # only kinds of rows with an id come here
            done.append(row)
        else:
            done.append(replace(row, id=following))  # type: ignore[type-var] # every kind of row is a dataclass
        following = max(following, done[-1].id + 1)  # type: ignore[attr-defined]
    return done


def _row_of(kind: type[R], stored: Sequence[Any]) -> R:
    return kind(**dict(zip(kind.__slots__, stored, strict=False)))  # the checksum is no part of it


def _require_seal(kind: type[Row], stored: Sequence[Any]) -> None:
    """Compare what a table gives, which is plain already, with its checksum."""
    told = {name: value for name, value in zip(kind.__slots__, stored, strict=False) if value is not None}
    try:
        for name in _BYTES[kind]:
            if name in told:
                told[name] = zlib.crc32(told[name])
        found: int | None = zlib.crc32(orjson.dumps(told))
    except (TypeError, ValueError, OverflowError):  # text where bytes were, or no UTF-8
        found = None
    if found is None or found != stored[-1]:
        raise DamagedRow(f"row {stored[0]} of table {table_of(kind).name} is not what was stored")


def checked(kind: type[R], stored: Sequence[Any]) -> R:
    """Row of a table as its dataclass.

    Parameters
    ----------
    stored
        Every column of the table, the checksum last.

    Raises
    ------
    DamagedRow
        It is not what was stored; with its table and id.
    """
    _require_seal(kind, stored)
    return _row_of(kind, stored)


def checked_rows(connection: Connection, kind: type[R], statement: Select[Any]) -> Iterator[R]:
    """Rows that a query for whole rows gives, each compared with its checksum.

    Raises
    ------
    DamagedRow
        One of them is not what was stored, or no value of its column.
    """
    return (_row_of(kind, stored) for stored in checked_values(connection, kind, statement))


def checked_values(
    connection: Connection, kind: type[Row], statement: Select[Any]
) -> Iterator[Sequence[Any]]:
    """Give what `checked_rows` makes rows of: every column of the table, the checksum last."""
    try:
        for some in connection.execute(
            statement, execution_options={"yield_per": _ROWS_AT_ONCE}
        ).partitions():
            for stored in some:
                _require_seal(kind, stored)
                yield stored
    except (TypeError, ValueError, OverflowError) as error:  # no JSON, no truth value, no UTF-8
        raise DamagedRow(f"a row of table {table_of(kind).name} is not what was stored: {error}") from error


def seal_unsealed(connection: Connection) -> None:
    """Give rows that have no checksum theirs: those from before there was one."""
    for kind in KINDS:
        table = table_of(kind)
        key = table.primary_key.columns[0]
        columns = [table.c[name] for name in kind.__slots__]
        found: Iterable[Any] = connection.execute(select(*columns).where(table.c[ROW_CRC32].is_(None)))
        kept = (kind(**dict(zip(kind.__slots__, stored, strict=True))) for stored in found)
        seals = [{"its_key": getattr(row, key.name), "its_crc32": row_crc32(row)} for row in kept]
        if seals:
            statement = update(table).where(key == bindparam("its_key"))
            connection.execute(statement.values({ROW_CRC32: bindparam("its_crc32")}), seals)
