"""Find corruption in a catalogue: pages, indices, rows that fail their checksum. Changes nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Connection, Table, select, text
from sqlalchemy.exc import SQLAlchemyError

from daq_service.catalogue.connection import FILE_NAME, create_sqlite_engine
from daq_service.catalogue.errors import REMEDY, CatalogueDamagedError
from daq_service.catalogue.reported_rows import find_events_without_row
from daq_service.catalogue.rows import Row
from daq_service.catalogue.stored_rows import DamagedRow, to_checked_row
from daq_service.catalogue.tables import KINDS, TABLES, events

UNREADABLE = (SQLAlchemyError, UnicodeDecodeError)
"""Errors on reading a corrupt file; SQLite may return a corrupt name that is no text."""
MAX_LISTED = 20
"""Maximum number of corrupt pages that SQLite reports."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CatalogueCorruption:
    """One corruption; ``table`` None: of the file; ``row_id`` None: of the complete table."""

    table: str | None = None
    row_id: int | None = None
    description: str

    def __str__(self) -> str:
        """Return the description."""
        return self.description


def find_catalogue_corruption(folder: Path) -> Iterator[CatalogueCorruption]:
    """Read every page and row of a catalogue of the current schema and yield its corrupt parts.

    Works while a recorder writes. A file that cannot be read at all yields one entry instead of an error.
    """
    path = folder / FILE_NAME
    engine = create_sqlite_engine(path, writable=False)
    try:
        with engine.begin() as connection:
            yield from find_corruption(connection)
    except UNREADABLE as error:
        yield CatalogueCorruption(description=f"{path} cannot be read: {_shorten(error)}")
    finally:
        engine.dispose()


def raise_if_corrupt(folder: Path) -> None:
    """Read the complete catalogue and raise an error if it is corrupt.

    Raises
    ------
    CatalogueDamagedError
         Contains the first three corrupt parts, the number of the others, and the remedy.
    """
    corruption = list(find_catalogue_corruption(folder))
    if corruption:
        suffix = f", and {len(corruption) - 3} more" if len(corruption) > 3 else ""
        description = "; ".join(map(str, corruption[:3]))
        raise CatalogueDamagedError(f"{folder / FILE_NAME} is damaged: {description}{suffix}; {REMEDY}")


def find_corruption(connection: Connection, *, rows: bool = True) -> Iterator[CatalogueCorruption]:
    """Yield corrupt pages (at most 20), broken references, corrupt rows, and events without their row.

    ``rows`` False checks only pages and references, for an earlier schema without checksums. An error on
    reading is yielded, not raised.
    """
    try:
        for (description,) in connection.execute(text(f"PRAGMA integrity_check({MAX_LISTED})")):
            if description != "ok":
                yield CatalogueCorruption(description=str(description))
        for broken in connection.execute(text("PRAGMA foreign_key_check")):
            yield CatalogueCorruption(
                table=broken[0],
                row_id=broken[1],
                description=f"row {broken[1]} of table {broken[0]} lacks its row of {broken[2]}",
            )
    except UNREADABLE as error:
        yield CatalogueCorruption(description=_shorten(error))
    if not rows:
        return
    for kind in KINDS:
        yield from _check_rows(connection, kind, TABLES[kind])
    try:
        for event_id, description in find_events_without_row(connection):
            yield CatalogueCorruption(table=events.name, row_id=event_id, description=description)
    except UNREADABLE as error:
        yield CatalogueCorruption(table=events.name, description=_shorten(error))


def _check_rows(connection: Connection, kind: type[Row], table: Table) -> Iterator[CatalogueCorruption]:
    """Yield a corruption for each row that is unreadable or fails its checksum, in the order of the key.

    A table that cannot be read, or that ends early, yields one entry and ends the check.
    """
    key = table.primary_key.columns[0]
    try:
        # One by one: a value that is not JSON must not hide the later rows.
        ids = connection.execute(select(key).order_by(key)).scalars().all()
    except (SQLAlchemyError, TypeError, ValueError) as error:
        yield CatalogueCorruption(table=table.name, description=f"table {table.name}: {_shorten(error)}")
        return
    cursor = connection.execute(select(table).order_by(key))
    for row_id in ids:
        try:
            stored = cursor.fetchone()
            if stored is None:
                yield CatalogueCorruption(
                    table=table.name, description=f"table {table.name} ends before row {row_id}"
                )
                return
            to_checked_row(kind, stored)
        except DamagedRow as error:
            yield CatalogueCorruption(table=table.name, row_id=row_id, description=str(error))
        except (SQLAlchemyError, TypeError, ValueError, OverflowError) as error:
            description = f"row {row_id} of table {table.name}: {_shorten(error)}"
            yield CatalogueCorruption(table=table.name, row_id=row_id, description=description)
            cursor = connection.execute(select(table).where(key > row_id).order_by(key))


def _shorten(error: Exception) -> str:
    """Return the first line of an error's message as text."""
    return str(error).partition("\n")[0]
