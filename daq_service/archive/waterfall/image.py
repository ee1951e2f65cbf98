"""Draw a range of sets and times from tiles, and from the records where tiles are incomplete."""

from __future__ import annotations

import logging
import threading
from collections import OrderedDict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from analysis.statistics.levels import FACTOR, choose_sets_per_step, list_finer_blocks
from daq_service.archive.errors import ArchiveError
from daq_service.archive.protocol import SetReader
from daq_service.archive.records import SetReference
from daq_service.archive.waterfall.cells import Alignment, Frame, Planes, coarsen, compute_planes, new_planes
from daq_service.archive.waterfall.tile_files import build_tile_row, build_tiles
from daq_service.archive.waterfall.tiles import WIDTHS, TileRow, Tiles, join_tile_rows

log = logging.getLogger(__name__)

SETS_AT_ONCE = 32
"""Maximum number of sets whose records are read for one figure: some tenths of a second."""
MEMORY_BYTES = 64 * 2**20
"""Size of the cache of rows that were computed from records, for the next request."""


class Index(Protocol):
    """Queries of a waterfall to the catalogue."""

    def count_stored_sets(self, first: int, last: int) -> int:
        """Count the sets of the position that have records, with indices from first to last (included)."""
        ...

    def file(self, set_index: int) -> SetReference | None:
        """Return the reference of the file with a set's records; None if it has none."""
        ...

    def read_anchors(self, set_index: int) -> Mapping[int, float]:
        """Return the time of the first pulse or echo in s after the trigger by shot id.

        Shots without one are omitted.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """Requested part of a waterfall: sets ``first`` to ``last``, times from ``from_s`` to ``to_s``.

    Times are relative to the anchor; ``rows`` and ``columns`` are the maximum size.
    """

    first: int
    last: int
    rows: int
    columns: int
    from_s: float | None = None
    to_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Picture:
    """Rows and columns to draw.

    Attributes
    ----------
    frame
         Frame of the columns.
    row_sets
        Number of planned sets per row: a power of two; rows start at multiples of it.
    rows
        Rows in the order of their sets; rows without records are left out.
    peaks
        Maximum magnitude of each row over all its cells, also outside the range of times.
    pending
        Number of sets that were not read yet; repeat the request.
    unreadable
        Sets whose records are corrupt or missing.
    """

    frame: Frame
    row_sets: int
    rows: list[TileRow]
    peaks: list[float]
    pending: int
    unreadable: list[int]


class WaterfallReader:
    """Computes waterfall figures; never writes, so the folder may be read-only.

    Parameters
    ----------
    archive
        Source of records that no tile has.
    """

    def __init__(self, archive: SetReader) -> None:
        """Prepare to read records from an archive; the cache of rows is empty."""
        self._archive, self._lock = archive, threading.Lock()
        self._memory: OrderedDict[tuple[str, str, int], TileRow] = OrderedDict()
        self._n_bytes = 0
        self._tiles: dict[tuple[str, str], Tiles] = {}
        self.closing = False

    def close(self) -> None:
        """Stop reading records: a running request soon ends and counts the remaining sets as pending."""
        self.closing = True

    def tiles(
        self,
        folder: Path,
        experiment: str,
        position: str,
        alignment: Alignment,
        files: Iterable[SetReference],
    ) -> Tiles | None:
        """Build the tiles of a position with the frame of its first readable records.

        Returns None if no file has any. The result is kept for later calls: all figures of the position have
        this frame, and records of another rate are not drawn. Unreadable files are logged as warnings.
        """
        key = position, alignment
        for file in files if key not in self._tiles else ():
            try:
                tiles = build_tiles(
                    folder, experiment, self._archive.read_set(file, skip_damaged=True), position, alignment
                )
            except ArchiveError as error:
                log.warning("%s", error)
                continue
            if tiles is not None:
                self._tiles[key] = tiles
                break
        return self._tiles.get(key)

    def compute_figure(
        self, tiles: Tiles, index: Index, wanted: Wanted, reference: Planes | None = None
    ) -> Picture:
        """Compute the figure of the requested part, a row per 1, 2, 4, ... sets.

        Of the sets without tile at most 32 are read now; the others are counted as pending, unreadable ones
        listed.

        Parameters
        ----------
        reference
            Planes in V that are subtracted from each row before extremes are taken over cells: `mean`.
        """
        row_sets = choose_sets_per_step(wanted.first, wanted.last, wanted.rows)
        frame = _choose_column_frame(tiles.frame, wanted, may_be_finer=reference is None and row_sets == 1)
        if frame.width < tiles.frame.width:  # finer cells are computed from records, not stored
            tiles = replace(tiles, frame=frame)
        reading = _Reading(self, tiles, index)
        width = max(width for width in WIDTHS if width <= row_sets)
        rows_by_number: dict[int, list[TileRow]] = {}
        for row in reading.rows(width, range(wanted.first // width, wanted.last // width + 1)):
            rows_by_number.setdefault(row.first_set // row_sets, []).append(row)
        rows = [join_tile_rows(rows_by_number[number]) for number in sorted(rows_by_number)]
        offset = np.float32(0.0) if reference is None else reference
        volts = [row.planes - offset for row in rows]
        tile_frame = reading.tiles.frame
        return Picture(
            frame=frame,
            row_sets=row_sets,
            rows=[
                replace(row, planes=coarsen(planes, tile_frame, frame))
                for row, planes in zip(rows, volts, strict=True)
            ],
            peaks=[float(np.nanmax(np.abs(planes), initial=0.0)) for planes in volts],
            pending=reading.pending,
            unreadable=reading.unreadable,
        )

    def mean(self, tiles: Tiles, index: Index, sets: Collection[int]) -> tuple[Planes, int, int]:
        """Compute mean minimum and mean maximum in V of each cell over sets, shape (2, n_cells).

        Returns the planes and the numbers of read and pending sets. Cells without a sample are NaN; at most
        32 sets without tile are read.
        """
        reading = _Reading(self, tiles, index)
        rows = [row.planes for set_index in sets for row in reading.rows(1, range(set_index, set_index + 1))]
        stacked = np.stack(rows or [new_planes(tiles.frame)])
        is_finite = np.isfinite(stacked)
        total = np.where(is_finite, stacked, np.float32(0.0)).sum(axis=0, dtype=np.float64)
        count = is_finite.sum(axis=0)
        planes = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
        return planes.astype(np.float32), len(rows), reading.pending

    def compute_row(self, tiles: Tiles, index: Index, set_index: int, file: SetReference) -> TileRow:
        """Compute the row of a set from its readable records in ``file``, without the cache.

        Raises
        ------
        ArchiveError
            They cannot be read.
        """
        record = self._archive.read_set(file, skip_damaged=True)
        planes = compute_planes(
            record, tiles.position, tiles.alignment, index.read_anchors(set_index), tiles.frame
        )
        return build_tile_row(record, planes)

    def find_cached_row(self, tiles: Tiles, set_index: int) -> TileRow | None:
        """Find the cached row of a set for the frame of the tiles; None if the cache lacks it."""
        with self._lock:
            return self._memory.get((tiles.position, repr((tiles.alignment, tiles.frame)), set_index))

    def cache_row(self, tiles: Tiles, set_index: int, row: TileRow) -> None:
        """Add a row to the cache, unless it has one of this set; drop the oldest rows above 64 MiB."""
        key = tiles.position, repr((tiles.alignment, tiles.frame)), set_index
        with self._lock:
            if key not in self._memory:  # two requests may have computed it
                self._memory[key] = row
                self._n_bytes += row.planes.nbytes
            while self._n_bytes > MEMORY_BYTES:
                self._n_bytes -= self._memory.popitem(last=False)[1].planes.nbytes


class _Reading:
    """Reads the rows of one figure and counts the missing ones."""

    def __init__(self, reader: WaterfallReader, tiles: Tiles, index: Index) -> None:
        """Prepare the reading of one figure: at most 32 sets from records."""
        self._reader, self.tiles, self._index = reader, tiles, index
        self._left = SETS_AT_ONCE
        self.pending, self.unreadable = 0, list[int]()

    def rows(self, width: int, numbers: range) -> list[TileRow]:
        """Read the rows of ``width`` sets with these numbers, in order.

        Rows that have no set or cannot be read are omitted. Sets that are not read now are counted in
        ``pending``, corrupt ones listed in ``unreadable``.
        """
        tile_rows = dict(self.tiles.rows(width, numbers))
        rows = (self._read_row(width, number, tile_rows.get(number)) for number in numbers)
        return [row for row in rows if row is not None]

    def _read_row(self, width: int, number: int, tile_row: TileRow | None) -> TileRow | None:
        """Return the tile's row if it has all stored sets, else join the row from the next finer level.

        Returns None if no set of it is stored or can be read now. At the finest level the records are read.
        """
        if tile_row is not None and tile_row.n_sets == width:
            return tile_row
        n_stored = self._index.count_stored_sets(number * width, (number + 1) * width - 1)
        if tile_row is not None and tile_row.n_sets == n_stored:
            return tile_row
        if n_stored == 0:
            return None
        if width == 1:
            return self._read_set_row(number)
        if self._left == 0:
            self.pending += n_stored
            return None
        finer_rows = self.rows(width // FACTOR, list_finer_blocks(number))
        return join_tile_rows(finer_rows) if finer_rows else None

    def _read_set_row(self, set_index: int) -> TileRow | None:
        """Read the row of a set from the cache or its records; None if it has none, is corrupt or pending.

        Corrupt sets are logged as warnings.
        """
        cached_row = self._reader.find_cached_row(self.tiles, set_index)
        if cached_row is not None:
            return cached_row
        if self._left == 0 or self._reader.closing:
            self.pending += 1
            return None
        self._left -= 1
        file = self._index.file(set_index)
        if file is None:
            return None
        try:
            row = self._reader.compute_row(self.tiles, self._index, set_index, file)
        except ArchiveError as error:
            log.warning("%s", error)
            self.unreadable.append(set_index)
            return None
        self._reader.cache_row(self.tiles, set_index, row)
        return row


def _choose_column_frame(frame: Frame, wanted: Wanted, *, may_be_finer: bool) -> Frame:
    """Choose the frame of a figure's columns: the narrowest cells that do not exceed the requested number.

    Two columns are always allowed: before and after the anchor. ``may_be_finer`` permits, for fewer than 32
    sets, cells narrower than those of tiles.
    """
    is_short_range = wanted.last - wanted.first < SETS_AT_ONCE
    width = 1 if is_short_range and may_be_finer else frame.width
    while (part := frame.part(wanted.from_s, wanted.to_s, width)).n_cells > max(2, wanted.columns):
        width *= 2
    return part
