"""Alembic migrations of the catalogue; they travel inside the package."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, bindparam, select, text, update

from daq_service.catalogue.errors import SchemaVersionError
from daq_service.catalogue.rows import CountsRow
from daq_service.catalogue.stored_rows import begin_write, compute_row_crc32, insert_rows
from daq_service.catalogue.tables import KINDS, ROW_CRC32, TABLES, metadata
from daq_service.catalogue.trends import rebuild_trends

SCHEMA_REVISION = max(path.stem[9:13] for path in Path(__file__).parent.glob("versions/revision_*.py"))
"""The newest revision in ``versions``: what this version of solimon reads and writes. Numbers of four
digits, so that revisions compare as text."""

_VERSION_TABLE = (
    "CREATE TABLE alembic_version (version_num VARCHAR(32) NOT NULL, "
    "CONSTRAINT alembic_version_pkc PRIMARY KEY (version_num))"
)
"""As Alembic itself makes it."""


def list_known_revisions() -> list[str]:
    """List the four-digit numbers of all schema revisions, oldest first."""
    return sorted(path.stem[9:13] for path in Path(__file__).parent.glob("versions/revision_*.py"))


def migrate_schema(engine: Engine, path: Path, found: str | None) -> None:
    """Migrate a catalogue from revision ``found`` (None: empty) to the newest one, in one transaction.

    Also adds missing checksums and recomputes the trends. SQL errors pass through; nothing is changed then.

    Raises
    ------
    SchemaVersionError
        This version of solimon does not know the revision: a newer one made the file.
    """
    if found is None:
        # The tables as they are described: what the migrations make, step by step, is the same.
        with begin_write(engine) as connection:
            metadata.create_all(connection)
            connection.execute(text(_VERSION_TABLE))
            version = text("INSERT INTO alembic_version VALUES (:revision)")
            connection.execute(version, {"revision": SCHEMA_REVISION})
            insert_rows(connection, [CountsRow()])
        return
    # Alembic takes half a second to import: only a folder of an earlier version needs it.
    from alembic import command
    from alembic.config import Config
    from alembic.script import ScriptDirectory
    from alembic.util import CommandError

    config = Config()
    # A percent sign begins an interpolation in this kind of configuration.
    config.set_main_option("script_location", str(Path(__file__).parent).replace("%", "%%"))
    try:
        ScriptDirectory.from_config(config).get_revision(found)
    except CommandError as error:
        raise SchemaVersionError(
            f"{path} has schema {found}; this version of solimon knows none newer than {SCHEMA_REVISION}: "
            "install the version that made it, or a newer one"
        ) from error
    with begin_write(engine) as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, "head")
        _add_missing_checksums(connection)
        rebuild_trends(connection)


def _add_missing_checksums(connection: Connection) -> None:
    """Compute and store the checksum of each row without one (migrated rows), in the caller's transaction."""
    for kind in KINDS:
        table = TABLES[kind]
        key = table.primary_key.columns[0]
        columns = [table.c[name] for name in kind.__slots__]
        rows_without: Iterable[Any] = connection.execute(select(*columns).where(table.c[ROW_CRC32].is_(None)))
        rows = (kind(**dict(zip(kind.__slots__, stored, strict=True))) for stored in rows_without)
        checksums = [{"its_key": getattr(row, key.name), "its_crc32": compute_row_crc32(row)} for row in rows]
        if checksums:
            statement = update(table).where(key == bindparam("its_key"))
            connection.execute(statement.values({ROW_CRC32: bindparam("its_crc32")}), checksums)
