"""Read and write cached waterfall rows in tile files, in levels of 1, 4, 16, ... sets per row (the width).

``tiles/{position}/{alignment}/{sets of a row}-{number}.tile`` holds 64 rows in slots of one size after a
header with experiment, position and frame. Each slot has a CRC-32 and its number of sets. A reader skips rows
that are missing, truncated, incomplete or of another experiment, and uses the finer rows or the records. One
process at a time writes, for the owner of the recorder's lock.
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
from itertools import pairwise
from pathlib import Path

import numpy as np

from analysis.statistics.levels import FACTOR, get_level_widths, list_finer_blocks
from daq_service.archive.waterfall.cells import Alignment, Frame, Planes, merge_planes

log = logging.getLogger(__name__)

TILES_FOLDER = "tiles"
ROWS_OF_A_TILE = 64
WIDTHS = get_level_widths(1, 4096)
"""Sets per row at each level; at the coarsest one a million sets are 245 rows."""
FORMAT = 1
_HEADER_BYTES = 512
_FACTS = struct.Struct("<IIqqqdd16x")
"""CRC-32 of the rest, padding, n_sets, first_set, last_set, first_h, last_h."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TileRow:
    """One row of a waterfall: extremes of the records of adjacent sets of a position.

    Attributes
    ----------
    n_sets
         Number of sets in it.
    planes
        Shape (2, n_cells) in V, minimum and maximum; NaN if there is no sample.
    """

    n_sets: int
    first_set: int
    last_set: int
    first_h: float
    last_h: float
    planes: Planes


def join_tile_rows(rows: Sequence[TileRow]) -> TileRow:
    """Combine one or more rows, given in the order of their sets, to one row with their common extremes.

    Raises IndexError without a row.
    """
    return TileRow(
        n_sets=sum(row.n_sets for row in rows),
        first_set=rows[0].first_set,
        last_set=rows[-1].last_set,
        first_h=rows[0].first_h,
        last_h=rows[-1].last_h,
        planes=merge_planes([row.planes for row in rows]),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Tiles:
    """Tiles of a position at one alignment.

    Parameters
    ----------
    folder
        The data folder.
    experiment
        Identifier of the test, so that tiles of another test are ignored.
    """

    folder: Path
    experiment: str
    position: str
    alignment: Alignment
    frame: Frame

    def rows(self, width: int, numbers: range) -> Iterator[tuple[int, TileRow]]:
        """Yield number and content of the sound rows of ``width`` sets among consecutive numbers, in order.

        Missing, corrupt and unreadable rows are left out, not raised.
        """
        for tile in sorted({number // ROWS_OF_A_TILE for number in numbers}):
            start = max(numbers.start, tile * ROWS_OF_A_TILE)
            end = min(numbers.stop, (tile + 1) * ROWS_OF_A_TILE)
            yield from self._decode_rows(width, start, self._read_slots(width, tile, start, end))

    def _decode_rows(self, width: int, start: int, content: memoryview) -> Iterator[tuple[int, TileRow]]:
        """Yield number and row of each intact row in the bytes of slots, the first with number ``start``."""
        for offset in range(0, len(content), self._slot_bytes):
            number = start + offset // self._slot_bytes
            row = self._decode_row(content[offset : offset + self._slot_bytes])
            if row is not None and row.first_set // width == number:
                yield number, row

    def row(self, width: int, number: int) -> TileRow | None:
        """Read the row ``number`` of ``width`` sets; None if there is no sound one."""
        return next((row for _, row in self.rows(width, range(number, number + 1))), None)

    def has_set(self, set_index: int) -> bool:
        """Return whether a set has its row, and all coarser rows count the sets of their four finer ones.

        A missing or corrupt row gives False.
        """
        row = self.row(1, set_index)
        for finer_width, width in pairwise(WIDTHS):
            if row is None:
                return False
            number = set_index // width
            n_below = sum(finer.n_sets for _, finer in self.rows(finer_width, list_finer_blocks(number)))
            row = self.row(width, number)
            if row is not None and row.n_sets != n_below:
                return False
        return row is not None

    def write_row(self, row: TileRow, *, complete_blocks_only: bool = False) -> None:
        """Write the row of a set and update the rows of 4, 16, ... sets above it; replace existing rows.

        Parameters
        ----------
        complete_blocks_only
            Update a coarser row only with the last of its finer ones. Until then readers join the finer ones.

        Raises
        ------
        OSError
            The disk refuses; written rows are sound, and the number of sets shows incomplete ones.
        """
        for width in WIDTHS:
            number = row.first_set // width
            neighbors = self._write_slot(width, number, row)
            if complete_blocks_only and number % FACTOR != FACTOR - 1:
                return
            finer_rows = dict(self._decode_rows(width, number - number % FACTOR, neighbors)) | {number: row}
            row = join_tile_rows([finer_rows[index] for index in sorted(finer_rows)])

    # Files ----------------------------------------------------------------------------------------

    @property
    def _slot_bytes(self) -> int:
        """Return the size in bytes of the slot of a row in a tile."""
        return compute_slot_bytes(self.frame.n_cells)

    def _build_tile_path(self, width: int, tile: int) -> Path:
        """Build the path of the file of a tile, which may be missing."""
        return self.folder / TILES_FOLDER / self.position / self.alignment / _format_tile_name(width, tile)

    def _read_slots(self, width: int, tile: int, start: int, end: int) -> memoryview:
        """Read the bytes of the slots ``start`` to ``end`` (excluded) of a tile, as many as exist.

        There are none if the tile is missing, unreadable, or of another test or frame; errors are not raised.
        """
        path = self._build_tile_path(width, tile)
        try:
            with path.open("rb") as file:
                if file.read(_HEADER_BYTES) != _build_header(self):
                    return memoryview(b"")
                file.seek(self._compute_offset(start))
                return memoryview(file.read((end - start) * self._slot_bytes))
        except FileNotFoundError:
            return memoryview(b"")
        except OSError as error:  # a cache: readers work without it
            log.debug("%s cannot be read now: %s", path, error)
            return memoryview(b"")

    def _compute_offset(self, number: int) -> int:
        """Compute the byte offset of the slot of row ``number`` in its tile."""
        return _HEADER_BYTES + number % ROWS_OF_A_TILE * self._slot_bytes

    def _decode_row(self, slot: memoryview) -> TileRow | None:
        """Decode the row of a slot; None if it is truncated, empty or does not match its CRC-32.

        Its planes are a view of the slot, shape (2, n_cells) in V.
        """
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

    def _write_slot(self, width: int, number: int, row: TileRow) -> memoryview:
        """Write row ``number`` of a level to its slot; create the tile, or replace one of another test.

        Returns the bytes of the group of four slots around it as they were before. Raises OSError.
        """
        facts = (0, 0, row.n_sets, row.first_set, row.last_set, row.first_h, row.last_h)
        slot = bytearray(_FACTS.pack(*facts) + row.planes.astype("<f4").tobytes())
        struct.pack_into("<I", slot, 0, zlib.crc32(memoryview(slot)[4:]))
        path = self._build_tile_path(width, number // ROWS_OF_A_TILE)
        if not path.parent.is_dir():
            path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("r+b" if path.exists() else "x+b") as file:
            if file.read(_HEADER_BYTES) != _build_header(self):
                # New, truncated, or not a tile of this test: start again.
                file.truncate(0)
                file.seek(0)
                file.write(_build_header(self))
            file.seek(self._compute_offset(number - number % FACTOR))
            neighbors = file.read(FACTOR * self._slot_bytes)
            file.seek(self._compute_offset(number))
            file.write(slot)
        return memoryview(neighbors)


def _format_tile_name(width: int, tile: int) -> str:
    """Format the file name of a tile, such as ``0001-000000.tile``, from sets per row and number."""
    return f"{width:04d}-{tile:06d}.tile"


@lru_cache(maxsize=64)
def _build_header(tiles: Tiles) -> bytes:
    """Build the header of the tiles of a position: JSON padded to 512 bytes; the 64 last are cached."""
    metadata = {
        "solimon_tiles": FORMAT,
        "experiment": tiles.experiment,
        "position": tiles.position,
        "alignment": tiles.alignment,
        **asdict(tiles.frame),
    }
    return json.dumps(metadata, separators=(",", ":")).encode().ljust(_HEADER_BYTES)


def compute_slot_bytes(n_cells: int) -> int:
    """Compute the size in bytes of a row in its tile: 64, and 8 per cell."""
    return _FACTS.size + 2 * 4 * n_cells


def estimate_tile_bytes(n_cells: int, n_sets: int) -> int:
    """Estimate the size in bytes of the tiles of one position and alignment after ``n_sets`` sets."""
    rows = [math.ceil(n_sets / width) for width in WIDTHS]
    return sum(math.ceil(n / ROWS_OF_A_TILE) * _HEADER_BYTES + n * compute_slot_bytes(n_cells) for n in rows)


def list_tile_cells(folder: Path) -> list[int]:
    """List the number of cells per row of each position and alignment with tiles; skip unreadable tiles."""
    n_cells = []
    for path in (folder / TILES_FOLDER).glob(f"*/*/{_format_tile_name(1, 0)}"):
        try:
            with path.open("rb") as file:
                n_cells.append(int(json.loads(file.read(_HEADER_BYTES))["n_cells"]))
        except (OSError, ValueError, LookupError) as error:  # a cache: readers work without it
            log.debug("%s cannot be read now: %s", path, error)
    return n_cells


def sum_tile_bytes(folder: Path) -> int:
    """Sum the sizes of all tile files of a data folder in bytes; 0 without tiles.

    Raises OSError if a file disappears meanwhile.
    """
    return sum(path.stat().st_size for path in (folder / TILES_FOLDER).rglob("*.tile"))
