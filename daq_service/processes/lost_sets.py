"""Sets that the catalogue counts on and that are gone: seen by a listing, without reading any of them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from daq_service.archive.journal.reader import read_journal
from daq_service.archive.records import SETS_FOLDER, set_indices
from daq_service.catalogue import Catalogue

FILED_WITHIN_S = 2.0
"""So long after a file was written it has its name, and the time of its folder."""


def lost_sets(folder: Path, catalogue: Catalogue, *, newest_rows: int | None = None) -> dict[str, str]:
    """Name the files that rows point at and that are missing or empty, and say which of the two.

    Parameters
    ----------
    newest_rows
        Look at the files of so many of the newest rows only, and at the names of all where something was
        taken out of their folder or put there since: what takes the same time in every year of a test.
        None: at all.

    Raises
    ------
    CatalogueError, OSError
        The folder cannot be looked at now.
    """
    sets = folder / SETS_FOLDER
    if newest_rows is None:
        gone = catalogue.files_but_of(set_indices([name for name in _names(sets) if _size(f"{sets}/{name}")]))
    else:
        recent = catalogue.newest_files(newest_rows)
        gone = {index: file for index, file in recent.items() if not _size(f"{folder}/{file}")}
        if _changed_behind(sets, [file for index, file in recent.items() if index not in gone]):
            gone |= catalogue.files_but_of(set_indices(_names(sets)))
    if not gone:
        return {}
    journal = read_journal(folder)
    sizes = {
        file: _size(f"{folder}/{file}")
        for index, file in gone.items()
        # The set may have come out of the journal between the two looks.
        if not (index in journal and journal[index].reference == file)
    }
    return {file: "is missing" if size is None else "is empty" for file, size in sizes.items() if not size}


def _names(sets: Path) -> list[str]:
    return os.listdir(sets) if sets.is_dir() else []  # noqa: PTH208 - names are all it takes


def _changed_behind(sets: Path, files: Sequence[str]) -> bool:
    """Tell whether the folder changed after the newest of these files was filed."""
    try:
        written_s = max((sets.parent / file).stat().st_mtime for file in files[-1:])
        return sets.stat().st_mtime > written_s + FILED_WITHIN_S
    except (FileNotFoundError, ValueError):
        return True


def _size(path: str) -> int | None:  # thousands of them: a `Path` takes longer than the look
    try:
        return os.stat(path).st_size  # noqa: PTH116
    except FileNotFoundError:
        return None
