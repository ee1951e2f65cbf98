"""What a catalogue, whole or damaged, still says of what nobody can compute again: its sound rows alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from sqlalchemy import Connection, select

from daq_service.catalogue.connection import FILE_NAME, make_engine, translated
from daq_service.catalogue.corruption import UNREADABLE
from daq_service.catalogue.errors import SchemaVersionError
from daq_service.catalogue.migrations import SCHEMA_REVISION, known_revisions
from daq_service.catalogue.row_checksum import DamagedRow, checked
from daq_service.catalogue.rows import CommandRow, EventRow, ExperimentRow, Row, SetRow
from daq_service.catalogue.store import revision_of
from daq_service.catalogue.tables import table_of

R = TypeVar("R", bound=Row)


@dataclass(slots=True, kw_only=True, eq=False)
class Salvaged:
    """As a `history.History`; ``damage`` tells of the rows that are not taken."""

    experiment: ExperimentRow | None = None
    events: dict[int, EventRow] = field(default_factory=dict)
    commands: dict[int, CommandRow] = field(default_factory=dict)
    digests: dict[str, str] = field(default_factory=dict)
    damage: list[str] = field(default_factory=list)


def salvaged(folder: Path) -> Salvaged:
    """Read every sound row; nothing where there is no catalogue.

    Raises
    ------
    CatalogueError
        It cannot be opened, or is an older one, which the recorder migrates.
    """
    path, found = folder / FILE_NAME, Salvaged()
    if not path.is_file():
        return found
    engine = make_engine(path, writable=False)
    try:
        with translated(path, "reading"):
            revision = revision_of(engine)
            if revision in known_revisions()[:-1]:
                raise SchemaVersionError(
                    f"{path} has schema {revision}, this version of solimon reads {SCHEMA_REVISION}; "
                    "start the recorder of this version, which migrates it"
                )
            with engine.begin() as connection:
                tell = found.damage.append
                for experiment in _sound(connection, ExperimentRow, tell):
                    found.experiment = experiment
                found.events = {row.id or 0: row for row in _sound(connection, EventRow, tell)}
                found.commands = {row.id: row for row in _sound(connection, CommandRow, tell)}
                for row in _sound(connection, SetRow, tell):
                    if row.file and row.file_sha256:
                        found.digests[row.file] = row.file_sha256
    finally:
        engine.dispose()
    return found


def _sound(connection: Connection, kind: type[R], tell: Callable[[str], None]) -> Iterator[R]:
    """Rows that are what was stored; where a page is damaged, those before and behind it."""
    table = table_of(kind)
    key = table.primary_key.columns[0]
    for backwards in (False, True):
        try:
            result = connection.execute(select(table).order_by(key.desc() if backwards else key))
            while True:
                try:
                    stored = result.fetchone()
                    if stored is None:
                        return
                    yield checked(kind, stored)
                except UnicodeDecodeError:
                    raise  # the reading itself ended
                except (DamagedRow, TypeError, ValueError, OverflowError) as error:
                    tell(f"table {table.name}: {error}")
        except UNREADABLE as error:
            tell(f"table {table.name}: {str(error).partition(chr(10))[0]}")
