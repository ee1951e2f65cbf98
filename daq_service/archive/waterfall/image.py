"""The picture of a range of sets and times: from tiles, and where these lack something from the records."""

from __future__ import annotations

import logging
import threading
from collections import OrderedDict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from daq_service.archive.errors import ArchiveError
from daq_service.archive.protocol import SetReader
from daq_service.archive.records import SetReference
from daq_service.archive.waterfall.cells import Alignment, Frame, Planes, coarser, nothing, of_set
from daq_service.archive.waterfall.tile_files import row_of, tiles_of
from daq_service.archive.waterfall.tiles import FACTOR, LEVELS, TileRow, Tiles, joined

log = logging.getLogger(__name__)

SETS_AT_ONCE = 32
"""Sets whose records one picture reads: some tenths of a second."""
MEMORY_BYTES = 64 * 2**20
"""Rows made from records are kept in memory; somebody who asks again goes on from there."""


class Index(Protocol):
    """What a picture asks the catalogue."""

    def n_stored(self, first: int, last: int) -> int:
        """Count the sets of the position that have records, with indices from ``first`` to ``last``."""
        ...

    def file(self, set_index: int) -> SetReference | None:
        """Where the records of a set are; None: it has none."""
        ...

    def anchors(self, set_index: int) -> Mapping[int, float]:
        """Shot id to the time of its first pulse or echo."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """A part of a waterfall: sets ``first`` to ``last``, times from ``from_s`` to ``to_s`` after the anchor.

    ``rows`` and ``columns`` are the most that the picture may have.
    """

    first: int
    last: int
    rows: int
    columns: int
    from_s: float | None = None
    to_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Picture:
    """What is drawn.

    Attributes
    ----------
    frame
        Of the columns.
    row_sets
        Planned sets of a row: a power of two, and a row begins at a multiple of it.
    rows
        In the order of their sets; a row whose sets have no record is left out.
    peaks
        Greatest magnitude of each row over all its cells, those beside the range of times too.
    pending
        Sets that belong into it and were not read yet: ask again.
    unreadable
        Sets whose records are damaged or gone.
    """

    frame: Frame
    row_sets: int
    rows: list[TileRow]
    peaks: list[float]
    pending: int
    unreadable: list[int]


class WaterfallReader:
    """Draws pictures; never writes, so that a folder may be read-only.

    Parameters
    ----------
    archive
        Where records are that no tile has.
    """

    def __init__(self, archive: SetReader) -> None:
        self._archive, self._lock = archive, threading.Lock()
        self._memory: OrderedDict[tuple[str, str, int], TileRow] = OrderedDict()
        self._n_bytes = 0
        self._tiles: dict[tuple[str, str], Tiles] = {}
        self.closing = False

    def close(self) -> None:
        """Read no more records: an answer that is under way ends soon, and tells them as pending."""
        self.closing = True

    def tiles(
        self,
        folder: Path,
        experiment: str,
        position: str,
        alignment: Alignment,
        files: Iterable[SetReference],
    ) -> Tiles | None:
        """Find the tiles of a position by its first records; None: none of these files has one.

        All pictures of the position have this frame; records of another rate are not drawn.
        """
        key = position, alignment
        for file in files if key not in self._tiles else ():
            try:
                found = tiles_of(
                    folder, experiment, self._archive.read_set(file, skip_damaged=True), position, alignment
                )
            except ArchiveError as error:
                log.warning("%s", error)
                continue
            if found is not None:
                self._tiles[key] = found
                break
        return self._tiles.get(key)

    def picture(self, tiles: Tiles, index: Index, wanted: Wanted, less: Planes | None = None) -> Picture:
        """Draw.

        Parameters
        ----------
        less
            Planes that each set's are reduced by before extremes are taken over sets and times: `mean`.
        """
        row_sets = 1
        while wanted.last // row_sets - wanted.first // row_sets >= wanted.rows:
            row_sets *= 2
        frame = _frame(tiles.frame, wanted, may_be_finer=less is None and row_sets == 1)
        reading = _Reading(self, _with_frame(tiles, frame), index)
        level = min((row_sets.bit_length() - 1) // 2, LEVELS - 1)
        by_row: dict[int, list[TileRow]] = {}
        for row in reading.rows(level, wanted.first // FACTOR**level, wanted.last // FACTOR**level):
            by_row.setdefault(row.first_set // row_sets, []).append(row)
        rows = [joined(by_row[number]) for number in sorted(by_row)]
        shift = np.float32(0.0) if less is None else less
        volts = [row.planes - shift for row in rows]
        of = reading.tiles.frame
        return Picture(
            frame=frame,
            row_sets=row_sets,
            rows=[replace(row, planes=coarser(its, of, frame)) for row, its in zip(rows, volts, strict=True)],
            peaks=[float(np.nanmax(np.abs(its), initial=0.0)) for its in volts],
            pending=reading.pending,
            unreadable=reading.unreadable,
        )

    def mean(self, tiles: Tiles, index: Index, sets: Collection[int]) -> tuple[Planes, int, int]:
        """Mean over sets of the least and greatest volts of a cell; of how many sets, and how many wait."""
        reading = _Reading(self, tiles, index)
        rows = [row.planes for one in sets for row in reading.rows(0, one, one)]
        found = np.stack(rows or [nothing(tiles.frame)])
        known = np.isfinite(found)
        total = np.where(known, found, np.float32(0.0)).sum(axis=0, dtype=np.float64)
        count = known.sum(axis=0)
        planes = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
        return planes.astype(np.float32), len(rows), reading.pending

    def made(self, tiles: Tiles, index: Index, set_index: int, file: SetReference) -> TileRow:
        """Make the row of a set from its records.

        Raises
        ------
        ArchiveError
            They cannot be read.
        """
        record = self._archive.read_set(file, skip_damaged=True)
        planes = of_set(record, tiles.position, tiles.alignment, index.anchors(set_index), tiles.frame)
        return row_of(record, planes)

    def remembered(self, tiles: Tiles, set_index: int) -> TileRow | None:
        """Give a row that was made before."""
        with self._lock:
            return self._memory.get((tiles.position, repr((tiles.alignment, tiles.frame)), set_index))

    def remember(self, tiles: Tiles, set_index: int, row: TileRow) -> None:
        """Keep a row for the next picture; the oldest ones go."""
        key = tiles.position, repr((tiles.alignment, tiles.frame)), set_index
        with self._lock:
            if key not in self._memory:  # two requests may have made it
                self._memory[key] = row
                self._n_bytes += row.planes.nbytes
            while self._n_bytes > MEMORY_BYTES:
                self._n_bytes -= self._memory.popitem(last=False)[1].planes.nbytes


class _Reading:
    """The rows of one picture, and what they lack."""

    def __init__(self, reader: WaterfallReader, tiles: Tiles, index: Index) -> None:
        self._reader, self.tiles, self._index = reader, tiles, index
        self._left = SETS_AT_ONCE
        self.pending, self.unreadable = 0, list[int]()

    def rows(self, level: int, first: int, last: int) -> list[TileRow]:
        """Rows of a level, each whole: with all sets that are stored, as far as they could be read."""
        kept = dict(self.tiles.rows(level, first, last))
        found = (self._row(level, number, kept.get(number)) for number in range(first, last + 1))
        return [row for row in found if row is not None]

    def _row(self, level: int, number: int, kept: TileRow | None) -> TileRow | None:
        size = FACTOR**level
        if kept is not None and kept.n_sets == size:
            return kept
        n_stored = self._index.n_stored(number * size, (number + 1) * size - 1)
        if kept is not None and kept.n_sets == n_stored:
            return kept
        if n_stored == 0:
            return None
        if level == 0:
            return self._of_records(number)
        if self._left == 0:
            self.pending += n_stored
            return None
        below = self.rows(level - 1, number * FACTOR, number * FACTOR + FACTOR - 1)
        return joined(below) if below else None

    def _of_records(self, set_index: int) -> TileRow | None:
        remembered = self._reader.remembered(self.tiles, set_index)
        if remembered is not None:
            return remembered
        if self._left == 0 or self._reader.closing:
            self.pending += 1
            return None
        self._left -= 1
        file = self._index.file(set_index)
        if file is None:
            return None
        try:
            row = self._reader.made(self.tiles, self._index, set_index, file)
        except ArchiveError as error:
            log.warning("%s", error)
            self.unreadable.append(set_index)
            return None
        self._reader.remember(self.tiles, set_index, row)
        return row


def _frame(frame: Frame, wanted: Wanted, *, may_be_finer: bool) -> Frame:
    """Columns of a picture: the narrowest of which no more are needed than wanted.

    Two at least: those before and after the anchor, whatever their width.
    """
    few = wanted.last - wanted.first < SETS_AT_ONCE
    width = 1 if few and may_be_finer else frame.width
    while (part := frame.part(wanted.from_s, wanted.to_s, width)).n_cells > max(2, wanted.columns):
        width *= 2
    return part


def _with_frame(tiles: Tiles, frame: Frame) -> Tiles:
    """Tiles of finer cells, where these are wanted: nobody keeps such, they come from the records."""
    return replace(tiles, frame=frame) if frame.width < tiles.frame.width else tiles
