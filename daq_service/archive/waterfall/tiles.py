"""Rows of a waterfall kept in files, in levels of 1, 4, 16, ... sets a row: a cache, a hint.

``tiles/{position}/{alignment}/{sets of a row}-{number}.tile`` holds 64 rows in slots of one size, behind a
header that says of which experiment, position and frame they are. Each slot has a CRC-32 and counts its sets.
Whatever is absent, torn, of another experiment or not complete is passed over by a reader, who takes the
rows below, at last the records themselves. One process at a time writes, for the owner of the
recorder's lock.
"""

from __future__ import annotations

import json
import logging
import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from daq_service.archive.waterfall.cells import Alignment, Frame, Planes, merged

log = logging.getLogger(__name__)

TILES_FOLDER = "tiles"
ROWS_OF_A_TILE = 64
FACTOR = 4
LEVELS = 7
"""The coarsest row has 4,096 sets: a million sets are 245 rows."""
FORMAT = 1
_HEADER_BYTES = 512
_FACTS = struct.Struct("<IIqqqdd16x")
"""CRC-32 of what follows it, nothing, n_sets, first_set, last_set, first_h, last_h."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TileRow:
    """One row of a picture: the extremes of the records of some neighbouring sets of a position.

    Attributes
    ----------
    n_sets
        Sets whose records are in it.
    planes
        Shape (2, n_cells) in V, least and greatest; NaN where there is no sample.
    """

    n_sets: int
    first_set: int
    last_set: int
    first_h: float
    last_h: float
    planes: Planes


def joined(rows: Sequence[TileRow]) -> TileRow:
    """Make one row of several, in the order of their sets."""
    return TileRow(
        n_sets=sum(row.n_sets for row in rows),
        first_set=rows[0].first_set,
        last_set=rows[-1].last_set,
        first_h=rows[0].first_h,
        last_h=rows[-1].last_h,
        planes=merged([row.planes for row in rows]),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Tiles:
    """The tiles of a position at one alignment.

    Parameters
    ----------
    folder
        The data folder.
    experiment
        Names the test, so that tiles of another one are not taken for these.
    """

    folder: Path
    experiment: str
    position: str
    alignment: Alignment
    frame: Frame

    def rows(self, level: int, first: int, last: int) -> Iterator[tuple[int, TileRow]]:
        """Read the sound rows of a level with numbers from ``first`` to ``last``, where there are such."""
        for tile in range(first // ROWS_OF_A_TILE, last // ROWS_OF_A_TILE + 1):
            begin = max(first, tile * ROWS_OF_A_TILE)
            end = min(last + 1, (tile + 1) * ROWS_OF_A_TILE)
            content = self._read(level, tile, begin, end)
            for number in range(begin, end):
                slot = content[(number - begin) * self._slot_bytes :][: self._slot_bytes]
                row = self._row(slot)
                if row is not None and row.first_set // FACTOR**level == number:
                    yield number, row

    def row(self, level: int, number: int) -> TileRow | None:
        """Read one row; None: there is none that is sound."""
        return next((row for _, row in self.rows(level, number, number)), None)

    def is_kept(self, set_index: int) -> bool:
        """Whether a set has its row, and each row above counts what the four below have."""
        row = self.row(0, set_index)
        for level in range(1, LEVELS):
            if row is None:
                return False
            number = set_index // FACTOR**level
            below = self.rows(level - 1, number * FACTOR, number * FACTOR + FACTOR - 1)
            n_below = sum(one.n_sets for _, one in below)
            row = self.row(level, number)
            if row is not None and row.n_sets != n_below:
                return False
        return row is not None

    def keep(self, row: TileRow) -> None:
        """Write the row of a set, and those above it anew from the four below each.

        Raises
        ------
        OSError
            The disk refuses; what was written is sound, and what is incomplete tells by its count.
        """
        for level in range(LEVELS):
            number = row.first_set // FACTOR**level
            self._write(level, number, row)
            first = number - number % FACTOR
            below = dict(self.rows(level, first, first + FACTOR - 1)) | {number: row}
            row = joined([below[index] for index in sorted(below)])

    # Files ----------------------------------------------------------------------------------------

    @property
    def _slot_bytes(self) -> int:
        return slot_bytes(self.frame.n_cells)

    def _path(self, level: int, tile: int) -> Path:
        return self.folder / TILES_FOLDER / self.position / self.alignment / _name(level, tile)

    def _read(self, level: int, tile: int, begin: int, end: int) -> memoryview:
        """Bytes of slots, as many as there are; none of a tile that is not one of these."""
        path = self._path(level, tile)
        try:
            with path.open("rb") as file:
                if file.read(_HEADER_BYTES) != _header(self):
                    return memoryview(b"")
                file.seek(self._offset(begin))
                return memoryview(file.read((end - begin) * self._slot_bytes))
        except FileNotFoundError:
            return memoryview(b"")
        except OSError as error:  # a hint: whoever draws goes on without it
            log.debug("%s cannot be read now: %s", path, error)
            return memoryview(b"")

    def _offset(self, number: int) -> int:
        return _HEADER_BYTES + number % ROWS_OF_A_TILE * self._slot_bytes

    def _row(self, slot: memoryview) -> TileRow | None:
        if len(slot) < self._slot_bytes:
            return None
        crc32, _, n_sets, first_set, last_set, first_h, last_h = _FACTS.unpack_from(slot)
        if n_sets < 1 or zlib.crc32(slot[4:]) != crc32:
            return None
        return TileRow(
            n_sets=n_sets,
            first_set=first_set,
            last_set=last_set,
            first_h=first_h,
            last_h=last_h,
            planes=np.frombuffer(slot, "<f4", offset=_FACTS.size).reshape(2, -1),
        )

    def _write(self, level: int, number: int, row: TileRow) -> None:
        facts = (0, 0, row.n_sets, row.first_set, row.last_set, row.first_h, row.last_h)
        slot = bytearray(_FACTS.pack(*facts) + row.planes.astype("<f4").tobytes())
        struct.pack_into("<I", slot, 0, zlib.crc32(memoryview(slot)[4:]))
        path = self._path(level, number // ROWS_OF_A_TILE)
        if not path.parent.is_dir():
            path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("r+b" if path.exists() else "x+b") as file:
            if file.read(_HEADER_BYTES) != _header(self):
                # New, torn, or of something else: nothing of it is ours.
                file.truncate(0)
                file.seek(0)
                file.write(_header(self))
            file.seek(self._offset(number))
            file.write(slot)


def _name(level: int, tile: int) -> str:
    return f"{FACTOR**level:04d}-{tile:06d}.tile"


@lru_cache(maxsize=64)
def _header(tiles: Tiles) -> bytes:
    told = {
        "solimon_tiles": FORMAT,
        "experiment": tiles.experiment,
        "position": tiles.position,
        "alignment": tiles.alignment,
        **asdict(tiles.frame),
    }
    return json.dumps(told, separators=(",", ":")).encode().ljust(_HEADER_BYTES)


def slot_bytes(n_cells: int) -> int:
    """Bytes of a row."""
    return _FACTS.size + 2 * 4 * n_cells


def planned_bytes(n_cells: int, n_sets: int) -> int:
    """Bytes of the tiles of a position at one alignment after so many sets."""
    rows = [math.ceil(n_sets / FACTOR**level) for level in range(LEVELS)]
    return sum(math.ceil(n / ROWS_OF_A_TILE) * _HEADER_BYTES + n * slot_bytes(n_cells) for n in rows)


def kept_cells(folder: Path) -> list[int]:
    """Cells of a row of each position and alignment that has tiles; what cannot be read is left out."""
    found = []
    for path in (folder / TILES_FOLDER).glob(f"*/*/{_name(0, 0)}"):
        try:
            with path.open("rb") as file:
                found.append(int(json.loads(file.read(_HEADER_BYTES))["n_cells"]))
        except (OSError, ValueError, LookupError) as error:  # a hint: whoever draws goes on without it
            log.debug("%s cannot be read now: %s", path, error)
    return found


def n_bytes(folder: Path) -> int:
    """Bytes of all tiles of a data folder."""
    return sum(path.stat().st_size for path in (folder / TILES_FOLDER).rglob("*.tile"))
