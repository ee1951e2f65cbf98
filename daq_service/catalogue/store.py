"""Open the catalogue: the recorder makes and migrates it, everybody else waits until it is there."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, overload

from sqlalchemy import Engine, inspect, text

from daq_service.catalogue.connection import FILE_NAME, make_engine, reading_engine, translated
from daq_service.catalogue.corruption import refuse_corruption
from daq_service.catalogue.errors import (
    CatalogueError,
    NetworkFolderError,
    NoDataYetError,
    SchemaVersionError,
)
from daq_service.catalogue.experiment_file import read_experiment
from daq_service.catalogue.migrations import SCHEMA_REVISION, migrate
from daq_service.catalogue.network_folder import network_filesystem
from daq_service.catalogue.owner import refuse_other_experiment, refuse_other_test
from daq_service.catalogue.reader import Catalogue
from daq_service.catalogue.writer import RecorderCatalogue
from daq_service.settings.tree import Settings

CHECKED_WHOLE_BYTES = 64_000_000
"""A recorder's start reads every row of a catalogue up to this size, some 2 s; of a larger one those that it
needs, each with its checksum."""

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
        Reader: the recorder has not begun the experiment yet.
    NetworkFolderError
        The folder is on a network file system.
    SchemaVersionError
        The catalogue was made by another version of solimon.
    OtherExperimentError
        The folder belongs to another test (see `check_owner`).
    CatalogueError
        The file is damaged, or cannot be read or written.
    """
    _refuse_network(folder)
    path = folder / FILE_NAME
    return _open_writer(path, settings) if writer else _open_reader(path)


def open_for_one_command(folder: Path) -> RecorderCatalogue:
    """Open the catalogue of a test that nobody records, which the caller owns: neither made nor migrated.

    Raises
    ------
    NoDataYetError, SchemaVersionError, CatalogueError
        As `open_catalogue` for a reader; or it cannot be written.
    """
    path = folder / FILE_NAME
    _open_reader(path).close()  # says what is wrong with it
    return RecorderCatalogue(path, make_engine(path, writable=True))


def open_for_a_while(folder: Path) -> RecorderCatalogue:
    """Make a catalogue that is thrown away with its folder: nothing of it is durable."""
    path = folder / FILE_NAME
    engine = make_engine(path, writable=True, durable=False)
    with translated(path, "making"):
        migrate(engine, path, None)
    return RecorderCatalogue(path, engine)


def _refuse_network(folder: Path) -> None:
    kind = network_filesystem(folder)
    if kind is not None:
        raise NetworkFolderError(
            f"{folder} is on a network file system ({kind}), where SQLite's locks cannot be trusted; "
            "choose a folder on a local disk with --data-dir"
        )


def check_owner(settings: Settings, folder: Path) -> None:
    """Compare a folder's test with ours before anything is written; older revisions are read, too.

    Raises
    ------
    OtherExperimentError
        It began with another configuration, extractor or twin: each with both values, and the way out.
    CatalogueDamagedError
        The catalogue is damaged, or it is lost and the file that names the experiment is.
    SchemaVersionError
        A newer version of solimon made the catalogue.
    """
    _refuse_network(folder)
    path = folder / FILE_NAME
    if not path.is_file():
        kept = read_experiment(folder)
        if kept is not None:
            refuse_other_experiment(kept, folder, settings)
        return  # nobody's yet, or its catalogue is lost
    engine = reading_engine(path)
    try:
        with translated(path, "opening"):
            found = revision_of(engine)
            if found is not None and found > SCHEMA_REVISION:
                raise _other_schema(path, found)
            if found is not None:
                refuse_other_test(engine, path, settings)
    finally:
        engine.dispose()


def _open_writer(path: Path, settings: Settings | None) -> RecorderCatalogue:
    engine = make_engine(path, writable=True)
    try:
        with translated(path, "opening"):
            found = revision_of(engine)
            if found == SCHEMA_REVISION and path.stat().st_size <= CHECKED_WHOLE_BYTES:
                refuse_corruption(path.parent)
            if settings is not None and found is not None and found <= SCHEMA_REVISION:
                refuse_other_test(engine, path, settings)
            if found != SCHEMA_REVISION:
                migrate(engine, path, found)
        catalogue = RecorderCatalogue(path, engine)
    except BaseException:
        engine.dispose()
        raise
    return catalogue


def _open_reader(path: Path) -> Catalogue:
    waiting = NoDataYetError(f"{path}: no data yet; start `solimon record` or wait for it", path.parent)
    if not path.is_file():
        raise waiting
    engine = reading_engine(path)
    try:
        with translated(path, "opening"):
            found = revision_of(engine)
        if found is None:
            raise waiting
        if found != SCHEMA_REVISION:
            raise _other_schema(path, found)
        catalogue = Catalogue(path, engine)
        catalogue.experiment_row()
    except BaseException:
        engine.dispose()
        raise
    return catalogue


def _other_schema(path: Path, found: str) -> SchemaVersionError:
    return SchemaVersionError(
        f"{path} has schema {found}, this version of solimon reads {SCHEMA_REVISION}; "
        "start the recorder of this version, which migrates it, or install the version that made it"
    )


def revision_of(engine: Engine) -> str | None:
    """Read the file's schema; None where there is none yet."""
    with engine.begin() as connection:
        if not inspect(connection).has_table("alembic_version"):
            return None
        return connection.execute(text("SELECT version_num FROM alembic_version")).scalar_one_or_none()
