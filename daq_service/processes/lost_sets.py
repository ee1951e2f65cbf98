"""Sets that the catalogue counts on and that are gone: seen by a listing, without reading any of them."""

from __future__ import annotations

import os
from heapq import nlargest
from pathlib import Path

from daq_service.archive.journal.reader import read_journal
from daq_service.archive.records import SETS_FOLDER, set_indices
from daq_service.catalogue import Catalogue


def lost_sets(folder: Path, catalogue: Catalogue, *, newest: int | None = None) -> dict[str, str]:
    """Name the files that rows point at and that are missing or empty, and say which of the two.

    Parameters
    ----------
    newest
        Look at the size of so many files only, from the last one backwards: of a year's sets that takes a
        tenth of a second. None: of all.

    Raises
    ------
    CatalogueError, OSError
        The folder cannot be looked at now.
    """
    sets = folder / SETS_FOLDER
    names = os.listdir(sets) if sets.is_dir() else []  # noqa: PTH208 - names are all it takes
    sized = names if newest is None else nlargest(newest, names)
    empty = {name for name in sized if not _has_content(f"{sets}/{name}")}
    gone = catalogue.files_but_of(set_indices([name for name in names if name not in empty]))
    if not gone:
        return {}
    journal = read_journal(folder)
    return {
        file: "is empty" if Path(file).name in empty else "is missing"
        for index, file in gone.items()
        # The set may have come out of the journal between the two looks.
        if not (index in journal and journal[index].reference == file)
        and not _has_content(f"{folder}/{file}")
    }


def _has_content(path: str) -> bool:  # thousands of them: a `Path` takes longer than the look
    try:
        return os.stat(path).st_size > 0  # noqa: PTH116
    except FileNotFoundError:
        return False
