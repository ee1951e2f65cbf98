"""Connect to the catalogue's file."""

from __future__ import annotations

import os
import sqlite3
from functools import lru_cache
from pathlib import Path

import orjson
from sqlalchemy import Engine, create_engine
from sqlalchemy.pool import QueuePool

from daq_service.catalogue import errors
from daq_service.catalogue.stored_rows import configure_transactions, to_json_text
from daq_service.shared_file import retry

FILE_NAME = "catalogue.sqlite"
CREATION_S = 0.25
"""A catalogue that is being created looks corrupt to a reader for some milliseconds."""


def create_sqlite_engine(path: Path, *, writable: bool, durable: bool = True) -> Engine:
    """Create an SQLAlchemy engine for the catalogue file; it connects on first use.

    ``writable`` True creates a missing file on the first connection, False opens it read-only. ``durable``
    False never syncs to disk. While SQLite cannot open one of its files, a connection retries and blocks,
    with a warning in the log; its last error is raised. Within one transaction all queries see the same state
    of the file; start a transaction that changes something with `begin_write`.
    """
    mode = "rwc" if writable else "ro"

    def connect() -> sqlite3.Connection:
        """Open a SQLite connection, set its pragmas and probe the file; close it again if that fails.

        Raises sqlite3.Error; OperationalError after 5 s if another writer holds the lock. Only the first
        connection of a writer creates the file.
        """
        nonlocal mode
        immutable = "&immutable=1" if not writable and _can_open_immutable(path) else ""
        uri = f"{path.absolute().as_uri()}?mode={mode}{immutable}"
        connection = sqlite3.connect(
            uri, uri=True, timeout=errors.BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False
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

    def connect_with_retry() -> sqlite3.Connection:
        """Open a connection; for a reader retry up to 0.25 s while the file is being created, then raise."""
        if writable:
            return connect()
        return retry(connect, is_refusal=_is_corruption_error, patience_s=CREATION_S)

    # The pool is given because a URL without a file means a database in memory, whose pool
    # closes the connections of other threads while they use them.
    engine = create_engine(
        "sqlite+pysqlite://",
        creator=lambda: retry(
            connect_with_retry,
            is_refusal=lambda error: _is_file_access_error(error) and path.parent.is_dir(),
            report_after_s=0.0,
        ),
        poolclass=QueuePool,
        max_overflow=-1,
        json_serializer=to_json_text,
        json_deserializer=orjson.loads,
    )

    configure_transactions(engine)
    return engine


@lru_cache(maxsize=8)
def create_reading_engine(path: Path) -> Engine:
    """Return the read-only engine of a file; the 8 last used are cached with their compiled statements."""
    return create_sqlite_engine(path, writable=False)


def _can_open_immutable(path: Path) -> bool:
    """Return whether the file is on a read-only volume and has no write-ahead log; False on Windows.

    Readers of a write-ahead log create files next to it, which is impossible there.
    """
    if not hasattr(os, "statvfs") or path.with_name(f"{path.name}-wal").exists():
        return False
    return path.is_file() and bool(os.statvfs(path).f_flag & os.ST_RDONLY)


def _is_corruption_error(error: Exception) -> bool:
    """Return whether an error has the code SQLITE_CORRUPT, which also occurs while a file is created."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_CORRUPT


def _is_file_access_error(error: Exception) -> bool:
    """Return whether an error means that SQLite cannot open, write or remove one of its files at present."""
    code = getattr(error, "sqlite_errorcode", 0)
    codes = (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM)
    return code & 0xFF in codes or code in (sqlite3.SQLITE_IOERR_DELETE, sqlite3.SQLITE_IOERR_ACCESS)
