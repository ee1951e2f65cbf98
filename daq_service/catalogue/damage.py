"""What is damaged in a catalogue: pages, indices, rows that are not what was stored. Changes nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Connection, Table, select, text
from sqlalchemy.exc import SQLAlchemyError

from daq_service.catalogue.connection import FILE_NAME, REMEDY, make_engine
from daq_service.catalogue.errors import CatalogueDamagedError
from daq_service.catalogue.rows import Row
from daq_service.catalogue.sealed import DamagedRow, checked
from daq_service.catalogue.tables import KINDS, table_of

UNREADABLE = (SQLAlchemyError, UnicodeDecodeError)
"""What reading a damaged file ends with; SQLite may tell of a damaged name, which is no text."""
TOLD = 20
"""Damages of its pages that SQLite tells at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CatalogueDamage:
    """One of them; without ``table`` it is of the file, without ``row_id`` of the whole table."""

    table: str | None = None
    row_id: int | None = None
    told: str

    def __str__(self) -> str:
        return self.told


def catalogue_damage(folder: Path) -> Iterator[CatalogueDamage]:
    """Read every page and every row of a catalogue and tell what is damaged; it has today's schema.

    Works beside a recorder that writes.
    """
    path = folder / FILE_NAME
    engine = make_engine(path, writable=False)
    try:
        with engine.begin() as connection:
            yield from damage_in(connection)
    except UNREADABLE as error:
        yield CatalogueDamage(told=f"{path} cannot be read: {_first_line(error)}")
    finally:
        engine.dispose()


def refuse_damage(folder: Path) -> None:
    """Let nobody go on with a catalogue in which anything is damaged.

    Raises
    ------
    CatalogueDamagedError
        What is, and the remedy.
    """
    found = list(catalogue_damage(folder))
    if found:
        more = f", and {len(found) - 3} more" if len(found) > 3 else ""
        told = "; ".join(map(str, found[:3]))
        raise CatalogueDamagedError(f"{folder / FILE_NAME} is damaged: {told}{more}; {REMEDY}")


def damage_in(connection: Connection, *, rows: bool = True) -> Iterator[CatalogueDamage]:
    """Tell what is damaged in an open catalogue; ``rows`` False: an earlier schema, without checksums."""
    try:
        for (told,) in connection.execute(text(f"PRAGMA integrity_check({TOLD})")):
            if told != "ok":
                yield CatalogueDamage(told=str(told))
        for broken in connection.execute(text("PRAGMA foreign_key_check")):
            yield CatalogueDamage(
                table=broken[0],
                row_id=broken[1],
                told=f"row {broken[1]} of table {broken[0]} lacks its row of {broken[2]}",
            )
    except UNREADABLE as error:
        yield CatalogueDamage(told=_first_line(error))
    for kind in KINDS if rows else ():
        yield from _damaged_rows(connection, kind, table_of(kind))


def _damaged_rows(connection: Connection, kind: type[Row], table: Table) -> Iterator[CatalogueDamage]:
    key = table.primary_key.columns[0]
    try:
        # One by one: a value that is no JSON must not hide the rows behind it.
        ids = connection.execute(select(key).order_by(key)).scalars().all()
    except (SQLAlchemyError, TypeError, ValueError) as error:
        yield CatalogueDamage(table=table.name, told=f"table {table.name}: {_first_line(error)}")
        return
    whole = connection.execute(select(table).order_by(key))
    for row_id in ids:
        try:
            stored = whole.fetchone()
            if stored is None:
                yield CatalogueDamage(table=table.name, told=f"table {table.name} ends before row {row_id}")
                return
            checked(kind, stored)
        except DamagedRow as error:
            yield CatalogueDamage(table=table.name, row_id=row_id, told=str(error))
        except (SQLAlchemyError, TypeError, ValueError, OverflowError) as error:
            told = f"row {row_id} of table {table.name}: {_first_line(error)}"
            yield CatalogueDamage(table=table.name, row_id=row_id, told=told)
            whole = connection.execute(select(table).where(key > row_id).order_by(key))


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]
