"""Write complete sets from the journal to files, in a worker process; failed ones are retried."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future
from pathlib import Path
from typing import Any, TypeVar

from daq_service.archive import (
    Archive,
    CorruptArchiveError,
    Results,
    SetNotFoundError,
    SetRecord,
    SetReference,
)
from daq_service.archive.finalize_set import finalize_set
from daq_service.background.task import BackgroundTask
from daq_service.clock import MACHINE, MachineClock
from daq_service.errors import StorageError
from daq_service.processes.worker import start_one_worker
from hardware_drivers.measurement import SetKey

log = logging.getLogger(__name__)

T = TypeVar("T")

AGAIN_AFTER_S = 10.0
"""A set whose file could not be made stays in the journal, where it is safe."""


class SetFinalizer(BackgroundTask):
    """Finalizer of sets: a worker writes the file of each complete set, then the journal drops it.

    Parameters
    ----------
    results
        Returns the results of a set, for its file.
    filed
        Called with a set, its file and the SHA-256 of the file before the journal drops the set.
    also
        Returns a further task of the worker for a set and its results, or None; the task returns an error
        message, which is logged once.

    Attributes
    ----------
    damaged
        Sets without a file, because they are corrupt in the journal.
    trouble
        Why the file of a set could not be written; empty if there is no such set.
    """

    def __init__(
        self,
        folder: Path,
        archive: Archive,
        *,
        start: Callable[[], Executor] = start_one_worker,
        machine: MachineClock = MACHINE,
        results: Callable[[SetKey], Results] = lambda set_key: {},
        filed: Callable[[SetKey, str, str], None] = lambda set_key, file, sha256: None,
        also: Callable[[SetKey, Results], Callable[[SetRecord], str] | None] = lambda set_key, results: None,
    ) -> None:
        self._folder, self._archive = folder, archive
        self._start, self._machine, self._results, self._filed = start, machine, results, filed
        self._also = also
        self._executor: Executor | None = None
        self._running: dict[SetKey, Future[tuple[SetReference, str, str]]] = {}
        self._again_s: dict[SetKey, float] = {}
        self.trouble = self._last_message = ""
        self.damaged: dict[str, str] = {}

    def after_set(self, set_key: SetKey) -> None:
        """Submit a complete set of the journal to the worker, which writes its file.

        Start the worker if needed. If it has died, or the results cannot be read (logged), the set is retried
        later, and no error is raised.
        """
        if self._executor is None:
            self._executor = self._start()
        try:
            results = self._results(set_key)
            self._running[set_key] = self._executor.submit(
                finalize_set,
                self._folder,
                set_key,
                self._archive.places(set_key),
                results,
                self._also(set_key, results),
            )
        except BrokenExecutor:
            self._executor = None
            self._again_s[set_key] = self._machine.mono_s()
        except StorageError as error:
            self._keep_in_journal(set_key, error)

    def submit(self, work: Callable[..., T], *arguments: Any) -> Future[T] | None:
        """Submit other work (a picklable function) to the worker; start the worker if needed.

        Return its future; None if sets wait for their files, or the worker has died (the next call starts
        another).
        """
        if self.waits:
            return None
        if self._executor is None:
            self._executor = self._start()
        try:
            return self._executor.submit(work, *arguments)
        except BrokenExecutor:
            self._executor = None
            return None

    def run_for(self, seconds: float = 0.0) -> None:
        """Process the finished results of the worker, and submit failed sets again after `AGAIN_AFTER_S`.

        It never waits for the worker; ``seconds`` is ignored.
        """
        for set_key in [key for key, future in self._running.items() if future.done()]:
            self._process_result(set_key, self._running.pop(set_key))
        now_s = self._machine.mono_s()
        for set_key in [key for key, due_s in self._again_s.items() if due_s <= now_s]:
            del self._again_s[set_key]
            self.after_set(set_key)

    def _process_result(self, set_key: SetKey, future: Future[tuple[SetReference, str, str]]) -> None:
        """Process the worker's result for a set: report its file, then remove the set from the journal.

        A set that is not in the journal any more counts as done. After any other error it is retried later
        (logged), but a corrupt set stays in the journal and is listed in `damaged`.
        """
        try:
            file, sha256, message = future.result()
            self._filed(set_key, file, sha256)
            if message and message != self._last_message:
                log.warning("%s", message)
            self._last_message = message
        except SetNotFoundError:
            log.debug("set %s is not in the journal: it has its file already", set_key)
        except CorruptArchiveError as error:
            # No waiting mends that: the next start looks again.
            log.error("set %s gets no file and stays in the journal: %s", set_key, error)
            self.damaged[f"set {set_key} in the journal"] = f"{error}"
            return
        except Exception as error:  # noqa: BLE001 - whatever a worker meets, the line goes on
            if isinstance(error, BrokenExecutor):
                self._executor = None
            self._keep_in_journal(set_key, error)
            return
        self._archive.settle(set_key)
        self.trouble = self.trouble if self._again_s else ""

    def _keep_in_journal(self, set_key: SetKey, error: Exception) -> None:
        """Keep a set in the journal after an error: log it as `trouble`, and retry after `AGAIN_AFTER_S`."""
        log.error("set %s has no file yet and stays in the journal: %s", set_key, error)
        self.trouble = f"{error}"
        self._again_s[set_key] = self._machine.mono_s() + AGAIN_AFTER_S

    @property
    def n_under_way(self) -> int:
        """Return the number of sets whose result from the worker is not processed yet."""
        return len(self._running)

    @property
    def waits(self) -> bool:
        """Return whether a set has no file yet: submitted, or waiting for a retry."""
        return bool(self._running or self._again_s)

    def retry_failed_sets(self) -> None:
        """Process finished sets; submit failed ones at once, unless the worker still has sets."""
        if not self._running:
            self._again_s = dict.fromkeys(self._again_s, -math.inf)
        self.run_for()

    def close(self) -> None:
        """Stop the worker; wait for other work of it, but not for sets that it still writes.

        These remain in the journal for the next start.
        """
        if self._executor is not None:
            self._executor.shutdown(wait=not self._running, cancel_futures=True)
