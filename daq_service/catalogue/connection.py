"""Connect to the catalogue's file and translate SQL errors."""

from __future__ import annotations

import math
import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

import orjson
from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.exc import DBAPIError, OperationalError, SQLAlchemyError
from sqlalchemy.pool import QueuePool

from daq_service.catalogue.errors import (
    CatalogueBusyError,
    CatalogueConflictError,
    CatalogueDamagedError,
    CatalogueError,
    CatalogueWriteError,
)
from daq_service.catalogue.row_checksum import DamagedRow
from daq_service.shared_file import patiently

FILE_NAME = "catalogue.sqlite"
_WRITES = "solimon_writes"
BUSY_TIMEOUT_S = 5.0
"""Wait of a writer for another one; a set's commit takes milliseconds."""
LOCKED_FOR_S = 60.0
"""After a timeout a writer does not wait for this time, or until it gets the lock: the transactions of one
set wait only once together."""
CREATION_S = 0.25
"""A catalogue that is being created looks corrupt to a reader for some milliseconds."""

REMEDY = "`solimon rebuild` makes it again from sets, journal and history, and keeps this one beside it"


def json_text(value: object) -> str:
    """Return the JSON text of a column: NumPy numbers are accepted, NaN and infinities become null."""
    return orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY).decode()


def make_engine(path: Path, *, writable: bool, durable: bool = True) -> Engine:
    """Create an engine for an existing or (if writable) new file; without durability it never syncs.

    A transaction of `Engine.begin` sees a single state of the file from its first to its last
    query; start one that changes something with `writing`.
    """
    mode = "rwc" if writable else "ro"

    def connect() -> sqlite3.Connection:
        nonlocal mode
        immutable = "&immutable=1" if not writable and _cannot_change(path) else ""
        uri = f"{path.absolute().as_uri()}?mode={mode}{immutable}"
        connection = sqlite3.connect(
            uri, uri=True, timeout=BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False
        )
        try:
            if writable:
                connection.execute("PRAGMA journal_mode = WAL")
                # With NORMAL a power cut loses the last commits although they were acknowledged.
                connection.execute(f"PRAGMA synchronous = {'FULL' if durable else 'OFF'}")
            connection.execute("PRAGMA foreign_keys = ON")
            # Opens every file: a writer whose file is locked for a moment could only read afterwards.
            connection.execute("BEGIN IMMEDIATE" if writable else "BEGIN")
            connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
            if writable:
                # SQLite opens a file without write permission for reading and fails only here.
                connection.execute("PRAGMA user_version = 0")
            connection.execute("ROLLBACK")
        except BaseException:
            connection.close()
            raise
        # Create it only once: if the file disappears later, a new empty one must not replace it.
        mode = "rw" if writable else "ro"
        return connection

    def connect_patiently() -> sqlite3.Connection:
        if writable:
            return connect()
        return patiently(connect, is_refusal=_is_being_created, patience_s=CREATION_S)

    timed_out_s = -math.inf

    # The pool is given because a URL without a file means a database in memory, whose pool
    # closes the connections of other threads while they use them.
    engine = create_engine(
        "sqlite+pysqlite://",
        creator=lambda: patiently(
            connect_patiently,
            is_refusal=lambda error: _is_locked(error) and path.parent.is_dir(),
            report_after_s=0.0,
        ),
        poolclass=QueuePool,
        max_overflow=-1,
        json_serializer=json_text,
        json_deserializer=orjson.loads,
    )

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

    return engine


@lru_cache(maxsize=8)
def reading_engine(path: Path) -> Engine:
    """Return a read-only engine; cached, so that its compiled statements are reused."""
    return make_engine(path, writable=False)


def _cannot_change(path: Path) -> bool:
    """Return whether the file is on a read-only volume and no process has it open elsewhere.

    Readers of a write-ahead log create files next to it, which is impossible there.
    """
    if not hasattr(os, "statvfs") or path.with_name(f"{path.name}-wal").exists():
        return False
    return path.is_file() and bool(os.statvfs(path).f_flag & os.ST_RDONLY)


def _is_being_created(error: Exception) -> bool:
    """Return whether SQLite reports corrupt pages, as it also does while a file is being created."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_CORRUPT


def _is_locked(error: Exception) -> bool:
    """Return whether SQLite cannot open, write or remove one of its files at present."""
    code = getattr(error, "sqlite_errorcode", 0)
    codes = (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM)
    return code & 0xFF in codes or code in (sqlite3.SQLITE_IOERR_DELETE, sqlite3.SQLITE_IOERR_ACCESS)


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
