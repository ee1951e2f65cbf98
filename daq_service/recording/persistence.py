"""Make shots and sets durable, and acknowledge them; what the disk refuses waits in memory, in order."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from daq_service.archive import SetRecord, StoredSet
from daq_service.catalogue import SetCommit
from daq_service.errors import PASSING
from daq_service.recording.resources import Resources
from hardware_drivers.measurement import SetKey

log = logging.getLogger(__name__)

WAITS_S = (1.0, 2.0, 5.0, 10.0, 30.0)
"""Before each further try; the last one repeats."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trouble:
    """Reason why nothing is stored, and its start in monotonic seconds."""

    message: str
    since_s: float


class Persistence:
    """Write-retry queue: jobs run in their order; one that the disk refuses is retried before the others.

    Attributes
    ----------
    trouble
        Why the disk takes nothing; None: it does.
    on_change
        Called with the trouble when it starts or changes its message, with None when all is stored.
    """

    def __init__(self, resources: Resources) -> None:
        """Keep the stores and limits of the recorder; no job is queued."""
        self._archive, self._catalogue, self._tasks = resources.archive, resources.catalogue, resources.tasks
        self._disk, self._stop, self._moment = resources.disk, resources.stop, resources.moment
        self._acknowledged, self._mono_s = resources.options.acknowledged, resources.host.machine.mono_s
        self._limit_bytes = resources.settings.storage.memory_mb * 10**6
        self._reported_ids: set[int] = set()
        self._jobs: deque[tuple[Callable[[], None], int]] = deque()
        self._n_bytes = self._tries = 0
        self._next_s = 0.0
        self.trouble: Trouble | None = None
        self.on_change: Callable[[Trouble | None], None] = lambda trouble: None

    def __len__(self) -> int:
        """Return the number of queued jobs."""
        return len(self._jobs)

    @property
    def has_room(self) -> bool:
        """Return whether the queued jobs hold less memory than the limit ``storage.memory_mb``."""
        return self._n_bytes < self._limit_bytes

    # Shots and sets -------------------------------------------------------------------------------

    def acknowledge(self) -> bool:
        """Make added shots durable and report their ids; return False if the disk refuses at present.

        A refused sync is retried later; errors of the disk are not raised.
        """
        if self._find_refusal_reason():
            return False
        try:
            self._sync()
        except PASSING as error:
            log.warning("not acknowledged yet: %s", error)
            if self.trouble is None:  # the retry must not wait for the end of the set
                self.do(self._sync)
            return False
        return True

    def _sync(self) -> None:
        """Make the journal durable and report the acknowledged shots; raise ArchiveWriteError if refused."""
        self._report_ids(self._archive.sync())

    def _report_ids(self, shot_ids: Iterable[int]) -> None:
        """Call the option ``acknowledged`` with each id of a durable shot that was not reported before."""
        for shot_id in shot_ids:
            if shot_id not in self._reported_ids:
                self._reported_ids.add(shot_id)
                self._acknowledged(shot_id)

    def skip_acknowledged_shots(self, shot_ids: Iterable[int]) -> None:
        """Mark shots that an earlier recorder acknowledged, so that they are not reported again."""
        self._reported_ids.update(shot_ids)

    def store(self, record: SetRecord) -> StoredSet:
        """Make a complete set durable and report the ids of its shots; raise errors of `Archive.store_set`.

        The ids are forgotten afterwards, since no later set has them.
        """
        stored = self._archive.store_set(record)
        self._report_ids(stored.crc32)
        self._reported_ids.difference_update(stored.crc32)
        return stored

    def after_set(self, set_key: SetKey) -> None:
        """Notify all background tasks that the rows of a set are stored, so that its file can be written."""
        for task in self._tasks:
            task.after_set(set_key)

    # The queue ------------------------------------------------------------------------------------

    def do(self, job: Callable[[], None], *, n_bytes: int = 0) -> None:
        """Run a job after all queued jobs: at once, unless the disk refuses at present.

        A job that a disk error (`PASSING`) ends stays queued and is retried; other errors are raised.

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
            self.run_queued_jobs()

    def attempt(self, job: Callable[[], None]) -> None:
        """Run a job at once; after a disk error queue it, or drop it if other jobs wait already.

        In the second case the caller's next check runs it again.
        """
        if self.trouble is None:
            self.do(job)
        else:
            with suppress(*PASSING):  # the trouble is reported; a pause takes effect once it is readable
                job()

    def post(
        self, build: Callable[[], SetCommit], *then: Callable[[SetCommit], None], n_bytes: int = 0
    ) -> None:
        """Build a transaction once and pass it to each of ``then`` in order, after all queued jobs.

        If the disk refuses, all of ``then`` are repeated with the same transaction. ``n_bytes`` is the memory
        that the job holds.
        """
        built: list[SetCommit] = []

        def run_job() -> None:
            """Build the transaction on the first try and pass it to each of ``then``."""
            if not built:
                built.append(build())
            for pass_on in then:
                pass_on(built[0])

        self.do(run_job, n_bytes=n_bytes)

    def say(self, kind: str, payload: Mapping[str, Any]) -> None:
        """Store an event of topic ``service`` with the present time of the test, after all queued jobs."""
        utc_ns = self._moment().utc_ns

        def run_job() -> None:
            """Store the event at the time at which it was queued."""
            self._catalogue.add_service_event(utc_ns=utc_ns, kind=kind, payload=payload)

        self.do(run_job)

    def run_for(self, seconds: float) -> None:
        """Retry the queued jobs if the waiting time is over (a `BackgroundTask`); ``seconds`` is unused."""
        if self._jobs and self._mono_s() >= self._next_s:
            self.run_queued_jobs()

    def run_queued_jobs(self) -> None:
        """Run the queued jobs in order until one is refused; schedule its retry.

        When all are stored after a trouble, log it and call ``on_change`` with None. Other errors than
        `PASSING` are raised.
        """
        while self._jobs:
            if refusal := self._find_refusal_reason():
                self._schedule_retry(refusal)
                return
            job, n_bytes = self._jobs[0]
            try:
                job()
            except PASSING as error:
                self._schedule_retry(f"{error}")
                return
            self._jobs.popleft()
            self._n_bytes -= n_bytes
        if self.trouble is not None:
            log.warning("everything is stored again after %.0f s", self._mono_s() - self.trouble.since_s)
            self.trouble, self._tries = None, 0
            self.on_change(None)

    def _find_refusal_reason(self) -> str:
        """Return why nothing may be stored, "" if it may; when stopping, the remaining space may be used."""
        return "" if self._disk is None or self._stop.is_set() else self._disk.refusal

    def _schedule_retry(self, message: str) -> None:
        """Schedule the next retry in 1, 2, 5, 10, then always 30 s, and set `trouble`.

        A new or changed message is logged as an error and passed to ``on_change``.
        """
        now_s, before = self._mono_s(), self.trouble
        self._next_s = now_s + WAITS_S[min(self._tries, len(WAITS_S) - 1)]
        self._tries += 1
        self.trouble = Trouble(message=message, since_s=now_s if before is None else before.since_s)
        if before is None or before.message != message:
            log.error("not stored, %d jobs wait in memory: %s", len(self._jobs), message)
            self.on_change(self.trouble)
