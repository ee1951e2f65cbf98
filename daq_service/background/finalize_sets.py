"""Sets leave the journal for files of their own, made in a process beside the line; trouble there waits."""

from __future__ import annotations

import logging
import math
import time
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
from daq_service.archive.finalize_set import compact_set
from daq_service.errors import StorageError
from daq_service.processes.worker import one_worker

log = logging.getLogger(__name__)

T = TypeVar("T")

AGAIN_AFTER_S = 10.0
"""A set whose file could not be made stays in the journal, where it is safe."""


class SetFinalizer:
    """Hands whole sets to a worker and lets the journal forget what came back in order.

    Parameters
    ----------
    results
        Tells what was computed of a set, for its file.
    filed
        Told a set, its file and the SHA-256 of that before the journal forgets the set.
    also
        Gives what the worker shall do with a set, of which this was computed, while it has its records at
        hand; that says what kept it from it, once in the log.

    Attributes
    ----------
    damaged
        Sets that get no file, because they are damaged in the journal.
    """

    def __init__(
        self,
        folder: Path,
        archive: Archive,
        *,
        start: Callable[[], Executor] = one_worker,
        mono_s: Callable[[], float] = time.monotonic,
        results: Callable[[int], Results] = lambda set_index: {},
        filed: Callable[[int, str, str], None] = lambda set_index, file, sha256: None,
        also: Callable[[int, Results], Callable[[SetRecord], str] | None] = lambda set_index, results: None,
    ) -> None:
        self._folder, self._archive = folder, archive
        self._start, self._mono_s, self._results, self._filed = start, mono_s, results, filed
        self._also = also
        self._executor: Executor | None = None
        self._running: dict[int, Future[tuple[SetReference, str, str]]] = {}
        self._again_s: dict[int, float] = {}
        self._refusal = self._told = ""
        self.damaged: dict[str, str] = {}

    def put(self, set_index: int) -> None:
        """Have a file made of a whole set of the journal."""
        if self._executor is None:
            self._executor = self._start()
        try:
            results = self._results(set_index)
            self._running[set_index] = self._executor.submit(
                compact_set,
                self._folder,
                set_index,
                self._archive.places(set_index),
                results,
                self._also(set_index, results),
            )
        except BrokenExecutor:
            self._executor = None
            self._again_s[set_index] = self._mono_s()
        except StorageError as error:
            self._put_off(set_index, error)

    def beside(self, work: Callable[..., T], *arguments: Any) -> Future[T] | None:
        """Let the worker do something else; None: it has sets to make files of, or has just died."""
        if self.waits:
            return None
        if self._executor is None:
            self._executor = self._start()
        try:
            return self._executor.submit(work, *arguments)
        except BrokenExecutor:
            self._executor = None
            return None

    def work(self) -> None:
        """Look what is done; called while the line is idle."""
        for set_index in [index for index, future in self._running.items() if future.done()]:
            self._take_back(set_index, self._running.pop(set_index))
        now_s = self._mono_s()
        for set_index in [index for index, due_s in self._again_s.items() if due_s <= now_s]:
            del self._again_s[set_index]
            self.put(set_index)

    def _take_back(self, set_index: int, future: Future[tuple[SetReference, str, str]]) -> None:
        try:
            file, sha256, told = future.result()
            self._filed(set_index, file, sha256)
            if told and told != self._told:
                log.warning("%s", told)
            self._told = told
        except SetNotFoundError:
            log.debug("set %d is not in the journal: it has its file already", set_index)
        except CorruptArchiveError as error:
            # No waiting mends that: the next start looks again.
            log.error("set %d gets no file and stays in the journal: %s", set_index, error)
            self.damaged[f"set {set_index} in the journal"] = f"{error}"
            return
        except Exception as error:  # noqa: BLE001 - whatever a worker meets, the line goes on
            if isinstance(error, BrokenExecutor):
                self._executor = None
            self._put_off(set_index, error)
            return
        self._archive.settle(set_index)
        self._refusal = self._refusal if self._again_s else ""

    def _put_off(self, set_index: int, error: Exception) -> None:
        log.error("set %d has no file yet and stays in the journal: %s", set_index, error)
        self._refusal = f"{error}"
        self._again_s[set_index] = self._mono_s() + AGAIN_AFTER_S

    @property
    def trouble(self) -> str:
        """Why a set has no file although one was tried; empty: there is no such set."""
        return self._refusal

    @property
    def n_under_way(self) -> int:
        """Sets that the worker was given and has not finished."""
        return len(self._running)

    @property
    def waits(self) -> bool:
        """A set has no file yet."""
        return bool(self._running or self._again_s)

    def try_again(self) -> None:
        """Try now what failed before, if nothing is under way."""
        if not self._running:
            self._again_s = dict.fromkeys(self._again_s, -math.inf)
        self.work()

    def close(self) -> None:
        """Let the worker go; what has no file yet is left to the next start."""
        if self._executor is not None:
            self._executor.shutdown(wait=not self._running, cancel_futures=True)
