"""What is damaged in a catalogue: pages, indices, rows that are not what was stored. Changes nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Connection, Table, select, text
from sqlalchemy.exc import SQLAlchemyError

from daq_service.catalogue.connection import FILE_NAME, REMEDY, make_engine
from daq_service.catalogue.errors import CatalogueDamagedError
from daq_service.catalogue.row_checksum import DamagedRow, checked
from daq_service.catalogue.rows import Row
from daq_service.catalogue.tables import KINDS, table_of

UNREADABLE = (SQLAlchemyError, UnicodeDecodeError)
"""What reading a damaged file ends with; SQLite may tell of a damaged name, which is no text."""
MOST_LISTED = 20
"""Damages of its pages that SQLite tells at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CatalogueCorruption:
    """One of them; without ``table`` it is of the file, without ``row_id`` of the whole table."""

    table: str | None = None
    row_id: int | None = None
    told: str

    def __str__(self) -> str:
        return self.told


def catalogue_corruption(folder: Path) -> Iterator[CatalogueCorruption]:
    """Read every page and every row of a catalogue and tell what is damaged; it has today's schema.

    Works beside a recorder that writes.
    """
    path = folder / FILE_NAME
    engine = make_engine(path, writable=False)
    try:
        with engine.begin() as connection:
            yield from corruption_in(connection)
    except UNREADABLE as error:
        yield CatalogueCorruption(told=f"{path} cannot be read: {_first_line(error)}")
    finally:
        engine.dispose()


def refuse_corruption(folder: Path) -> None:
    """Let nobody go on with a catalogue in which anything is damaged.

    Raises
    ------
    CatalogueDamagedError
        What is, and the remedy.
    """
    found = list(catalogue_corruption(folder))
    if found:
        more = f", and {len(found) - 3} more" if len(found) > 3 else ""
        told = "; ".join(map(str, found[:3]))
        raise CatalogueDamagedError(f"{folder / FILE_NAME} is damaged: {told}{more}; {REMEDY}")


def corruption_in(connection: Connection, *, rows: bool = True) -> Iterator[CatalogueCorruption]:
    """Tell what is damaged in an open catalogue; ``rows`` False: an earlier schema, without checksums."""
    try:
        for (told,) in connection.execute(text(f"PRAGMA integrity_check({MOST_LISTED})")):
            if told != "ok":
                yield CatalogueCorruption(told=str(told))
        for broken in connection.execute(text("PRAGMA foreign_key_check")):
            yield CatalogueCorruption(
                table=broken[0],
                row_id=broken[1],
                told=f"row {broken[1]} of table {broken[0]} lacks its row of {broken[2]}",
            )
    except UNREADABLE as error:
        yield CatalogueCorruption(told=_first_line(error))
    for kind in KINDS if rows else ():
        yield from _damaged_rows(connection, kind, table_of(kind))


def _damaged_rows(connection: Connection, kind: type[Row], table: Table) -> Iterator[CatalogueCorruption]:
    key = table.primary_key.columns[0]
    try:
        # One by one: a value that is no JSON must not hide the rows behind it.
        ids = connection.execute(select(key).order_by(key)).scalars().all()
    except (SQLAlchemyError, TypeError, ValueError) as error:
        yield CatalogueCorruption(table=table.name, told=f"table {table.name}: {_first_line(error)}")
        return
    whole = connection.execute(select(table).order_by(key))
    for row_id in ids:
        try:
            stored = whole.fetchone()
            if stored is None:
                yield CatalogueCorruption(
                    table=table.name, told=f"table {table.name} ends before row {row_id}"
                )
                return
            checked(kind, stored)
        except DamagedRow as error:
            yield CatalogueCorruption(table=table.name, row_id=row_id, told=str(error))
        except (SQLAlchemyError, TypeError, ValueError, OverflowError) as error:
            told = f"row {row_id} of table {table.name}: {_first_line(error)}"
            yield CatalogueCorruption(table=table.name, row_id=row_id, told=told)
            whole = connection.execute(select(table).where(key > row_id).order_by(key))


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]
