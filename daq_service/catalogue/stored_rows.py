"""Store rows in transactions, with a checksum that every read access compares.

The checksum covers the values of the row's dataclass, id included, except None and the zero of a scheduled
set (`_SCHEDULED`): such a new column does not change the checksum of older rows. A migration that changes
anything else sets `ROW_CRC32` to NULL, and `migrations` compute it again.
"""

from __future__ import annotations

import math
import sqlite3
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeVar

import orjson
from sqlalchemy import (
    JSON,
    Boolean,
    ColumnElement,
    Connection,
    Engine,
    Float,
    Integer,
    LargeBinary,
    Select,
    String,
    bindparam,
    event,
    func,
    insert,
    select,
    update,
)
from sqlalchemy.dialects import sqlite
from sqlalchemy.exc import DBAPIError, SQLAlchemyError
from sqlalchemy.sql.elements import CompilerElement

from daq_service.catalogue import errors
from daq_service.catalogue.errors import REMEDY, CatalogueDamagedError, CatalogueError, translate_driver_error
from daq_service.catalogue.rows import Row
from daq_service.catalogue.tables import KINDS, TABLES

R = TypeVar("R", bound=Row)

_PYTHON_TYPES = {JSON: dict, Boolean: bool, LargeBinary: bytes, Float: float, Integer: int, String: str}


def _to_python_type(column: ColumnElement[Any]) -> type:
    """Return the Python type of a column: ``dict`` for any JSON; StopIteration for an unknown SQL type."""
    return next(of_type for sql, of_type in _PYTHON_TYPES.items() if isinstance(column.type, sql))


_TYPES = {kind: [(name, _to_python_type(TABLES[kind].c[name])) for name in kind.__slots__] for kind in KINDS}
"""Name and type of each column."""
_VALUES = {kind: attrgetter(*kind.__slots__) for kind in KINDS}
_BYTES = {kind: [name for name, of_type in columns if of_type is bytes] for kind, columns in _TYPES.items()}
_READ_AS = {
    kind: [
        (number, orjson.loads if of_type is dict else bool)
        for number, (_, of_type) in enumerate(columns)
        if of_type in (bool, dict)
    ]
    for kind, columns in _TYPES.items()
}
"""Conversion of the columns that SQLite returns as another type, by their number."""
_SCHEDULED = ("unscheduled_index", "raised_unscheduled_index")
_WRITES = "solimon_writes"
LOCKED_FOR_S = 60.0
"""After a timeout a writer does not wait for this time, or until it gets the lock: the transactions of one
set wait only once together."""
_ROWS_AT_ONCE = 256
"""Rows per fetch: one by one takes an eighth longer."""


class DamagedRow(Exception):  # noqa: N818 - an error once the file is known (`translate_errors`)
    """A row does not match its checksum."""


@dataclass(frozen=True, slots=True)
class Prepared:
    """A statement in the driver's words: SQLAlchemy's part of an execution is several times SQLite's own."""

    text: str
    parameters: tuple[tuple[str, object], ...]
    """Name and value of each parameter; a missing value is None."""

    def execute(self, connection: Connection, **given: object) -> sqlite3.Cursor:
        """Execute the statement in the connection's transaction; omitted parameters take their default.

        Raises sqlite3.Error.
        """
        return unwrap_sqlite(connection).execute(
            self.text, [given.get(name, value) for name, value in self.parameters]
        )


def compile_sql(statement: CompilerElement, column_keys: Sequence[str] | None = None) -> Prepared:
    """Compile a statement that is executed often to the SQL text and parameter order of the SQLite driver.

    ``column_keys`` limits an INSERT or UPDATE to these columns.
    """
    compiled = statement.compile(dialect=_DIALECT, column_keys=column_keys)
    names = compiled.positiontup or []  # type: ignore[attr-defined] # of the compiler of SQL
    return Prepared(str(compiled), tuple((name, compiled.params.get(name)) for name in names))


def unwrap_sqlite(connection: Connection) -> sqlite3.Connection:
    """Return the SQLite connection of the driver below an SQLAlchemy connection, in the same transaction."""
    return connection.connection.driver_connection  # type: ignore[return-value] # the engine is SQLite's


_DIALECT = sqlite.dialect()
_KEY = "key_of_the_row"
_INSERT = {kind: compile_sql(insert(table), list(table.columns.keys())) for kind, table in TABLES.items()}
_UPDATE = {
    kind: compile_sql(
        update(table).where(table.primary_key.columns[0] == bindparam(_KEY)), list(table.columns.keys())[1:]
    )
    for kind, table in TABLES.items()
}
_NEWEST_ID = {
    kind: compile_sql(select(func.max(table.c.id))) for kind, table in TABLES.items() if "id" in table.c
}


def compute_row_crc32(row: Row) -> int:
    """Compute the CRC-32 of a row's columns, the same before it is stored and after it is read."""
    return int(_to_driver_values(row)[-1])


def _to_driver_values(row: Row, new_id: int | None = None) -> list[Any]:
    """Convert a row to driver values in column order, the checksum last; NaN and infinities become None.

    ``new_id`` replaces a missing id.
    """
    kind = type(row)
    stored: list[Any] = []
    columns: dict[str, object] = {}
    for (name, of_type), given in zip(_TYPES[kind], _VALUES[kind](row), strict=True):
        value: Any = new_id if given is None and not stored else given
        if value is None:
            pass
        elif of_type is float:
            # SQLite does not store negative zero, and returns an integer in a REAL column as a float.
            value = float(value) + 0.0
            if math.isfinite(value):
                columns[name] = value
            else:
                value = None
        elif of_type is dict:
            value = to_json_text(value)
            columns[name] = orjson.Fragment(value)
        elif of_type is bytes:
            columns[name] = zlib.crc32(value)  # JSON has no bytes
        else:
            value = columns[name] = of_type(value)
        stored.append(value)
    stored.append(_compute_columns_crc32(columns))
    return stored


def _compute_columns_crc32(columns: dict[str, object]) -> int:
    """Compute the CRC-32 of not-None columns as JSON; delete unscheduled indices of 0 from ``columns``."""
    for name in _SCHEDULED:
        if columns.get(name) == 0:
            del columns[name]
    return zlib.crc32(orjson.dumps(columns))


def insert_rows(connection: Connection, rows: Sequence[Row]) -> list[int]:
    """Insert rows of one kind and return their ids (first columns); the caller holds the write lock.

    A row without an id gets the next one here, since the checksum covers it. Raises sqlite3.IntegrityError if
    a key exists or a referenced row is missing.
    """
    if not rows:
        return []
    kind = type(rows[0])
    next_id = 0
    if any(getattr(row, "id", 0) is None for row in rows):
        next_id = (_NEWEST_ID[kind].execute(connection).fetchone()[0] or 0) + 1
    stored = []
    for row in rows:
        stored.append(_to_driver_values(row, next_id))
        if next_id:
            next_id = max(next_id, stored[-1][0] + 1)
    unwrap_sqlite(connection).executemany(_INSERT[kind].text, stored)
    return [row[0] for row in stored]


def replace_row(connection: Connection, row: Row) -> bool:
    """Replace the stored row with the same primary key; return False, changing nothing, if there is none."""
    row_id, *stored = _to_driver_values(row)
    return unwrap_sqlite(connection).execute(_UPDATE[type(row)].text, [*stored, row_id]).rowcount == 1


def _build_row(kind: type[R], stored: Sequence[Any]) -> R:
    """Build a row's dataclass from stored values in column order, the checksum ignored, without any check."""
    return kind(**dict(zip(kind.__slots__, stored, strict=False)))  # the checksum is no part of it


def _check_checksum(kind: type[Row], stored: Sequence[Any]) -> None:
    """Raise DamagedRow if stored values differ from the checksum, their last one, or cannot be encoded."""
    columns = {name: value for name, value in zip(kind.__slots__, stored, strict=False) if value is not None}
    try:
        for name in _BYTES[kind]:
            if name in columns:
                columns[name] = zlib.crc32(columns[name])
        crc32: int | None = _compute_columns_crc32(columns)
    except (TypeError, ValueError, OverflowError):  # text where bytes were, or no UTF-8
        crc32 = None
    if crc32 is None or crc32 != stored[-1]:
        raise DamagedRow(f"row {stored[0]} of table {TABLES[kind].name} is not what was stored")


def to_checked_row(kind: type[R], stored: Sequence[Any]) -> R:
    """Compare stored values with their checksum and return the row; raise DamagedRow if they differ.

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
    return _build_row(kind, stored)


def read_rows(
    connection: Connection, kind: type[R], statement: Select[Any] | Prepared, **given: object
) -> Iterator[R]:
    """Read the complete rows of a query one after the other, each compared with its checksum.

    Parameters
    ----------
    given
        Values of the parameters of the statement.

    Raises
    ------
    DamagedRow
         On iteration: a row does not match its checksum, or a value has the wrong type.
    """
    return (_build_row(kind, stored) for stored in read_values(connection, kind, statement, **given))


def read_values(
    connection: Connection, kind: type[Row], statement: Select[Any] | Prepared, **given: object
) -> Iterator[Sequence[Any]]:
    """Yield the values of complete rows of a query, the checksum last; raise DamagedRow at a corrupt row."""
    try:
        for stored in _execute_query(connection, kind, statement, given):
            _check_checksum(kind, stored)
            yield stored
    except (TypeError, ValueError, OverflowError) as error:  # no JSON, no truth value, no UTF-8
        raise DamagedRow(f"a row of table {TABLES[kind].name} is not what was stored: {error}") from error


def _execute_query(
    connection: Connection, kind: type[Row], statement: Select[Any] | Prepared, given: dict[str, object]
) -> Iterator[Sequence[Any]]:
    """Execute a query and yield the values of its rows, with JSON and booleans converted.

    ``given`` holds the values of its parameters. Raises ValueError or TypeError at a value that is no JSON.
    """
    if isinstance(statement, Select):
        result = connection.execute(statement, given, execution_options={"yield_per": _ROWS_AT_ONCE})
        for rows in result.partitions():
            yield from rows
        return
    for found in statement.execute(connection, **given):
        stored = list(found)
        for number, read_as in _READ_AS[kind]:
            if stored[number] is not None:
                stored[number] = read_as(stored[number])
        yield stored


# Transactions ---------------------------------------------------------------------------------------


def to_json_text(value: object) -> str:
    """Serialize a value as JSON text: NumPy numbers are accepted, NaN and infinities become null."""
    return orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY).decode()


def configure_transactions(engine: Engine) -> None:
    """Make an engine start its transactions with BEGIN, those of `begin_write` with BEGIN IMMEDIATE.

    A writer blocks up to 5 s for the lock, then OperationalError; for 60 s after that it does not wait at
    all.
    """
    timed_out_s = -math.inf

    @event.listens_for(engine, "begin")
    def _begin_transaction(connection: Connection) -> None:
        """Begin a transaction; a writer waits up to 5 s for the lock, then raises OperationalError."""
        nonlocal timed_out_s
        if not connection.get_execution_options().get(_WRITES, False):
            unwrap_sqlite(connection).execute("BEGIN")
            return
        # Writers wait for each other at the start of a transaction; SQLite cannot wait later.
        wait_s = 0.0 if time.monotonic() < timed_out_s + LOCKED_FOR_S else errors.BUSY_TIMEOUT_S
        unwrap_sqlite(connection).execute(f"PRAGMA busy_timeout = {round(1e3 * wait_s)}")
        try:
            unwrap_sqlite(connection).execute("BEGIN IMMEDIATE")
        except sqlite3.OperationalError:
            timed_out_s = time.monotonic() if wait_s else timed_out_s
            raise
        timed_out_s = -math.inf


@contextmanager
def begin_write(engine: Engine) -> Iterator[Connection]:
    """Open a transaction that holds the write lock from its start; roll it back if the block raises.

    Raises OperationalError if the lock is not free in time (`configure_transactions`).
    """
    with engine.execution_options(**{_WRITES: True}).begin() as connection:
        yield connection


@contextmanager
def translate_errors(path: Path, action: str) -> Iterator[None]:
    """Translate errors of SQL inside the block to errors of the catalogue.

    Raises
    ------
    CatalogueError
        Contains the file, the action and the remedy; `CatalogueDamagedError` for a corrupt row.
    """
    try:
        yield
    except (DamagedRow, UnicodeDecodeError) as error:  # SQLite may return a corrupt name that is no text
        raise CatalogueDamagedError(f"{path}: {action} failed: {error}; {REMEDY}") from error
    except sqlite3.Error as error:
        raise translate_driver_error(path, action, error) from error
    except DBAPIError as error:
        raise translate_driver_error(path, action, error.orig) from error
    except SQLAlchemyError as error:
        raise CatalogueError(f"{path}: {action} failed: {error}") from error
