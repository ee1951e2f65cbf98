"""Tiles of whole sets: from a set's records, or from its file."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

from daq_service.archive.reader import FolderSetReader
from daq_service.archive.records import SetRecord, SetReference
from daq_service.archive.waterfall.cells import ALIGNMENTS, Alignment, Planes, accepted, frame_of, of_set
from daq_service.archive.waterfall.tiles import TILES_FOLDER, TileRow, Tiles


def keep_set(folder: Path, experiment: str, record: SetRecord, anchors: Mapping[int, float]) -> None:
    """Add a set to the tiles of its positions; what is there already stays.

    Parameters
    ----------
    experiment
        Names the test (`Tiles.experiment`).
    anchors
        Shot id to the time of its first pulse or echo (`anchors_of`).

    Raises
    ------
    OSError
        The disk refuses.
    """
    for place in record.positions:
        for alignment in ALIGNMENTS:
            tiles = tiles_of(folder, experiment, record, place.position, alignment)
            if tiles is None or tiles.is_kept(record.set_index):
                continue
            tiles.keep(row_of(record, of_set(record, place.position, alignment, anchors, tiles.frame)))


def keep_file(folder: Path, experiment: str, reference: SetReference, anchors: Mapping[int, float]) -> None:
    """Add a stored set to the tiles; of a damaged one the records that can be read.

    Raises
    ------
    OSError, ArchiveError
        It cannot be read, or the disk refuses.
    """
    record = FolderSetReader(folder).read_set(reference, skip_damaged=True)
    keep_set(folder, experiment, record, anchors)


def row_of(record: SetRecord, planes: Planes) -> TileRow:
    """Make the row of a set."""
    index, hour = record.set_index, record.due_h
    return TileRow(n_sets=1, first_set=index, last_set=index, first_h=hour, last_h=hour, planes=planes)


def tiles_of(
    folder: Path, experiment: str, record: SetRecord, position: str, alignment: Alignment
) -> Tiles | None:
    """Tiles whose frame is that of a set's records; None: it has none of the position."""
    taken = accepted(record, position)
    if not taken:
        return None
    return Tiles(
        folder=folder,
        experiment=experiment,
        position=position,
        alignment=alignment,
        frame=frame_of(taken[0].waveform, alignment),
    )


def forget_tiles(folder: Path) -> None:
    """Remove every tile.

    Raises
    ------
    OSError
        One stays.
    """
    if (folder / TILES_FOLDER).exists():
        shutil.rmtree(folder / TILES_FOLDER)
