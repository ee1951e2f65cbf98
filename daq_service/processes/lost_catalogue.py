"""A catalogue that is gone though its test was begun: told by what lies beside it, which outlives it."""

from __future__ import annotations

import logging
from pathlib import Path

from daq_service.archive import FolderSetReader
from daq_service.catalogue import open_catalogue
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.errors import CatalogueDamagedError, CatalogueError, NoDataYetError
from daq_service.catalogue.experiment_file import HISTORY_FILE, read_experiment
from daq_service.catalogue.history import History, read_history
from daq_service.processes.data_folder import is_owned

log = logging.getLogger(__name__)


def lost_catalogue(folder: Path) -> bool:
    """Tell whether a test was begun here whose catalogue is gone, or empty.

    Raises
    ------
    CatalogueError
        What lies beside it cannot be read now.
    """
    path = folder / FILE_NAME
    if path.is_file() and path.stat().st_size > 0:
        try:
            with open_catalogue(folder):
                return False
        except NoDataYetError:
            log.debug("%s has no experiment yet", path)
        except CatalogueError:
            return False  # whoever opens it to write says what is wrong with it
    try:
        kept = read_experiment(folder)
    except CatalogueDamagedError as error:
        log.warning("%s", error)
        kept = None
    begun = kept is not None or history_of(folder).experiment is not None
    return begun or bool(FolderSetReader(folder).sets())


def lost_reason(folder: Path) -> str:
    """Say that the catalogue is lost and what helps; empty: it is not.

    Raises
    ------
    CatalogueError
        As `lost_catalogue`.
    """
    if not lost_catalogue(folder):
        return ""
    told = f"the catalogue of {folder} is lost, though its test was begun"
    if is_owned(folder):
        return (
            f"{told}; the recorder that runs there makes it again at its start: if this stays, start it anew"
        )
    return f"{told}; `solimon rebuild --data-dir {folder}` makes it again from sets, journal and history"


def history_of(folder: Path) -> History:
    """Read the history beside a catalogue.

    Raises
    ------
    CatalogueError
        It cannot be read now.
    """
    try:
        return read_history(folder)
    except OSError as error:
        raise CatalogueError(f"{folder / HISTORY_FILE} cannot be read: {error}; mend the disk") from error
