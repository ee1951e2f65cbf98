"""Open the catalogue: the recorder makes and migrates it, everybody else waits until it is there."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, overload

from sqlalchemy import Engine, inspect, text

from daq_service.catalogue.connection import FILE_NAME, make_engine, translated
from daq_service.catalogue.errors import (
    CatalogueError,
    NetworkFolderError,
    NoDataYetError,
    SchemaVersionError,
)
from daq_service.catalogue.migrations import SCHEMA_REVISION, migrate
from daq_service.catalogue.network_folder import network_filesystem
from daq_service.catalogue.reader import Catalogue
from daq_service.catalogue.writer import RecorderCatalogue

__all__ = ["Catalogue", "CatalogueError", "NoDataYetError", "RecorderCatalogue", "open_catalogue"]


@overload
def open_catalogue(
    folder: Path, *, writer: Literal[False] = ..., configuration_hash: None = ...
) -> Catalogue: ...


@overload
def open_catalogue(
    folder: Path, *, writer: Literal[True], configuration_hash: str | None = ...
) -> RecorderCatalogue: ...


def open_catalogue(folder: Path, *, writer: bool = False, configuration_hash: str | None = None) -> Catalogue:
    """Open the catalogue of a data folder.

    Parameters
    ----------
    writer
        True for the recorder: the file is made or migrated. The folder must exist.
    configuration_hash
        Writer only: refuse a folder that belongs to another configuration.

    Raises
    ------
    NoDataYetError
        Reader: the recorder has not begun the experiment yet.
    NetworkFolderError
        The folder is on a network file system.
    SchemaVersionError
        The catalogue was made by another version of solimon.
    OtherExperimentError
        The folder belongs to another configuration.
    CatalogueError
        The file is damaged, or cannot be read or written.
    """
    _refuse_network(folder)
    path = folder / FILE_NAME
    return _open_writer(path, configuration_hash) if writer else _open_reader(path)


def _refuse_network(folder: Path) -> None:
    kind = network_filesystem(folder)
    if kind is not None:
        raise NetworkFolderError(
            f"{folder} is on a network file system ({kind}), where SQLite's locks cannot be trusted; "
            "choose a folder on a local disk with --data-dir"
        )


def _open_writer(path: Path, configuration_hash: str | None) -> RecorderCatalogue:
    engine = make_engine(path, writable=True)
    try:
        with translated(path, "opening"):
            found = _revision(engine)
            if found != SCHEMA_REVISION:
                migrate(engine, path, found)
        catalogue = RecorderCatalogue(path, engine)
        if configuration_hash is not None:
            catalogue.check_owner(configuration_hash)
    except BaseException:
        engine.dispose()
        raise
    return catalogue


def _open_reader(path: Path) -> Catalogue:
    waiting = f"{path}: no data yet; start `solimon record` or wait for it"
    if not path.is_file():
        raise NoDataYetError(waiting)
    engine = make_engine(path, writable=False)
    try:
        with translated(path, "opening"):
            found = _revision(engine)
        if found is None:
            raise NoDataYetError(waiting)
        if found != SCHEMA_REVISION:
            raise SchemaVersionError(
                f"{path} has schema {found}, this version of solimon reads {SCHEMA_REVISION}; "
                "start the recorder of this version, which migrates it, or install the version that made it"
            )
        catalogue = Catalogue(path, engine)
        catalogue.experiment_row()
    except BaseException:
        engine.dispose()
        raise
    return catalogue


def _revision(engine: Engine) -> str | None:
    """Read the file's schema; None where there is none yet."""
    with engine.begin() as connection:
        if not inspect(connection).has_table("alembic_version"):
            return None
        return connection.execute(text("SELECT version_num FROM alembic_version")).scalar_one_or_none()
