"""Detection of a lost catalogue of a started test, from the files next to it."""

from __future__ import annotations

import logging
from pathlib import Path

from daq_service.archive import FolderSetReader
from daq_service.catalogue import open_catalogue
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.errors import CatalogueDamagedError, CatalogueError, NoDataYetError
from daq_service.catalogue.experiment_file import HISTORY_FILE, read_experiment_file
from daq_service.catalogue.history import History, read_history
from daq_service.processes.data_folder import is_held

log = logging.getLogger(__name__)


def is_catalogue_lost(folder: Path) -> bool:
    """Return whether a test was started here whose catalogue is missing, empty or without an experiment.

    Evidence of a started test is the experiment file (a damaged one is only logged), the history or any set
    file. A catalogue that cannot be opened for another reason is not lost.

    Raises
    ------
    CatalogueError
        The files next to it cannot be read now.
    """
    path = folder / FILE_NAME
    if path.is_file() and path.stat().st_size > 0:
        try:
            with open_catalogue(folder):
                return False
        except NoDataYetError:
            log.debug("%s has no experiment yet", path)
        except CatalogueError:
            return False  # opening it for writing reports what is wrong with it
    try:
        experiment = read_experiment_file(folder)
    except CatalogueDamagedError as error:
        log.warning("%s", error)
        experiment = None
    is_started = experiment is not None or read_folder_history(folder).experiment is not None
    return is_started or bool(FolderSetReader(folder).sets())


def describe_loss(folder: Path) -> str:
    """Return a description of the loss of the catalogue and its remedy; empty if it is not lost.

    Raises
    ------
    CatalogueError
        As `is_catalogue_lost`.
    """
    if not is_catalogue_lost(folder):
        return ""
    problem = f"the catalogue of {folder} is lost, though its test was started"
    if is_held(folder):
        return (
            f"{problem}; the recorder that runs there makes it again at its start: if this stays, "
            "start it anew"
        )
    return f"{problem}; `solimon rebuild --data-dir {folder}` makes it again from sets, journal and history"


def read_folder_history(folder: Path) -> History:
    """Read the history of events stored next to a catalogue; empty without a file.

    Raises
    ------
    CatalogueError
        The history cannot be read now.
    """
    try:
        return read_history(folder)
    except OSError as error:
        raise CatalogueError(f"{folder / HISTORY_FILE} cannot be read: {error}; repair the disk") from error
