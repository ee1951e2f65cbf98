"""Detection of missing set files of the catalogue from a folder listing, without reading a file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from daq_service.archive.journal.reader import read_journal
from daq_service.archive.records import SETS_FOLDER, parse_set_keys
from daq_service.catalogue import Catalogue

FILED_WITHIN_S = 2.0
"""Longest time from the write of a file to its final name and the time stamp of its folder."""


def find_lost_sets(folder: Path, catalogue: Catalogue, *, newest_rows: int | None = None) -> dict[str, str]:
    """Find the set files of the catalogue that are lost: ``is missing`` or ``is empty`` by their path.

    Paths count from ``folder``. Sets that are still in the journal are not lost.

    Parameters
    ----------
    newest_rows
        Check the files of only this many of the newest rows, and the names of all if the folder has
        changed since: this takes the same time in every year of a test. None: check all rows.

    Raises
    ------
    CatalogueError, OSError
        Catalogue, folder or journal cannot be read now.
    """
    sets = folder / SETS_FOLDER
    if newest_rows is None:
        missing_files = catalogue.list_files_except(
            parse_set_keys([name for name in _list_file_names(sets) if _get_file_size(f"{sets}/{name}")])
        )
    else:
        recent = catalogue.list_newest_files(newest_rows)
        missing_files = {key: file for key, file in recent.items() if not _get_file_size(f"{folder}/{file}")}
        if _has_changed_since(sets, [file for key, file in recent.items() if key not in missing_files]):
            missing_files |= catalogue.list_files_except(parse_set_keys(_list_file_names(sets)))
    if not missing_files:
        return {}
    journal = read_journal(folder)
    sizes = {
        file: _get_file_size(f"{folder}/{file}")
        for key, file in missing_files.items()
        # The set may have come out of the journal between the two reads.
        if not (key in journal and journal[key].reference == file)
    }
    return {file: "is missing" if size is None else "is empty" for file, size in sizes.items() if not size}


def _list_file_names(sets: Path) -> list[str]:
    """Return the names in the folder ``sets``, in any order; empty if there is no such folder."""
    return os.listdir(sets) if sets.is_dir() else []  # noqa: PTH208 - only names are needed


def _has_changed_since(sets: Path, files: Sequence[str]) -> bool:
    """Return whether the folder changed more than 2 s after the last file of a list was written.

    The paths of the files count from the data folder. True if there are no files or the last one is missing.
    """
    try:
        written_s = max((sets.parent / file).stat().st_mtime for file in files[-1:])
        return sets.stat().st_mtime > written_s + FILED_WITHIN_S
    except (FileNotFoundError, ValueError):
        return True


def _get_file_size(path: str) -> int | None:  # thousands of them: a `Path` takes longer than the call
    """Return the size of a file in bytes; None if it is missing. Other OSErrors are raised."""
    try:
        return os.stat(path).st_size  # noqa: PTH116
    except FileNotFoundError:
        return None
