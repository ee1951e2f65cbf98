"""Wait between sets: let background tasks run, report what they find, listen to commands."""

from __future__ import annotations

import logging
import math
from functools import partial

from daq_service.recording.acquire_set import Activity
from daq_service.recording.persistence import Persistence, Trouble
from daq_service.recording.resources import Resources
from daq_service.recording.set_assessor import SetAssessor
from daq_service.recording.storage_alarms import StorageAlarms
from hardware_drivers.measurement import DueSet
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

WAIT_FOR_FILES_S = 60.0
"""A file takes some hundredths of a second; where it takes this long, the journal keeps its set."""
MOST_UNDER_WAY = 40
"""Whole sets whose files are being made: two segments of the journal."""


class Waiting:
    """Called again and again while the recorder waits between sets.

    Attributes
    ----------
    free_until_ns
        Until when (ns of UTC) no set is due.
    newest
        Scheduled set that was taken last; None before the first one and after the last one.
    next_set
        Index of the first scheduled set of which no shot is struck yet.
    """

    def __init__(
        self,
        resources: Resources,
        assessor: SetAssessor,
        persistence: Persistence,
        storage: StorageAlarms,
        activity: Activity,
    ) -> None:
        """Connect the storage alarms with the write-retry queue; no set is taken yet."""
        self._resources, self._set_assessor, self._persistence = resources, assessor, persistence
        self.storage, self.activity, self.free_until_ns = storage, activity, -math.inf
        self.newest: DueSet | None = None
        self.next_set = 0
        persistence.on_change = self._report_trouble

    def run_between_sets(self) -> bool:
        """Run retries, background tasks, alarms and requests between sets; return False at a stop."""
        seconds = (self.free_until_ns - self._resources.rig.clock.utc_ns()) / NS_PER_S
        self._persistence.run_for(seconds)
        for task in self._resources.tasks:  # none that can wait, while the disk takes nothing
            task.run_for(seconds if self._persistence.trouble is None else 0.0)
        self.storage.report()
        self._persistence.attempt(partial(self._set_assessor.update_alarms_by_time, self._resources.moment()))
        return self.activity.run_between_shots()

    def wait_until_stored(self) -> None:
        """Block until all jobs are stored; after a stop use the reserve of the disk for them.

        Jobs that are refused even then are lost, with an error in the log.
        """
        while self._persistence.trouble is not None and self.run_between_sets():
            self._resources.stop.wait(self._resources.host.look_every_s)
        self.storage.store_in_reserve()

    def wait_for_worker(self) -> None:
        """Block until at most 40 sets lack their files, or for a stop; needed in simulated time.

        Else journal and memory would grow.
        """
        finalizer = self._resources.finalizer
        while finalizer is not None and finalizer.n_under_way > MOST_UNDER_WAY and self.run_between_sets():
            self._resources.stop.wait(self._resources.host.look_every_s / 10.0)

    def wait_for_files(self) -> None:
        """Block until the last sets have their files, at most 60 s or until a stop; retry failed ones."""
        finalizer, host, stop = self._resources.finalizer, self._resources.host, self._resources.stop
        if finalizer is None or stop.is_set():
            return
        until_s = host.machine.mono_s() + WAIT_FOR_FILES_S
        while self.run_between_sets() and host.machine.mono_s() < until_s and finalizer.waits:
            finalizer.retry_failed_sets()
            stop.wait(host.look_every_s)

    def linger(self) -> None:
        """Block until ``stop`` is set; meanwhile execute operators' commands without acquiring sets."""
        self.activity.doing = "waiting for commands; every set is taken"
        self.free_until_ns = math.inf
        while self.run_between_sets():
            self._resources.stop.wait(self._resources.host.look_every_s)

    def end(self) -> None:
        """Write the last heartbeat at once: stage "ended", activity "leaving"."""
        self._resources.heartbeat.stage, self.activity.doing = "ended", "leaving"
        self.activity.beat(at_once=True)

    def _report_trouble(self, trouble: Trouble | None) -> None:
        """Raise (or with None clear) the storage alarm and write the heartbeat."""
        self.storage.report_trouble(trouble)
        self.activity.beat()
