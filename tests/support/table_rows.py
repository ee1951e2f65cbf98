"""Every row of a catalogue as stored in its file, checksums included."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.tables import metadata

Rows = dict[str, list[tuple[Any, ...]]]


def table_rows(folder: Path, *tables: str) -> Rows:
    """Return rows of these tables, of every one if none is named, in the order of their ids."""
    with closing(sqlite3.connect(folder / FILE_NAME)) as database:
        database.text_factory = lambda text: text.decode(errors="surrogateescape")  # damage may be no text
        return {
            name: database.execute(f"SELECT * FROM {name} ORDER BY 1").fetchall()
            for name in tables or metadata.tables
        }


def forget_states(folder: Path) -> None:
    """Delete the states of assessors, as in a folder of a version that stored none."""
    with closing(sqlite3.connect(folder / FILE_NAME)) as database, database:
        database.execute("DELETE FROM assessor_states")


def lose_catalogue(folder: Path, *others: str) -> None:
    """Remove the catalogue with the files of SQLite, and other files."""
    for path in (*folder.glob("catalogue*.sqlite*"), *(folder / name for name in others)):
        path.unlink(missing_ok=True)


def execute(folder: Path, sql: str) -> list[tuple[Any, ...]]:
    """Execute a statement on a catalogue behind the back of its writer; return its rows."""
    with closing(sqlite3.connect(folder / FILE_NAME)) as database, database:
        return database.execute(sql).fetchall()
