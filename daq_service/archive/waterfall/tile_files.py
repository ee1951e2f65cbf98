"""Write the tiles of complete sets from their records or files."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

from daq_service.archive.reader import FolderSetReader
from daq_service.archive.records import SetReference
from daq_service.archive.waterfall.cells import (
    ALIGNMENTS,
    Alignment,
    Planes,
    build_frame,
    compute_planes,
    select_accepted_records,
)
from daq_service.archive.waterfall.tiles import TILES_FOLDER, TileRow, Tiles
from hardware_drivers.measurement import SetRecord


def write_tiles_of_set(
    folder: Path,
    experiment: str,
    record: SetRecord,
    anchors: Mapping[int, float],
    *,
    complete_blocks_only: bool = False,
) -> None:
    """Write the rows of a set to the tiles of its positions, for each alignment; existing rows stay.

    Parameters
    ----------
    experiment
         Identifier of the test (`Tiles.experiment`).
    anchors
        Shot id to the time in s of its first pulse or echo (`extract_anchors`).
    complete_blocks_only
        For the newest set of a test: see `Tiles.write_row`.

    Raises
    ------
    OSError
        The disk refuses.
    """
    for position in record.positions:
        for alignment in ALIGNMENTS:
            tiles = build_tiles(folder, experiment, record, position.position, alignment)
            if tiles is None or tiles.has_set(record.set_index):
                continue
            planes = compute_planes(record, position.position, alignment, anchors, tiles.frame)
            tiles.write_row(build_tile_row(record, planes), complete_blocks_only=complete_blocks_only)


def write_tiles_of_file(
    folder: Path, experiment: str, reference: SetReference, anchors: Mapping[int, float]
) -> None:
    """Read a stored set and write its rows to the tiles; of a corrupt set the readable records.

    ``anchors`` has the time in s of the first pulse or echo by shot id.

    Raises
    ------
    OSError, ArchiveError
        It cannot be read, or the disk refuses.
    """
    record = FolderSetReader(folder).read_set(reference, skip_damaged=True)
    write_tiles_of_set(folder, experiment, record, anchors)


def build_tile_row(record: SetRecord, planes: Planes) -> TileRow:
    """Build the tile row of one set from its planes: minimum and maximum in V, shape (2, n_cells)."""
    index, hour = record.set_index, record.due_h
    return TileRow(n_sets=1, first_set=index, last_set=index, first_h=hour, last_h=hour, planes=planes)


def build_tiles(
    folder: Path, experiment: str, record: SetRecord, position: str, alignment: Alignment
) -> Tiles | None:
    """Build the tiles with the frame of a set's first accepted record at a position; None without one.

    Writes nothing.
    """
    records = select_accepted_records(record, position)
    if not records:
        return None
    return Tiles(
        folder=folder,
        experiment=experiment,
        position=position,
        alignment=alignment,
        frame=build_frame(records[0].waveform, alignment),
    )


def remove_tiles(folder: Path) -> None:
    """Delete the folder of all tiles of a test, if it exists.

    Raises
    ------
    OSError
         A tile cannot be removed.
    """
    if (folder / TILES_FOLDER).exists():
        shutil.rmtree(folder / TILES_FOLDER)
