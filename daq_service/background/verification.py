"""Verification of stored sets, one after the other, in the worker process while no set is due."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from types import MappingProxyType

from daq_service.archive import SetNotFoundError
from daq_service.archive.records import SETS_FOLDER, parse_set_keys, to_references
from daq_service.archive.verification import describe_damage
from daq_service.background.finalize_sets import SetFinalizer
from daq_service.background.task import BackgroundTask
from daq_service.clock import MACHINE, MachineClock
from daq_service.errors import StorageError
from hardware_drivers.measurement import SetKey

log = logging.getLogger(__name__)

EVERY_S = 10.0
"""A set of the paper's test takes some tenths of a second: a few per cent of one core."""
_TROUBLE = (StorageError, OSError)
"""Errors of disk or catalogue that do not stop the test."""
QUIET_S = 10.0
"""Before a set is due the computer is left alone for so long."""


class IdleVerification(BackgroundTask):
    """Background task that verifies the files of a folder repeatedly and lists the corrupt ones.

    Parameters
    ----------
    finalizer
        Its worker reads the files while it finalizes none.
    lost
        Returns the missing files, with the reason (`lost_sets`).
    sha256_of
        Returns the SHA-256 of a set's file as it was written; None if it was not stored.
    note
        Called with key, file and SHA-256 of an intact file without a stored SHA-256.

    Attributes
    ----------
    damaged
        Fault of each corrupt file, by its path relative to the data folder.
    files_read
        Number of files read, intact or corrupt.
    """

    def __init__(
        self,
        folder: Path,
        finalizer: SetFinalizer,
        lost: Callable[[], Mapping[str, str]],
        sha256_of: Callable[[SetKey], str | None],
        note: Callable[[SetKey, str, str], None] = lambda set_key, file, sha256: None,
        *,
        machine: MachineClock = MACHINE,
    ) -> None:
        self._folder, self._finalizer, self._machine = folder, finalizer, machine
        self._lost, self._sha256_of, self._note = lost, sha256_of, note
        self._to_come: list[str] = []
        self._running: tuple[str, bool, Future[tuple[str, str]]] | None = None
        self._next_s = machine.mono_s()
        self.damaged: dict[str, str] = {}
        self.files_read = 0

    def begin(self, known: Mapping[str, str] = MappingProxyType({})) -> None:
        """Start a round: list all files of sets, corrupt ones first, and add the missing ones to `damaged`.

        Other entries of files that no longer exist are removed from `damaged`. If the catalogue cannot be
        read, the previous round is kept and a warning is logged.

        Parameters
        ----------
        known
            Fault of each corrupt file that an earlier process found: these are verified first, too.
        """
        try:
            lost = self._lost()
        except _TROUBLE as error:
            log.warning("cannot look which sets are gone: %s", error)
            return
        files = to_references(path.name for path in (self._folder / SETS_FOLDER).glob("*.h5"))
        self._to_come = [file for file in files.values() if file not in lost]
        suspects = {**known, **self.damaged}
        self._to_come.sort(key=lambda file: file not in suspects)
        self.damaged = {**{file: suspects[file] for file in self._to_come if file in suspects}, **lost}

    def run_for(self, seconds: float) -> None:
        """Process the result of a verified file, else submit the next one, at most every `EVERY_S`.

        None is submitted within `QUIET_S` of the next set, or while the worker writes files. After the last
        file of a round a new round begins. An error of disk or catalogue is logged, and the file is tried
        again.

        Parameters
        ----------
        seconds
            Time until the next set is due.
        """
        if self._running is not None:
            file, is_noted, future = self._running
            if future.done():
                self._running = None
                self._process_result(file, is_noted, future)
        elif seconds > QUIET_S and self._machine.mono_s() >= self._next_s:
            self._next_s = self._machine.mono_s() + EVERY_S
            if not self._to_come:
                self.begin()
            if self._to_come:
                file = self._to_come[0]
                try:
                    sha256 = self._sha256_of(_parse_set_key(file))
                except _TROUBLE as error:
                    log.warning("%s is checked later: %s", file, error)
                    return
                future_or_none = self._finalizer.submit(describe_damage, self._folder / file, sha256)
                if future_or_none is not None:
                    self._running = file, sha256 is not None, future_or_none
                    del self._to_come[0]

    def _process_result(self, file: str, is_noted: bool, future: Future[tuple[str, str]]) -> None:
        """Process the result for a file: update `damaged`, and report a SHA-256 that is not stored yet.

        After an error of the disk, the catalogue or the worker the file is left for the next round, and the
        error is logged. A file that has disappeared counts as damaged.

        Parameters
        ----------
        is_noted
            The catalogue has the SHA-256 of the file.
        """
        try:
            fault, sha256 = future.result()
            if not (fault or is_noted):
                self._note(_parse_set_key(file), file, sha256)
        except SetNotFoundError:
            fault = "is missing"
        except _TROUBLE as error:
            log.warning("%s is checked again later: %s", file, error)
            return
        except Exception as error:  # noqa: BLE001 - whatever a worker meets, the line goes on
            log.error("%s could not be checked: %s", file, error)
            return
        self.files_read += 1
        if fault:
            self.damaged[file] = fault
        else:
            self.damaged.pop(file, None)


def _parse_set_key(file: str) -> SetKey:
    """Parse the key of a set from the path of its file.

    Raises
    ------
    ValueError
        The file name is not that of a set.
    """
    (set_key,) = parse_set_keys([Path(file).name])
    return set_key
