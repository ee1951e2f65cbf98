"""Update of the waterfall's tiles in the worker process; errors affect only the tiles.

A set is added while its file is written (`add_record_to_tiles`). Rows of incomplete blocks, and sets that are
missing after an older version, a full volume or a corrupt tile, are added while no set is due.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path

from daq_service.archive import Results, SetRecord, SetReference
from daq_service.archive.waterfall.cells import extract_anchors
from daq_service.archive.waterfall.tile_files import remove_tiles, write_tiles_of_file, write_tiles_of_set
from daq_service.background.finalize_sets import SetFinalizer
from daq_service.background.task import BackgroundTask
from daq_service.background.verification import QUIET_S
from daq_service.clock import MACHINE, MachineClock
from daq_service.errors import StorageError
from hardware_drivers.measurement import SetKey

log = logging.getLogger(__name__)

EVERY_S, SETS_A_TURN = 10.0, 4
"""Some hundredths of a second each: about one per cent of a core."""


def add_record_to_tiles(
    folder: Path, experiment: str, anchors: Mapping[int, float], record: SetRecord
) -> str:
    """Add a scheduled set to the tiles, complete blocks only; return an error message, empty on success.

    An unscheduled set is skipped. No error is raised, because the tiles are a cache.

    Parameters
    ----------
    experiment
        Identifier of the test.
    anchors
        Time of the first pulse or echo in s, by sequence number (`extract_anchors`).
    """
    if record.unscheduled_index:
        return ""
    try:
        write_tiles_of_set(folder, experiment, record, anchors, complete_blocks_only=True)
    except Exception as error:  # noqa: BLE001 - a cache; whatever it meets, the test goes on
        return f"the tiles of the waterfall lack a set: {error!r}"
    return ""


def add_files_to_tiles(folder: Path, experiment: str, sets: Sequence[tuple[str, Results]]) -> str:
    """Add stored sets (file and results of each) to the tiles; return the last error message, or empty.

    After an error the next set follows; none is raised.
    """
    message = ""
    for file, results in sets:
        try:
            write_tiles_of_file(folder, experiment, SetReference(file), extract_anchors(results))
        except Exception as error:  # noqa: BLE001 - a cache; whatever it meets, the test goes on
            message = repr(error)
    return message


def rebuild_tiles(
    folder: Path,
    experiment: str,
    files: Mapping[SetKey, str],
    results: Callable[[SetKey], Results],
    progress: Callable[[int, int], None],
) -> list[str]:
    """Delete all tiles of a folder, build them from all scheduled sets, and return error messages.

    If the old tiles cannot be removed, nothing is built. Errors of ``results`` and ``progress`` are raised.

    Parameters
    ----------
    files, results
        Files of sets by key, and a function that returns the results of a set.
    progress
        Called after each scheduled set with the number of sets done and of all files.
    """
    try:
        remove_tiles(folder)
    except OSError as error:
        return [f"the old tiles stay: {error}"]
    messages = []
    for number, (set_key, file) in enumerate(_select_scheduled_files(files).items()):
        if message := add_files_to_tiles(folder, experiment, [(file, results(set_key))]):
            messages.append(f"{file}: {message}")
        progress(number + 1, len(files))
    return messages


def _select_scheduled_files(files: Mapping[SetKey, str]) -> dict[SetKey, str]:
    """Return the files of the scheduled sets by key, in the given order; the waterfall shows no others."""
    return {key: file for key, file in files.items() if not key.unscheduled_index}


class TileMaker(BackgroundTask):
    """Background task that adds missing sets to the tiles while no set is due.

    Parameters
    ----------
    finalizer
        Its worker adds the sets while it finalizes none.
    files, results
        The files of all sets by key; what was computed of one.
    has_room
        Whether the volume has room for a cache.
    """

    def __init__(
        self,
        folder: Path,
        experiment: str,
        finalizer: SetFinalizer,
        files: Callable[[], Mapping[SetKey, str]],
        results: Callable[[SetKey], Results],
        *,
        has_room: Callable[[], bool] = lambda: True,
        machine: MachineClock = MACHINE,
    ) -> None:
        self._folder, self._experiment, self._finalizer = folder, experiment, finalizer
        self._files, self._results, self._has_room, self._machine = files, results, has_room, machine
        self._round: list[tuple[SetKey, str]] = []
        self._running: Future[str] | None = None
        self._next_s = machine.mono_s()
        self._last_message = ""

    def run_for(self, seconds: float) -> None:
        """Process the result of the worker, then submit up to `SETS_A_TURN` sets, at most every `EVERY_S`.

        None is submitted while the worker has the last ones, within `QUIET_S` of the next set, while sets
        wait for their files, or without disk space. ``seconds`` is the time until the next set. An error of
        ``files`` is raised.
        """
        if self._running is not None:
            if not self._running.done():
                return
            self._process_result(self._running)
            self._running = None
        free = seconds > QUIET_S and not self._finalizer.waits
        if free and self._has_room() and self._machine.mono_s() >= self._next_s:
            self._next_s = self._machine.mono_s() + EVERY_S
            self._submit_sets(self._select_next_sets())

    def _select_next_sets(self) -> list[tuple[SetKey, str]]:
        """Remove up to `SETS_A_TURN` sets from the end of the round and return their keys and files.

        The newest sets come first. An empty round starts again with all scheduled files; the list is empty if
        the test has none.
        """
        if not self._round:
            self._round = sorted(_select_scheduled_files(self._files()).items())
        next_sets, self._round = self._round[-SETS_A_TURN:], self._round[:-SETS_A_TURN]
        return next_sets

    def _submit_sets(self, sets: Sequence[tuple[SetKey, str]]) -> None:
        """Submit files and results of some sets to the worker.

        If their results cannot be read (logged), or the worker takes no work, they wait for the next round.
        """
        try:
            files_and_results = [(file, self._results(set_key)) for set_key, file in sets]
        except (StorageError, OSError) as error:
            log.warning("no tiles of the waterfall now: %s", error)
            return
        if files_and_results:
            self._running = self._finalizer.submit(
                add_files_to_tiles, self._folder, self._experiment, files_and_results
            )

    def _process_result(self, future: Future[str]) -> None:
        """Process the result of the worker: log its message, or its error, once until that changes."""
        try:
            message = future.result()
        except Exception as error:  # noqa: BLE001 - a worker that died; the round comes again
            message = repr(error)
        if message and message != self._last_message:
            log.warning("the tiles of the waterfall lack sets: %s", message)
        self._last_message = message
