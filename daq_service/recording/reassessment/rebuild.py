"""Rebuild a catalogue from history, old rows and set files; compute only what they lack."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from daq_service.acquisition.shot_features import FeaturesOf
from daq_service.archive import FolderSetReader
from daq_service.archive.waterfall.tiles import TILES_FOLDER
from daq_service.assessment.results_in_file import read_set_results
from daq_service.background.tiles import rebuild_tiles
from daq_service.catalogue import open_catalogue
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.corruption import raise_if_corrupt
from daq_service.catalogue.errors import (
    CatalogueError,
    CatalogueWriteError,
    NoDataYetError,
    SchemaVersionError,
)
from daq_service.catalogue.experiment_file import ensure_experiment_file, raise_if_other_record
from daq_service.catalogue.history import History, HistoryFollower
from daq_service.catalogue.owner import build_experiment_identity, raise_if_other_configuration
from daq_service.catalogue.salvage import Salvaged, read_sound_rows
from daq_service.catalogue.store import create_temporary
from daq_service.processes.lost_catalogue import read_folder_history
from daq_service.recording.experiment import find_stored_experiment, raise_if_foreign
from daq_service.recording.reassessment.restore_rows import Restored, StoredHistory, restore_rows
from daq_service.recording.reassessment.stored_runs import Progress
from daq_service.settings.stored import restore_settings
from daq_service.settings.tree import Settings
from daq_service.shared_file import retry, sync_folder

log = logging.getLogger(__name__)

BUILDING = "rebuilding"
"""Folder in which the new catalogue is made."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rebuilt:
    """What was made again.

    Attributes
    ----------
    kept
        Name of the old catalogue, in the same folder; empty: there was none.
    warnings
        What could not be made again, or is not what it was.
    """

    experiment: str
    sets: int
    events: int
    orders: int
    kept: str
    warnings: list[str] = field(default_factory=list)


def rebuild_folder_catalogue(
    folder: Path,
    *,
    progress: Progress = lambda done, total: None,
    settings: Settings | None = None,
    features_of: FeaturesOf | None = None,
) -> Rebuilt:
    """Rebuild the catalogue of a data folder, and files that follow from it; the caller owns the folder.

    The old catalogue is replaced when the new one is complete and checked, and kept under another name.
    experiment.json and history are updated, tiles only if results were computed again.

    Parameters
    ----------
    progress
        Called with the sets that are done and their number.
    settings
        Refuse a folder of another test; None: accept any test.
    features_of
        Extracts the features of a shot; None: as the recorder.

    Raises
    ------
    NoDataYetError
        The folder holds no test.
    OtherExperimentError
        The folder holds sets of two experiments, or of another one than ``settings``.
    CatalogueError
        It cannot be made again, and why.
    """
    archive = FolderSetReader(folder)
    history, kept = read_folder_history(folder), _read_old_catalogue(folder)
    experiment = find_stored_experiment(folder, history, archive)
    if kept.experiment is not None:
        if experiment is not None:
            raise_if_other_record(
                kept.experiment, experiment, "its catalogue", "the files next to it", folder
            )
        experiment = kept.experiment
    if experiment is None:
        raise NoDataYetError(
            f"{folder} holds neither catalogue nor sets of solimon; choose it with --data-dir"
        )
    if settings is not None:
        raise_if_other_configuration(experiment, folder, settings)
    stored = StoredHistory(
        events={**history.events, **kept.events}, digests={**history.digests, **kept.digests}
    )
    orders = {**history.commands, **kept.commands}
    place = folder / BUILDING
    try:
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        with create_temporary(place) as catalogue:  # `_replace_catalogue` makes the complete file durable
            catalogue.restore_rows([experiment, *orders.values()])
            its_settings = restore_settings(experiment.configuration)
            found = restore_rows(its_settings, experiment, archive, catalogue, stored, progress, features_of)
            raise_if_foreign(found.foreign, str(folder))
            catalogue.recompute_counts()
            n_events = catalogue.counts()["events"]
        raise_if_corrupt(place)
        name = _replace_catalogue(folder, place)
    except OSError as error:
        raise CatalogueWriteError(
            f"{folder}: the catalogue cannot be rebuilt: {error}; free disk space or repair the disk"
        ) from error
    finally:
        shutil.rmtree(place, ignore_errors=True)
    # Tiles follow from set files and features: those of unchanged sets stay.
    tiles_are_valid = not found.computed and (folder / TILES_FOLDER).is_dir()
    not_tiled = _update_copies(folder, None if tiles_are_valid else progress)
    return Rebuilt(
        experiment=experiment.name,
        sets=found.sets,
        events=n_events,
        orders=len(orders),
        kept=name,
        warnings=_collect_warnings(history, kept, found, not_tiled),
    )


def _read_old_catalogue(folder: Path) -> Salvaged:
    """Read the sound rows of the old catalogue; none, with the error as damage, if it cannot be opened.

    Raises SchemaVersionError for an earlier schema, which is complete.
    """
    try:
        return read_sound_rows(folder)
    except SchemaVersionError:
        raise  # an older one is complete, and has what cannot be computed
    except CatalogueError as error:
        return Salvaged(damage=[str(error)])


def _replace_catalogue(folder: Path, place: Path) -> str:
    """Replace the old catalogue by the new one in ``place``, durably; the old one gets a name with the time.

    Returns that name, or "" if there was none. Raises OSError.
    """
    new, path = place / FILE_NAME, folder / FILE_NAME
    _sync_file(new)
    kept = f"catalogue-replaced-{datetime.now(UTC):%Y%m%dT%H%M%S%f}Z.sqlite"
    endings = [ending for ending in ("", "-wal", "-shm") if path.with_name(FILE_NAME + ending).exists()]
    for ending in endings:
        old = path.with_name(FILE_NAME + ending)
        retry(lambda old=old, ending=ending: old.replace(folder / (kept + ending)))  # type: ignore[misc]
    retry(lambda: new.replace(path))
    sync_folder(folder)
    return kept if "" in endings else ""


def _sync_file(path: Path) -> None:
    """Sync a file's content to disk and block until then; OSError if it cannot be opened."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def _update_copies(folder: Path, progress: Progress | None) -> list[str]:
    """Update experiment.json, the history and, unless ``progress`` is None, the tiles.

    Returns a text for each set that the tiles lack. Raises CatalogueError or OSError.
    """
    with open_catalogue(folder, writer=True) as catalogue:
        experiment = catalogue.read_experiment()
        ensure_experiment_file(folder, experiment)
        HistoryFollower(folder, catalogue).begin()
        if progress is None:
            return []
        results = partial(read_set_results, catalogue)
        return rebuild_tiles(
            folder, build_experiment_identity(experiment), catalogue.list_files_except(()), results, progress
        )


def _collect_warnings(history: History, kept: Salvaged, found: Restored, not_tiled: list[str]) -> list[str]:
    """Format warnings about history, old catalogue, sets and tiles, at most ten (and a count) of each."""

    def prefix_lines(lines: Iterable[str], what: str) -> list[str]:
        """Prefix lines with the text ``what``; after ten lines, give the number of the others."""
        listed = list(lines)
        return [f"{what}: {line}" for line in listed[:10]] + (
            [f"{what}: {len(listed) - 10} more"] if len(listed) > 10 else []
        )

    return [
        *prefix_lines(history.damage, "history"),
        *prefix_lines(kept.damage, "old catalogue"),
        *prefix_lines(found.damaged, "set"),
        *prefix_lines(found.differing, "not what it was"),
        *prefix_lines(not_tiled, "not in the waterfall's tiles"),
    ]
