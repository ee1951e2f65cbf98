"""Sets that the catalogue counts on and that are gone: seen by a listing, without reading any of them."""

from __future__ import annotations

import os
from pathlib import Path

from daq_service.archive.journal.reader import read_journal
from daq_service.archive.records import SETS_FOLDER, referenced_sets
from daq_service.catalogue import Catalogue


def lost_sets(folder: Path, catalogue: Catalogue) -> dict[str, str]:
    """Name the files that rows point at and that are missing or empty, and say which of the two.

    Raises
    ------
    CatalogueError, OSError
        The folder cannot be looked at now.
    """
    sizes = {}
    if (folder / SETS_FOLDER).is_dir():
        with os.scandir(folder / SETS_FOLDER) as entries:
            sizes = {entry.name: entry.stat().st_size for entry in entries}
    there = referenced_sets(name for name, size in sizes.items() if size)
    gone = catalogue.files_but_of(there.keys())
    if not gone:
        return {}
    journal = read_journal(folder)
    return {
        file: "is empty" if Path(file).name in sizes else "is missing"
        for index, file in gone.items()
        # The set may have come out of the journal between the two looks.
        if not (index in journal and journal[index].reference == file) and not _has_content(folder / file)
    }


def _has_content(path: Path) -> bool:
    return path.exists() and path.stat().st_size > 0
