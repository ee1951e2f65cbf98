"""Connections to the catalogue's file: how they are set, and SQL's errors in our words."""

from __future__ import annotations

import math
import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

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
"""How long a writer waits for another one; a set's commit takes milliseconds."""
LOCKED_FOR_S = 60.0
"""After a writer has waited in vain it asks without waiting for so long, or until it gets the lock: what one
set has to store goes in several transactions, and together they wait once."""
IN_THE_MAKING_S = 0.25
"""A catalogue in the making looks damaged to a reader for some milliseconds; a damaged one does for ever."""

REMEDY = "`solimon rebuild` makes it again from sets, journal and history, and keeps this one beside it"


def json_text(value: Any) -> str:
    """JSON of a column: NumPy's numbers are taken, NaN and infinities become null."""
    return orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY).decode()


def make_engine(path: Path, *, writable: bool, durable: bool = True) -> Engine:
    """Engine on an existing or (writable) new file; one that is not durable waits for no disk.

    A transaction of `Engine.begin` sees a single state of the file from its first to its last
    query; one that changes something is begun by `writing`.
    """
    mode = "rwc" if writable else "ro"

    def connect() -> sqlite3.Connection:
        nonlocal mode
        for_ever = "&immutable=1" if not writable and _cannot_change(path) else ""
        uri = f"{path.absolute().as_uri()}?mode={mode}{for_ever}"
        connection = sqlite3.connect(
            uri, uri=True, timeout=BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False
        )
        try:
            if writable:
                connection.execute("PRAGMA journal_mode = WAL")
                # With NORMAL a power cut takes the last commits along although they were acknowledged.
                connection.execute(f"PRAGMA synchronous = {'FULL' if durable else 'OFF'}")
            connection.execute("PRAGMA foreign_keys = ON")
            # Opens every file: a writer whose file is held for a moment could only read from then on.
            connection.execute("BEGIN IMMEDIATE" if writable else "BEGIN")
            connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
            if writable:
                # A file that cannot be opened for writing is opened for reading, which is told only here.
                connection.execute("PRAGMA user_version = 0")
            connection.execute("ROLLBACK")
        except BaseException:
            connection.close()
            raise
        # Made once only: where the file is gone later, an empty one in its place would be another test's.
        mode = "rw" if writable else "ro"
        return connection

    def connected() -> sqlite3.Connection:
        if writable:
            return connect()
        return patiently(connect, is_refusal=_is_in_the_making, patience_s=IN_THE_MAKING_S)

    waited_in_vain_s = -math.inf

    # The pool is named because a URL without a file stands for a database in memory, whose pool
    # closes the connections of other threads while they use them.
    engine = create_engine(
        "sqlite+pysqlite://",
        creator=lambda: patiently(
            connected, is_refusal=lambda e: _is_held(e) and path.parent.is_dir(), report_after_s=0.0
        ),
        poolclass=QueuePool,
        max_overflow=-1,
        json_serializer=json_text,
        json_deserializer=orjson.loads,
    )

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        nonlocal waited_in_vain_s
        if not connection.get_execution_options().get(_WRITES, False):
            connection.exec_driver_sql("BEGIN")
            return
        # Two writers wait for each other at the start; later it would be too late to wait.
        wait_s = 0.0 if time.monotonic() < waited_in_vain_s + LOCKED_FOR_S else BUSY_TIMEOUT_S
        connection.exec_driver_sql(f"PRAGMA busy_timeout = {round(1e3 * wait_s)}")
        try:
            connection.exec_driver_sql("BEGIN IMMEDIATE")
        except OperationalError:
            waited_in_vain_s = time.monotonic() if wait_s else waited_in_vain_s
            raise
        waited_in_vain_s = -math.inf

    return engine


@lru_cache(maxsize=8)
def reading_engine(path: Path) -> Engine:
    """Engine that only reads; who opens the file again finds the statements compiled."""
    return make_engine(path, writable=False)


def _cannot_change(path: Path) -> bool:
    """Tell whether the file lies on a volume that is mounted read-only, and nobody has it open elsewhere.

    Readers of a log make files beside it, which they cannot there.
    """
    if not hasattr(os, "statvfs") or path.with_name(f"{path.name}-wal").exists():
        return False
    return path.is_file() and bool(os.statvfs(path).f_flag & os.ST_RDONLY)


def _is_in_the_making(error: Exception) -> bool:
    """Tell whether SQLite finds pages at odds: so does a reader for a moment while they are made."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_CORRUPT


def _is_held(error: Exception) -> bool:
    """Tell whether SQLite says that one of its files cannot be opened, written or removed now."""
    code = getattr(error, "sqlite_errorcode", 0)
    held = (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM)
    return code & 0xFF in held or code in (sqlite3.SQLITE_IOERR_DELETE, sqlite3.SQLITE_IOERR_ACCESS)


@contextmanager
def writing(engine: Engine) -> Iterator[Connection]:
    """Transaction that holds the write lock from its beginning: all is stored, or nothing."""
    with engine.execution_options(**{_WRITES: True}).begin() as connection:
        yield connection


@contextmanager
def translated(path: Path, doing: str) -> Iterator[None]:
    """Raise errors of SQL again as errors of the catalogue.

    Raises
    ------
    CatalogueError
        With the file, what was being done and the remedy.
    """
    try:
        yield
    except (DamagedRow, UnicodeDecodeError) as error:  # SQLite may tell of a damaged name, which is no text
        raise CatalogueDamagedError(f"{path}: {doing} failed: {error}; {REMEDY}") from error
    except DBAPIError as error:
        raise _translate(path, doing, error.orig) from error
    except SQLAlchemyError as error:
        raise CatalogueError(f"{path}: {doing} failed: {error}") from error


def _translate(path: Path, doing: str, error: BaseException | None) -> CatalogueError:
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    told = f"{path}: {doing} failed: {error}"
    if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return CatalogueBusyError(f"{told} for {BUSY_TIMEOUT_S:g} s; end the program that holds it")
    # Our queries are always the same: what they ask for is gone, or is no text, in a damaged file only.
    if code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR, 0):
        return CatalogueDamagedError(f"{told}; {REMEDY}")
    if code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
        return CatalogueWriteError(f"{told}; nothing of it was stored: free or mend the disk")
    if code in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM):
        return CatalogueWriteError(f"{told}; give this user the right to write the folder")
    if code == sqlite3.SQLITE_CONSTRAINT:
        return CatalogueConflictError(
            f"{told}; nothing of it was stored: such a row exists, or lacks what it belongs to"
        )
    return CatalogueError(told)
