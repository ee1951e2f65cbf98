"""Wait: show what the recorder does, listen to commands, watch the clock, let background tasks run."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from functools import partial

from daq_service.clock import WallClock
from daq_service.commands.execution import CommandExecutor
from daq_service.errors import PASSING
from daq_service.recording.persistence import Persistence, Trouble
from daq_service.recording.resources import Resources
from daq_service.recording.resumed_time import CLOCK_STEP
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
    """Called again and again while the recorder waits, and shows by the heartbeat what it does.

    Attributes
    ----------
    doing
        What the recorder does; the next beat shows it.
    free_until_ns
        Until when (ns of UTC) no set is due.
    request
        What an instrument asks a person to do now; empty: nothing.
    commands
        What the operator orders; set by the recorder.
    newest
        Scheduled set that was taken last; None before the first one and after the last one.
    next_set
        Index of the first scheduled set of which no shot is struck yet.
    """

    def __init__(
        self, resources: Resources, assessor: SetAssessor, persistence: Persistence, storage: StorageAlarms
    ) -> None:
        self._resources, self._set_assessor, self._persistence = resources, assessor, persistence
        self._clock, self.storage, self._look_again_s = resources.rig.clock, storage, -math.inf
        self.doing, self.request, self.free_until_ns = "starting", "", -math.inf
        self.newest: DueSet | None = None
        self.next_set = 0
        self.commands: CommandExecutor
        persistence.on_change = self._report_trouble

    def between_sets(self) -> bool:
        """Run the background tasks, beat and look; False once the recorder shall stop."""
        seconds = (self.free_until_ns - self._clock.utc_ns()) / NS_PER_S
        self._persistence.run_for(seconds)
        for task in self._resources.tasks:  # none that can wait, while the disk takes nothing
            task.run_for(seconds if self._persistence.trouble is None else 0.0)
        self.storage.report()
        self.attempt(partial(self._set_assessor.expire_shelves, self._resources.moment()))
        return self.within_set()

    def within_set(self) -> bool:
        """Update the heartbeat and check for requests, also between shots."""
        if isinstance(self._clock, WallClock):
            for step in self._clock.steps():
                log.warning("%s", step.message)
                self._persistence.say(CLOCK_STEP, asdict(step))
        if self._resources.disk is not None:
            self._resources.disk.run_for(0.0)
        self.beat()
        now_s = time.monotonic()
        if now_s >= self._look_again_s:
            self._look_again_s = now_s + self._resources.host.listen_every_s
            self.storage.watch_web()
            self.attempt(self.commands.listen)
        if self._set_assessor.drive is not None:
            self._set_assessor.drive.tick(self._resources.moment().due_h)
        return not self._resources.stop.is_set()

    def attempt(self, job: Callable[[], None]) -> None:
        """Do something that the disk may refuse: then it waits for the disk, or is tried at the next look."""
        if self._persistence.trouble is None:
            self._persistence.do(job)
        else:
            with suppress(*PASSING):  # the trouble is reported; a pause takes effect once it is readable
                job()

    def until_stored(self) -> None:
        """Wait until everything is stored, or until a stop."""
        while self._persistence.trouble is not None and self.between_sets():
            self._resources.stop.wait(self._resources.host.look_every_s)
        self.storage.use_reserve()

    def for_worker(self) -> None:
        """Wait for the files of earlier sets in simulated time, or journal and memory would grow."""
        finalizer = self._resources.finalizer
        while finalizer is not None and finalizer.n_under_way > MOST_UNDER_WAY and self.between_sets():
            self._resources.stop.wait(self._resources.host.look_every_s / 10.0)

    def for_files(self) -> None:
        """Wait for the files of the last sets at the end of a test, but not after a stop."""
        finalizer, host, stop = self._resources.finalizer, self._resources.host, self._resources.stop
        if finalizer is None or stop.is_set():
            return
        until_s = host.machine.mono_s() + WAIT_FOR_FILES_S
        while self.between_sets() and host.machine.mono_s() < until_s and finalizer.waits:
            finalizer.try_again()
            stop.wait(host.look_every_s)

    def linger(self) -> None:
        """Listen to the operator, strike nothing, until ``stop`` is set."""
        self.doing, self.free_until_ns = "waiting for orders; every set is taken", math.inf
        while self.between_sets():
            self._resources.stop.wait(self._resources.host.look_every_s)

    # What the recorder does -----------------------------------------------------------------------

    def beat(self, *, at_once: bool = False) -> None:
        """Show what the recorder does, what a person shall do, and what waits for the disk."""
        waits, trouble = "", self._persistence.trouble
        if trouble is not None:
            waits = f"{len(self._persistence)} jobs wait in memory for the disk: {trouble.message}"
        parts = (self.doing, self.request, waits)
        self._resources.heartbeat.beat("; ".join(filter(None, parts)), at_once=at_once)

    def announce(self, doing: str) -> None:
        """Report an activity at once: if it hangs, the supervisor can name it."""
        self.doing = doing
        self.beat()

    def end(self) -> None:
        """Show that the recorder leaves."""
        self._resources.heartbeat.stage, self.doing = "ended", "leaving"
        self.beat(at_once=True)

    def _report_trouble(self, trouble: Trouble | None) -> None:
        self.storage.report_trouble(trouble)
        self.beat()
