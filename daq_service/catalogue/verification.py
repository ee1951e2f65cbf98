"""Read a catalogue of any revision without changing a file of its folder."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Mapping
from contextlib import ExitStack, closing
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

from sqlalchemy import NullPool, create_engine

from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.corruption import UNREADABLE, CatalogueCorruption, find_corruption
from daq_service.catalogue.earlier_names import EVENT_KINDS, TOPICS, to_current_row
from daq_service.catalogue.errors import (
    BUSY_TIMEOUT_S,
    CatalogueDamagedError,
    CatalogueError,
    CatalogueWriteError,
    NoDataYetError,
)
from daq_service.catalogue.migrations import SCHEMA_REVISION
from daq_service.catalogue.rows import EventRow
from daq_service.catalogue.tables import metadata, trend_blocks
from daq_service.catalogue.trends import find_trend_differences
from daq_service.shared_file import remove_quietly
from hardware_drivers.measurement import SetKey

_EARLIER_TABLES = {name: earlier for earlier, name in TOPICS.items()}


class UnchangedCatalogue:
    """Read access to the rows of a catalogue of any revision: column names to values.

     A normal reader of a closed catalogue creates two files next to it. This one creates none: it reads an
    idle file as immutable, and a file that a power cut left with its log in a copy.

    Raises
    ------
    NoDataYetError
        There is no catalogue.
    CatalogueDamagedError
         It cannot be read; all methods but `troubles` raise it, too.
    """

    def __init__(self, folder: Path) -> None:
        """Open the catalogue of a folder for reading; raise NoDataYetError if there is none."""
        self._path = folder / FILE_NAME
        if not self._path.is_file():
            raise NoDataYetError(f"{self._path}: there is no catalogue")
        self._stack = ExitStack()
        self._connect()

    def __enter__(self) -> Self:
        """Return the catalogue itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the connection and delete the copy of the file, if there is one."""
        self._stack.close()

    def _connect(self) -> None:
        """Connect to the file: immutable if idle, read-only if in use, to a copy if a log is left.

        Closes the earlier connection and deletes its copy. Raises OSError if the file cannot be copied.
        """
        self._stack.close()
        path, log = self._path, self._build_companion_path("-wal")
        self._shared = self._build_companion_path("-shm").exists()
        if not self._shared and log.exists() and log.stat().st_size:
            copies = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="solimon-")))
            for source in (path, log):
                shutil.copy(source, copies)
            path = copies / FILE_NAME
        mode = "mode=rw" if path != self._path else "mode=ro" if self._shared else "mode=ro&immutable=1"
        self._uri = f"{path.absolute().as_uri()}?{mode}"
        self._connection = sqlite3.connect(self._uri, uri=True, timeout=BUSY_TIMEOUT_S, isolation_level=None)
        self._stack.callback(self._connection.close)
        self._connection.row_factory = sqlite3.Row

    def _build_companion_path(self, suffix: str) -> Path:
        """Return the path of SQLite's log (``-wal``) or index (``-shm``) of the file; it may be missing."""
        return self._path.with_name(f"{FILE_NAME}{suffix}")

    def _run_query(self, sql: str, *values: Any) -> list[dict[str, Any]]:
        """Run a query with ``values`` for its marks and return its rows as dictionaries.

        Connects again if a recorder has started. Raises CatalogueDamagedError if the file cannot be read.
        """
        if not self._shared and self._build_companion_path("-shm").exists():
            self._connect()  # a recorder has started: from now on the file changes
        try:
            return [dict(row) for row in self._connection.execute(sql, values)]
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:  # the latter of a name of the schema
            if not self._shared and self._build_companion_path("-shm").exists():
                return self._run_query(sql, *values)  # it was idle when opened and changed while it was read
            raise CatalogueDamagedError(f"{self._path} cannot be read: {error}") from error

    def _read_values(self, sql: str) -> list[Any]:
        """Run a query with one column and return its values; CatalogueDamagedError if unreadable."""
        return [value for row in self._run_query(sql) for value in row.values()]

    def troubles(self) -> list[CatalogueCorruption]:
        """List corrupt pages, indices and rows; if there are none, the trend blocks that differ.

        Errors on reading are listed, not raised; an earlier revision has no checksums of rows to compare.
        """
        shared = self._shared
        opened = partial(sqlite3.connect, self._uri, uri=True, timeout=BUSY_TIMEOUT_S)
        engine = create_engine("sqlite://", creator=opened, poolclass=NullPool)
        try:
            revision = self._read_values("SELECT version_num FROM alembic_version")
            with engine.connect() as connection:
                current = revision == [SCHEMA_REVISION]
                corruption = list(find_corruption(connection, rows=current))
                if current and not corruption:
                    connection.exec_driver_sql(
                        "BEGIN"
                    )  # rows and blocks of one state while a recorder writes
                    differing = find_trend_differences(connection)
                    corruption = [
                        CatalogueCorruption(table=trend_blocks.name, description=difference)
                        for difference in differing
                    ]
        except (*UNREADABLE, CatalogueDamagedError) as error:
            corruption = [CatalogueCorruption(description=f"{self._path} cannot be read: {error}")]
        finally:
            engine.dispose()
        if corruption and not shared and self._build_companion_path("-shm").exists():
            self._connect()
            return self.troubles()  # it started to change during this check
        return corruption

    def copy_to(self, target: Path) -> None:
        """Copy one state of the catalogue, complete and without log files, to ``target``, which is replaced.

        A reader of the copy creates no log files either, and a concurrent writer does not wait. After an
        error no copy is left.

        Raises
        ------
        CatalogueDamagedError
             The copy is corrupt, or the catalogue cannot be read.
        CatalogueWriteError
             The disk refuses.
        """
        try:
            self._copy_and_check(target)
        except CatalogueError:
            remove_quietly(target)
            raise

    def _copy_and_check(self, target: Path) -> None:
        """Replace a file by a copy of the catalogue and check the copy's pages.

        Raises CatalogueWriteError or CatalogueDamagedError; the incomplete copy stays.
        """
        remove_quietly(target)
        try:
            with closing(sqlite3.connect(target, isolation_level=None)) as copy:
                self._connection.backup(copy)
                copy.execute("PRAGMA journal_mode = DELETE")
                results = [str(row[0]) for row in copy.execute("PRAGMA integrity_check")]
        except sqlite3.OperationalError as error:
            raise CatalogueWriteError(
                f"{target} cannot be written: {error}; free disk space, or repair the disk"
            ) from error
        except sqlite3.DatabaseError as error:
            raise CatalogueDamagedError(f"{self._path} cannot be read: {error}") from error
        if results != ["ok"]:
            raise CatalogueDamagedError(
                f"{self._path} is damaged: {results[0]}; run solimon verify for details"
            )

    def n_rows(self) -> int:
        """Count the rows of all tables except SQLite's own; CatalogueDamagedError if unreadable."""
        return sum(self._read_values(f'SELECT count(*) FROM "{table}"')[0] for table in self._list_tables())

    def _list_tables(self) -> list[str]:
        """List the names of the tables in the file, without SQLite's own.

        Raises CatalogueDamagedError if the file is unreadable.
        """
        return self._read_values(
            "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%'"
        )

    def experiment(self) -> dict[str, Any] | None:
        """Read the row of the experiment with current column names; None if the test has not started."""
        return next(iter(self._read_rows("experiment", "")), None)

    def read_events_after(self, last_id: int) -> list[dict[str, Any]]:
        """Read id, kind (as stored) and ``wall_utc_ns`` of the events after an id, by id."""
        return self._run_query("SELECT id, kind, wall_utc_ns FROM events WHERE id > ? ORDER BY id", last_id)

    def has_event(self, event: EventRow) -> bool:
        """Return whether an event of the history is stored with its id, time and kind; True if unreadable."""
        statement = "SELECT kind FROM events WHERE id = ? AND wall_utc_ns = ?"
        try:
            rows = self._run_query(statement, event.id, event.wall_utc_ns)
            return any(EVENT_KINDS.get(row["kind"], row["kind"]) == event.kind for row in rows)
        except CatalogueDamagedError:
            return True

    def list_set_keys(self) -> set[SetKey]:
        """List the keys of the sets that have rows; leave out values that are no integers (corrupt pages)."""
        rows = self._run_query(f"SELECT DISTINCT {self._key_columns} FROM sets")
        return {_build_set_key(row) for row in rows if all(isinstance(value, int) for value in row.values())}

    def files(self) -> dict[SetKey, str]:
        """Return the file of each set that has one, by set key in order."""
        rows = self._run_query(f"SELECT DISTINCT {self._key_columns}, file FROM sets WHERE file IS NOT NULL")
        return dict(sorted((_build_set_key(row), row["file"]) for row in rows))

    @cached_property
    def _has_unscheduled_index(self) -> bool:
        """Return whether table ``sets`` has a column for unscheduled sets, as since revision 0016."""
        return "unscheduled_index" in self._read_values("SELECT name FROM pragma_table_info('sets')")

    @property
    def _key_columns(self) -> str:
        """Return the SQL columns of a set's key, with 0 as unscheduled index before revision 0016."""
        return f"set_index, {'' if self._has_unscheduled_index else '0 AS '}unscheduled_index"

    @cached_property
    def _positions(self) -> list[str]:
        """Return the distinct positions that have sets; read once."""
        return self._read_values("SELECT DISTINCT position FROM sets")

    def of_set(self, table: str, set_key: SetKey) -> list[dict[str, Any]]:
        """Read the rows of a set in a table with position and set index, with current names; empty if none.

        Raises CatalogueDamagedError if the file is unreadable or has an unknown column.
        """
        # Its indexes begin with the position.
        marks = ", ".join("?" * len(self._positions))
        where = f"WHERE position IN ({marks}) AND set_index = ?"
        if not self._has_unscheduled_index:
            return self._read_rows(table, where, *self._positions, set_key.number)
        return self._read_rows(table, f"{where} AND unscheduled_index = ?", *self._positions, *set_key)

    def _read_rows(self, table: str, where: str, *values: Any) -> list[dict[str, Any]]:
        """Read rows of a table as dictionaries with current column names; an earlier revision lacks some.

        ``where`` is an SQL clause with ``values`` for its marks, or empty. Raises CatalogueDamagedError if
        the file is unreadable or has an unknown column.
        """
        name = table if table in self._list_tables() else _EARLIER_TABLES.get(table, table)
        rows = [
            to_current_row(table, row) for row in self._run_query(f"SELECT * FROM {name} {where}", *values)
        ]
        if rows and (unknown := rows[0].keys() - set(metadata.tables[table].columns.keys())):
            message = f"{self._path}: {table} has columns that no version has: {', '.join(sorted(unknown))}"
            raise CatalogueDamagedError(message)
        return rows

    def list_stray_shots(self) -> list[int]:
        """List the ids (`sequence`) of shots without a row in ``sets`` of their set and position."""
        same = "sets.position = shots.position AND sets.set_index = shots.set_index"
        if self._has_unscheduled_index:
            same += " AND sets.unscheduled_index = shots.unscheduled_index"
        return self._read_values(
            f"SELECT sequence FROM shots WHERE NOT EXISTS (SELECT 1 FROM sets WHERE {same})"
        )


def _build_set_key(row: Mapping[str, Any]) -> SetKey:
    """Build the key of a set from a row; up to revision 0015 it is one number."""
    set_index, unscheduled_index = row["set_index"], row["unscheduled_index"]
    return SetKey(set_index, unscheduled_index) if unscheduled_index else SetKey.from_number(set_index)
