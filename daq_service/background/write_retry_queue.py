"""Write-retry queue: jobs wait in memory, in their order, until the disk accepts them."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from daq_service.background.task import BackgroundTask
from daq_service.errors import StorageUnavailableError

log = logging.getLogger(__name__)

PASSING = (StorageUnavailableError, OSError)
"""Trouble of a disk that may be over later: full, gone, failing, locked, no free handle."""
WAITS_S = (1.0, 2.0, 5.0, 10.0, 30.0)
"""Before each further try; the last one repeats."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """Reason why nothing is stored, and its start in monotonic seconds."""

    message: str
    since_s: float


class WriteRetryQueue(BackgroundTask):
    """Queue of jobs that run in their order; one that the disk rejects is retried before the others.

    Parameters
    ----------
    limit_bytes
        Memory that waiting sets may take.
    refusal
        Why nothing may be stored now; empty: it may.
    on_change
        Called with the trouble when it begins or changes its message, with None when all is stored.
    """

    def __init__(
        self,
        *,
        limit_bytes: int,
        on_change: Callable[[Trouble | None], None],
        refusal: Callable[[], str] = lambda: "",
        mono_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._limit_bytes = limit_bytes
        self._on_change = on_change
        self._refusal = refusal
        self._mono_s = mono_s
        self._jobs: deque[tuple[Callable[[], None], int]] = deque()
        self._n_bytes = 0
        self._tries = 0
        self._next_s = 0.0
        self.trouble: Trouble | None = None

    def __len__(self) -> int:
        return len(self._jobs)

    @property
    def has_room(self) -> bool:
        """Return whether there is memory for another set."""
        return self._n_bytes < self._limit_bytes

    def put(self, job: Callable[[], None], *, n_bytes: int = 0) -> None:
        """Run a job after all jobs before it; at once if none waits.

        Parameters
        ----------
        job
            Called again after an error, so it must be idempotent.
        n_bytes
            Memory that it holds.
        """
        self._jobs.append((job, n_bytes))
        self._n_bytes += n_bytes
        if self.trouble is None:
            self.run_all()

    def run_for(self, seconds: float) -> None:
        """Retry the jobs if the waiting time is over."""
        if self._jobs and self._mono_s() >= self._next_s:
            self.run_all()

    def run_all(self) -> None:
        """Run the jobs until one is refused."""
        while self._jobs:
            if refusal := self._refusal():
                self._wait(refusal)
                return
            job, n_bytes = self._jobs[0]
            try:
                job()
            except PASSING as error:
                self._wait(f"{error}")
                return
            self._jobs.popleft()
            self._n_bytes -= n_bytes
        if self.trouble is not None:
            log.warning("everything is stored again after %.0f s", self._mono_s() - self.trouble.since_s)
            self.trouble, self._tries = None, 0
            self._on_change(None)

    def _wait(self, message: str) -> None:
        now_s, before = self._mono_s(), self.trouble
        self._next_s = now_s + WAITS_S[min(self._tries, len(WAITS_S) - 1)]
        self._tries += 1
        self.trouble = Trouble(message=message, since_s=now_s if before is None else before.since_s)
        if before is None or before.message != message:
            log.error("not stored, %d jobs wait in memory: %s", len(self._jobs), message)
            self._on_change(self.trouble)
