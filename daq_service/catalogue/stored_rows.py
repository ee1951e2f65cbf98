"""Store rows in transactions, with a checksum that every read access compares.

The checksum covers the values of the row's dataclass, id included, except None and the zero of a scheduled
set (`_SCHEDULED`): such a new column does not change the checksum of older rows. A migration that changes
anything else sets `ROW_CRC32` to NULL, and `seal_unsealed` computes it again.
"""

from __future__ import annotations

import math
import sqlite3
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np
import orjson
from sqlalchemy import Connection, Engine, Select, bindparam, event, select, update
from sqlalchemy.exc import DBAPIError, OperationalError, SQLAlchemyError

from daq_service.catalogue.errors import (
    CatalogueBusyError,
    CatalogueConflictError,
    CatalogueDamagedError,
    CatalogueError,
    CatalogueWriteError,
)
from daq_service.catalogue.rows import Column, Row, columns_of
from daq_service.catalogue.tables import KINDS, ROW_CRC32, TABLES

R = TypeVar("R", bound=Row)

_AS_READ: Mapping[object, Callable[[Any], Any]] = {
    # SQLite does not store negative zero, and returns an integer in a REAL column as a float.
    float: lambda value: float(value) + 0.0,
    int: int,
    bool: bool,
    bytes: zlib.crc32,  # JSON has no bytes
}


def _reading_of(column: Column) -> Callable[[Any], Any] | None:
    """Return the conversion of a column's values before the checksum."""
    alternatives = get_args(column.type) if column.nullable else (column.type,)
    return next((_AS_READ[of_type] for of_type in alternatives if of_type in _AS_READ), None)


_COLUMNS = {kind: [(column.name, _reading_of(column)) for column in columns_of(kind)] for kind in KINDS}
_BYTES = {kind: [name for name, read in columns if read is zlib.crc32] for kind, columns in _COLUMNS.items()}
_SCHEDULED = ("unscheduled_index", "raised_unscheduled_index")
_PLAIN = {str, int, bool, type(None)}
_WRITES = "solimon_writes"
BUSY_TIMEOUT_S = 5.0
"""Wait of a writer for another one; a set's commit takes milliseconds."""
LOCKED_FOR_S = 60.0
"""After a timeout a writer does not wait for this time, or until it gets the lock: the transactions of one
set wait only once together."""
REMEDY = "`solimon rebuild` makes it again from sets, journal and history, and keeps this one beside it"
_ROWS_AT_ONCE = 256
"""Rows per fetch: one by one takes an eighth longer."""


class DamagedRow(Exception):  # noqa: N818 - an error once the file is known (`translated`)
    """A row does not match its checksum."""


def plain(value: Any) -> Any:
    """Return a scalar as Python's own type; NaN and infinities become None."""
    if type(value) in _PLAIN:  # nearly every value
        return value
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def row_crc32(row: Row) -> int:
    """Compute the CRC-32 of a row, the same before it is stored and after it is read."""
    return int(storable(row)[ROW_CRC32])


def storable(row: Row) -> dict[str, Any]:
    """Return the stored form of a row with id and checksum: NaN and infinities are NULL."""
    stored = {name: plain(getattr(row, name)) for name in row.__slots__}
    columns = {}
    for name, as_read in _COLUMNS[type(row)]:
        value = stored[name]
        if value is not None:
            columns[name] = value if as_read is None else as_read(value)
    _drop_zeros(columns)
    return {**stored, ROW_CRC32: zlib.crc32(orjson.dumps(columns, option=orjson.OPT_SERIALIZE_NUMPY))}


def _drop_zeros(columns: dict[str, object]) -> None:
    """Remove the columns that have no part in the checksum of a scheduled set's row."""
    for name in _SCHEDULED:
        if columns.get(name) == 0:
            del columns[name]


def numbered(connection: Connection, rows: Sequence[R]) -> list[R]:
    """Assign ids to rows, since the checksum covers them; the caller holds the write lock."""
    if not any(getattr(row, "id", 0) is None for row in rows):
        return list(rows)
    table = TABLES[type(rows[0])]
    newest = connection.exec_driver_sql(f"select max(id) from {table.name}")
    next_id = int(newest.scalar_one() or 0) + 1
    numbered_rows = []
    for row in rows:
        if row.id is not None:  # type: ignore[attr-defined] # only kinds of rows with an id come here
            numbered_rows.append(row)
        else:
            numbered_rows.append(replace(row, id=next_id))  # type: ignore[type-var] # every kind of row is a dataclass
        next_id = max(next_id, numbered_rows[-1].id + 1)  # type: ignore[attr-defined]
    return numbered_rows


def _row_of(kind: type[R], stored: Sequence[Any]) -> R:
    """Return the dataclass of stored values."""
    return kind(**dict(zip(kind.__slots__, stored, strict=False)))  # the checksum is no part of it


def _check_checksum(kind: type[Row], stored: Sequence[Any]) -> None:
    """Raise DamagedRow if stored values do not match their checksum."""
    columns = {name: value for name, value in zip(kind.__slots__, stored, strict=False) if value is not None}
    _drop_zeros(columns)
    try:
        for name in _BYTES[kind]:
            if name in columns:
                columns[name] = zlib.crc32(columns[name])
        crc32: int | None = zlib.crc32(orjson.dumps(columns))
    except (TypeError, ValueError, OverflowError):  # text where bytes were, or no UTF-8
        crc32 = None
    if crc32 is None or crc32 != stored[-1]:
        raise DamagedRow(f"row {stored[0]} of table {TABLES[kind].name} is not what was stored")


def checked(kind: type[R], stored: Sequence[Any]) -> R:
    """Return a row of a table after a comparison with its checksum.

    Parameters
    ----------
    stored
        Every column of the table, the checksum last.

    Raises
    ------
    DamagedRow
         It does not match its checksum; contains table and id.
    """
    _check_checksum(kind, stored)
    return _row_of(kind, stored)


def checked_rows(connection: Connection, kind: type[R], statement: Select[Any]) -> Iterator[R]:
    """Return the complete rows of a query, each compared with its checksum.

    Raises
    ------
    DamagedRow
         A row does not match its checksum, or a value has the wrong type.
    """
    return (_row_of(kind, stored) for stored in checked_values(connection, kind, statement))


def checked_values(
    connection: Connection, kind: type[Row], statement: Select[Any]
) -> Iterator[Sequence[Any]]:
    """Yield the values of complete rows: every column of the table, the checksum last."""
    try:
        for rows in connection.execute(
            statement, execution_options={"yield_per": _ROWS_AT_ONCE}
        ).partitions():
            for stored in rows:
                _check_checksum(kind, stored)
                yield stored
    except (TypeError, ValueError, OverflowError) as error:  # no JSON, no truth value, no UTF-8
        raise DamagedRow(f"a row of table {TABLES[kind].name} is not what was stored: {error}") from error


def seal_unsealed(connection: Connection) -> None:
    """Compute the checksums of rows without one."""
    for kind in KINDS:
        table = TABLES[kind]
        key = table.primary_key.columns[0]
        columns = [table.c[name] for name in kind.__slots__]
        rows_without: Iterable[Any] = connection.execute(select(*columns).where(table.c[ROW_CRC32].is_(None)))
        rows = (kind(**dict(zip(kind.__slots__, stored, strict=True))) for stored in rows_without)
        checksums = [{"its_key": getattr(row, key.name), "its_crc32": row_crc32(row)} for row in rows]
        if checksums:
            statement = update(table).where(key == bindparam("its_key"))
            connection.execute(statement.values({ROW_CRC32: bindparam("its_crc32")}), checksums)


# Transactions ---------------------------------------------------------------------------------------


def json_text(value: object) -> str:
    """Return the JSON text of a column: NumPy numbers are accepted, NaN and infinities become null."""
    return orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY).decode()


def begin_transactions(engine: Engine) -> None:
    """Begin each transaction of an engine with SQLite's lock for it: none for reading, that of `writing`."""
    timed_out_s = -math.inf

    @event.listens_for(engine, "begin")
    def _begin_transaction(connection: Connection) -> None:
        nonlocal timed_out_s
        if not connection.get_execution_options().get(_WRITES, False):
            connection.exec_driver_sql("BEGIN")
            return
        # Writers wait for each other at the start of a transaction; SQLite cannot wait later.
        wait_s = 0.0 if time.monotonic() < timed_out_s + LOCKED_FOR_S else BUSY_TIMEOUT_S
        connection.exec_driver_sql(f"PRAGMA busy_timeout = {round(1e3 * wait_s)}")
        try:
            connection.exec_driver_sql("BEGIN IMMEDIATE")
        except OperationalError:
            timed_out_s = time.monotonic() if wait_s else timed_out_s
            raise
        timed_out_s = -math.inf


@contextmanager
def writing(engine: Engine) -> Iterator[Connection]:
    """Open a transaction that holds the write lock from its start: it stores all or nothing."""
    with engine.execution_options(**{_WRITES: True}).begin() as connection:
        yield connection


@contextmanager
def translated(path: Path, action: str) -> Iterator[None]:
    """Translate errors of SQL to errors of the catalogue.

    Raises
    ------
    CatalogueError
        Contains the file, the action and the remedy.
    """
    try:
        yield
    except (DamagedRow, UnicodeDecodeError) as error:  # SQLite may return a corrupt name that is no text
        raise CatalogueDamagedError(f"{path}: {action} failed: {error}; {REMEDY}") from error
    except DBAPIError as error:
        raise _translate(path, action, error.orig) from error
    except SQLAlchemyError as error:
        raise CatalogueError(f"{path}: {action} failed: {error}") from error


def _translate(path: Path, action: str, error: BaseException | None) -> CatalogueError:
    """Return the error of the catalogue for an error of the driver."""
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    message = f"{path}: {action} failed: {error}"
    if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return CatalogueBusyError(f"{message} for {BUSY_TIMEOUT_S:g} s; end the program that holds it")
    # The queries never change: they fail for a missing or invalid value in a corrupt file only.
    if code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR, 0):
        return CatalogueDamagedError(f"{message}; {REMEDY}")
    if code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
        return CatalogueWriteError(f"{message}; nothing of it was stored: free or mend the disk")
    if code in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM):
        return CatalogueWriteError(f"{message}; give this user the right to write the folder")
    if code == sqlite3.SQLITE_CONSTRAINT:
        return CatalogueConflictError(
            f"{message}; nothing of it was stored: such a row exists, or lacks what it belongs to"
        )
    return CatalogueError(message)
