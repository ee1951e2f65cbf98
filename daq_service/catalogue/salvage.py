"""Read the sound rows of a possibly corrupt catalogue that cannot be recomputed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from sqlalchemy import Connection

from daq_service.catalogue.connection import FILE_NAME, create_sqlite_engine
from daq_service.catalogue.corruption import UNREADABLE
from daq_service.catalogue.errors import SchemaVersionError
from daq_service.catalogue.migrations import SCHEMA_REVISION, list_known_revisions
from daq_service.catalogue.reported_rows import ROW_OF_EVENT, join_rows, lacks_row, select_rows, to_payloads
from daq_service.catalogue.rows import CommandRow, EventRow, ExperimentRow, Row, SetRow
from daq_service.catalogue.store import read_revision
from daq_service.catalogue.stored_rows import DamagedRow, to_checked_row, translate_errors
from daq_service.catalogue.tables import TABLES

R = TypeVar("R", bound=Row)


@dataclass(slots=True, kw_only=True, eq=False)
class Salvaged:
    """Sound rows, as in `history.History`; ``damage`` lists the corrupt ones."""

    experiment: ExperimentRow | None = None
    events: dict[int, EventRow] = field(default_factory=dict)
    commands: dict[int, CommandRow] = field(default_factory=dict)
    digests: dict[str, str] = field(default_factory=dict)
    damage: list[str] = field(default_factory=list)


def read_sound_rows(folder: Path) -> Salvaged:
    """Read every sound row of a catalogue of the current schema that cannot be recomputed.

    Empty if there is no catalogue. Corrupt rows are listed in ``damage``, not raised.

    Raises
    ------
    SchemaVersionError
        It is an older one, which the recorder migrates.
    CatalogueError
        It cannot be opened.
    """
    path, salvaged_rows = folder / FILE_NAME, Salvaged()
    if not path.is_file():
        return salvaged_rows
    engine = create_sqlite_engine(path, writable=False)
    try:
        with translate_errors(path, "reading"):
            revision = read_revision(engine)
            if revision in list_known_revisions()[:-1]:
                raise SchemaVersionError(
                    f"{path} has schema {revision}, this version of solimon reads {SCHEMA_REVISION}; "
                    "start the recorder of this version, which migrates it"
                )
            with engine.begin() as connection:
                report = salvaged_rows.damage.append
                for experiment in _yield_rows(connection, ExperimentRow, report):
                    salvaged_rows.experiment = experiment
                salvaged_rows.commands = {row.id: row for row in _yield_rows(connection, CommandRow, report)}
                rows = [
                    row
                    for kind in dict.fromkeys(ROW_OF_EVENT.values())
                    for row in _yield_rows(connection, kind, report)
                ]
                events = join_rows(_yield_rows(connection, EventRow, report), to_payloads(rows))
                # Without its row an event is lost, unless the history has it.
                salvaged_rows.events = {row.id or 0: row for row in events if not lacks_row(row)}
                for row in rows:
                    if isinstance(row, SetRow) and row.file and row.file_sha256:
                        salvaged_rows.digests[row.file] = row.file_sha256
    finally:
        engine.dispose()
    return salvaged_rows


def _yield_rows(connection: Connection, kind: type[R], report: Callable[[str], None]) -> Iterator[R]:
    """Yield the rows that match their checksum, by primary key; ``report`` the error of each other one.

    At a corrupt page the table is read again from its end, so a row may come twice. Errors are not raised.
    """
    table = TABLES[kind]
    key = table.primary_key.columns[0]
    for backwards in (False, True):
        try:
            result = connection.execute(select_rows(kind).order_by(key.desc() if backwards else key))
            while True:
                try:
                    stored = result.fetchone()
                    if stored is None:
                        return
                    yield to_checked_row(kind, stored)
                except UnicodeDecodeError:
                    raise  # the reading itself ended
                except (DamagedRow, TypeError, ValueError, OverflowError) as error:
                    report(f"table {table.name}: {error}")
        except UNREADABLE as error:
            report(f"table {table.name}: {str(error).partition(chr(10))[0]}")
