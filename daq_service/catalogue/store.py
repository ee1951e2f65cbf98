"""Open the catalogue: the recorder creates and migrates it, all others wait until it exists."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, overload

from sqlalchemy import Engine, inspect, text

from daq_service.catalogue.connection import FILE_NAME, create_reading_engine, create_sqlite_engine
from daq_service.catalogue.corruption import raise_if_corrupt
from daq_service.catalogue.errors import (
    CatalogueError,
    NetworkFolderError,
    NoDataYetError,
    SchemaVersionError,
)
from daq_service.catalogue.experiment_file import read_experiment_file
from daq_service.catalogue.migrations import SCHEMA_REVISION, migrate_schema
from daq_service.catalogue.network_folder import find_network_type
from daq_service.catalogue.owner import raise_if_other_configuration, raise_if_other_test
from daq_service.catalogue.reader import Catalogue
from daq_service.catalogue.stored_rows import translate_errors
from daq_service.catalogue.writer import RecorderCatalogue
from daq_service.settings.tree import Settings

CHECKED_WHOLE_BYTES = 64_000_000
"""A recorder checks every row of a catalogue up to this size at its start, about 2 s; of a larger one only
the rows that it needs."""

__all__ = [
    "Catalogue",
    "CatalogueError",
    "NoDataYetError",
    "RecorderCatalogue",
    "check_owner",
    "open_catalogue",
]


@overload
def open_catalogue(folder: Path, *, writer: Literal[False] = ..., settings: None = ...) -> Catalogue: ...


@overload
def open_catalogue(
    folder: Path, *, writer: Literal[True], settings: Settings | None = ...
) -> RecorderCatalogue: ...


def open_catalogue(folder: Path, *, writer: bool = False, settings: Settings | None = None) -> Catalogue:
    """Open the catalogue of a data folder.

    Parameters
    ----------
    writer
        True for the recorder: the file is made or migrated. The folder must exist.
    settings
        Writer only: refuse a folder that belongs to another test, before it is migrated.

    Raises
    ------
    NoDataYetError
        Reader: the recorder has not started the experiment yet.
    NetworkFolderError
        The folder is on a network file system.
    SchemaVersionError
        The catalogue was made by another version of solimon.
    OtherExperimentError
        The folder belongs to another test (see `check_owner`).
    CatalogueError
        The file is damaged, or cannot be read or written.
    """
    _raise_if_network_folder(folder)
    path = folder / FILE_NAME
    return _open_writer(path, settings) if writer else _open_reader(path)


def open_for_command(folder: Path) -> RecorderCatalogue:
    """Open the catalogue of a test for writing one command; it is neither created nor migrated.

    Raises
    ------
    NoDataYetError, SchemaVersionError, CatalogueError
        As `open_catalogue` for a reader. A file that cannot be written fails only at the command.
    """
    path = folder / FILE_NAME
    _open_reader(path).close()  # raises the error of an invalid one
    return RecorderCatalogue(path, create_sqlite_engine(path, writable=True))


def create_temporary(folder: Path) -> RecorderCatalogue:
    """Create a catalogue with the current schema in a temporary folder; nothing is synced to disk.

    Raises CatalogueError if it cannot be created. The caller closes it.
    """
    path = folder / FILE_NAME
    engine = create_sqlite_engine(path, writable=True, durable=False)
    with translate_errors(path, "making"):
        migrate_schema(engine, path, None)
    return RecorderCatalogue(path, engine)


def _raise_if_network_folder(folder: Path) -> None:
    """Raise NetworkFolderError if a folder is on a network file system; a folder of unknown type passes."""
    kind = find_network_type(folder)
    if kind is not None:
        raise NetworkFolderError(
            f"{folder} is on a network file system ({kind}), where SQLite's locks cannot be trusted; "
            "choose a folder on a local disk with --data-dir"
        )


def check_owner(settings: Settings, folder: Path) -> None:
    """Raise an error if a folder's test differs from the settings, also in an older revision; write nothing.

    Raises
    ------
    NetworkFolderError
        The folder is on a network file system.
    OtherExperimentError
         Its configuration, extractor or twin differs; contains both values and the remedy.
    CatalogueDamagedError
        The catalogue is damaged; or it is lost and ``experiment.json`` is damaged.
    SchemaVersionError
        A newer version of solimon made the catalogue.
    """
    _raise_if_network_folder(folder)
    path = folder / FILE_NAME
    if not path.is_file():
        experiment = read_experiment_file(folder)
        if experiment is not None:
            raise_if_other_configuration(experiment, folder, settings)
        return  # no test yet, or its catalogue is lost
    engine = create_reading_engine(path)
    try:
        with translate_errors(path, "opening"):
            revision = read_revision(engine)
            if revision is not None and revision > SCHEMA_REVISION:
                raise _create_schema_error(path, revision)
            if revision is not None:
                raise_if_other_test(engine, path, settings)
    finally:
        engine.dispose()


def _open_writer(path: Path, settings: Settings | None) -> RecorderCatalogue:
    """Open the catalogue for the recorder; create, check or migrate it first.

    A file of the current revision up to 64 MB is checked completely. Raises as `open_catalogue`.
    """
    engine = create_sqlite_engine(path, writable=True)
    try:
        with translate_errors(path, "opening"):
            revision = read_revision(engine)
            if revision == SCHEMA_REVISION and path.stat().st_size <= CHECKED_WHOLE_BYTES:
                raise_if_corrupt(path.parent)
            if settings is not None and revision is not None and revision <= SCHEMA_REVISION:
                raise_if_other_test(engine, path, settings)
            if revision != SCHEMA_REVISION:
                migrate_schema(engine, path, revision)
        catalogue = RecorderCatalogue(path, engine)
    except BaseException:
        engine.dispose()
        raise
    return catalogue


def _open_reader(path: Path) -> Catalogue:
    """Open a catalogue for reading; raise NoDataYetError if there is none or its test has not started.

    Raises SchemaVersionError for another revision, CatalogueError for a file that cannot be read.
    """
    not_ready = NoDataYetError(f"{path}: no data yet; start `solimon record` or wait for it", path.parent)
    if not path.is_file():
        raise not_ready
    engine = create_reading_engine(path)
    try:
        with translate_errors(path, "opening"):
            revision = read_revision(engine)
        if revision is None:
            raise not_ready
        if revision != SCHEMA_REVISION:
            raise _create_schema_error(path, revision)
        catalogue = Catalogue(path, engine)
        catalogue.read_experiment()
    except BaseException:
        engine.dispose()
        raise
    return catalogue


def _create_schema_error(path: Path, revision: str) -> SchemaVersionError:
    """Create, but do not raise, the error for a catalogue of another schema revision."""
    return SchemaVersionError(
        f"{path} has schema {revision}, this version of solimon reads {SCHEMA_REVISION}; "
        "start the recorder of this version, which migrates it, or install the version that made it"
    )


def read_revision(engine: Engine) -> str | None:
    """Read the four-digit revision of the file's schema, None if it has none; errors of SQL pass through."""
    with engine.begin() as connection:
        if not inspect(connection).has_table("alembic_version"):
            return None
        return connection.execute(text("SELECT version_num FROM alembic_version")).scalar_one_or_none()
