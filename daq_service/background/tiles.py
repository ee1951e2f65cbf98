"""Tiles of the waterfall grow with the test, in the worker's process; trouble costs the tiles alone.

A set is added while its file is made (`tile_record`); what older versions, a full volume or a damaged tile
left out follows while nothing is due.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path

from daq_service.archive import Results, SetRecord, SetReference
from daq_service.archive.waterfall.cells import anchors_of
from daq_service.archive.waterfall.tile_files import forget_tiles, write_tiles_of_file, write_tiles_of_set
from daq_service.background.finalize_sets import SetFinalizer
from daq_service.background.verification import QUIET_S
from daq_service.errors import StorageError
from hardware_drivers.measurement import PLANNED_SETS

log = logging.getLogger(__name__)

EVERY_S, SETS_A_TURN = 10.0, 4
"""Some hundredths of a second each: about one per cent of a core."""


def tile_record(folder: Path, experiment: str, anchors: Mapping[int, float], record: SetRecord) -> str:
    """Add a set at hand to the tiles; return what kept it from them, empty: nothing."""
    if record.set_index >= PLANNED_SETS:
        return ""
    try:
        write_tiles_of_set(folder, experiment, record, anchors)
    except Exception as error:  # noqa: BLE001 - a cache; whatever it meets, the test goes on
        return f"the tiles of the waterfall lack a set: {error!r}"
    return ""


def tiled(folder: Path, experiment: str, sets: Sequence[tuple[str, Results]]) -> str:
    """Add stored sets to the tiles; return what kept one from it, empty: nothing."""
    told = ""
    for file, results in sets:
        try:
            write_tiles_of_file(folder, experiment, SetReference(file), anchors_of(results))
        except Exception as error:  # noqa: BLE001 - a cache; whatever it meets, the test goes on
            told = repr(error)
    return told


def tiles_again(
    folder: Path,
    experiment: str,
    files: Mapping[int, str],
    results: Callable[[int], Results],
    progress: Callable[[int, int], None],
) -> list[str]:
    """Make the tiles of a folder anew; what could not be made is returned in words."""
    try:
        forget_tiles(folder)
    except OSError as error:
        return [f"the old tiles stay: {error}"]
    told = []
    for number, (set_index, file) in enumerate(_of_the_plan(files).items()):
        if why := tiled(folder, experiment, [(file, results(set_index))]):
            told.append(f"{file}: {why}")
        progress(number + 1, len(files))
    return told


def _of_the_plan(files: Mapping[int, str]) -> dict[int, str]:
    """Leave out what was struck beside the plan: it has no place in the picture."""
    return {index: file for index, file in files.items() if index < PLANNED_SETS}


class TileMaker:
    """Adds the sets that the tiles lack, while nothing is due.

    Parameters
    ----------
    compaction
        Whose worker does it, when it has no files to make.
    files, results
        The files of all sets by index; what was computed of one.
    has_room
        Whether the volume has room for a cache.
    """

    def __init__(
        self,
        folder: Path,
        experiment: str,
        compaction: SetFinalizer,
        files: Callable[[], Mapping[int, str]],
        results: Callable[[int], Results],
        *,
        has_room: Callable[[], bool] = lambda: True,
        mono_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._folder, self._experiment, self._compaction = folder, experiment, compaction
        self._files, self._results, self._has_room, self._mono_s = files, results, has_room, mono_s
        self._round: list[tuple[int, str]] = []
        self._running: Future[str] | None = None
        self._next_s = mono_s()
        self._told = ""

    def work(self, free_s: float) -> None:
        """Take back what is done, and go on.

        Parameters
        ----------
        free_s
            Time until the next set is due.
        """
        if self._running is not None:
            if not self._running.done():
                return
            self._take_back(self._running)
            self._running = None
        free = free_s > QUIET_S and not self._compaction.waits
        if free and self._has_room() and self._mono_s() >= self._next_s:
            self._next_s = self._mono_s() + EVERY_S
            self._begin(self._of_the_round())

    def _of_the_round(self) -> list[tuple[int, str]]:
        """Choose sets of which nobody knows whether the tiles have them; the newest ones come first."""
        if not self._round:
            self._round = sorted(_of_the_plan(self._files()).items())
        some, self._round = self._round[-SETS_A_TURN:], self._round[:-SETS_A_TURN]
        return some

    def _begin(self, sets: Sequence[tuple[int, str]]) -> None:
        try:
            told = [(file, self._results(set_index)) for set_index, file in sets]
        except (StorageError, OSError) as error:
            log.warning("no tiles of the waterfall now: %s", error)
            return
        if told:
            self._running = self._compaction.beside(tiled, self._folder, self._experiment, told)

    def _take_back(self, future: Future[str]) -> None:
        try:
            told = future.result()
        except Exception as error:  # noqa: BLE001 - a worker that died; the round comes again
            told = repr(error)
        if told and told != self._told:
            log.warning("the tiles of the waterfall lack sets: %s", told)
        self._told = told
