"""Every row of a catalogue as it stands in its file, checksums included."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.tables import metadata


def table_rows(folder: Path) -> dict[str, list[tuple[Any, ...]]]:
    """Rows of every table in the order of their ids."""
    with closing(sqlite3.connect(folder / FILE_NAME)) as database:
        return {
            name: database.execute(f"SELECT * FROM {name} ORDER BY 1").fetchall() for name in metadata.tables
        }


def lose_catalogue(folder: Path, *others: str) -> None:
    """Remove the catalogue with what SQLite keeps beside it, and other files."""
    for path in (*folder.glob("catalogue*.sqlite*"), *(folder / name for name in others)):
        path.unlink(missing_ok=True)
