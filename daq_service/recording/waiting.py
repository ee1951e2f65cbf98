"""Wait: show what the recorder does, listen to commands, watch the clock, let background tasks run."""

from __future__ import annotations

import logging
import math
from contextlib import suppress
from dataclasses import asdict
from functools import partial

from daq_service.acquisition.schedule import DueSet
from daq_service.alarms.clock_trouble import doubt_condition
from daq_service.assessment.transaction import Transaction
from daq_service.background.write_retry_queue import PASSING
from daq_service.catalogue.rows import AnnotationRow
from daq_service.clock import WallClock
from daq_service.commands.execution import CommandExecutor
from daq_service.commands.running_test import RunningTest
from daq_service.recording.opening import Opening
from daq_service.recording.persistence import Persistence
from daq_service.recording.resources import Resources
from daq_service.recording.resumed_time import CLOCK_BELIEVED, CLOCK_STEP
from daq_service.recording.set_assessor import SetAssessor
from hardware_drivers.measurement import ShotKey
from hardware_drivers.methods import SOLITARY_WAVE
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

WAIT_FOR_FILES_S = 60.0
"""A file takes some hundredths of a second; where it takes this long, the journal keeps its set."""
MOST_UNDER_WAY = 40
"""Whole sets whose files are being made: two segments of the journal."""

ASKED, ASKED_OVER = "asked", "asked_over"
"""Events: a person is asked to do something now; that is done, or too late."""


class Waiting:
    """Called again and again while the recorder waits, and shows by the heartbeat what it does.

    Attributes
    ----------
    doing
        What the recorder does; the next beat shows it.
    free_until_ns
        Until when (ns of UTC) no set is due.
    commands
        What the operator orders.
    newest
        Scheduled set that was taken last; None before the first one and after the last one.
    next_set
        Index of the first scheduled set of which no shot is struck yet.
    """

    def __init__(self, resources: Resources, assessor: SetAssessor, persistence: Persistence) -> None:
        self._resources, self._set_assessor, self._persistence = resources, assessor, persistence
        self._clock, self._request = resources.rig.clock, ""
        self.doing, self.free_until_ns = "starting", -math.inf
        self.newest: DueSet | None = None
        self.next_set = 0
        settings, catalogue, drive = resources.settings, resources.catalogue, assessor.drive
        test = RunningTest(
            clock=resources.rig.clock,
            moment=resources.moment,
            stop=resources.stop,
            alarms=assessor.alarms,
            annotations=lambda: catalogue.rows(AnnotationRow),
            store=assessor.commit,
            reinstated=assessor.assessors.reinstate,
            confirmation=self._request_set,
            settings=settings,
            next_set=lambda: self.next_set,
            baseline=catalogue.baseline,
            renewed=assessor.assessors.renew,
            positions=settings.names_of(SOLITARY_WAVE),
            supply=drive if drive is not None and drive.has_supply else None,
        )
        self.commands = CommandExecutor(
            catalogue, test, listen_every_s=resources.host.listen_every_s, adopt=assessor.adopt
        )
        persistence.on_trouble = self.beat
        resources.rig.asking.listen(self._report_request)

    def between_sets(self) -> bool:
        """Run the background tasks, beat and listen; False once the recorder shall stop."""
        self._persistence.run_for((self.free_until_ns - self._clock.utc_ns()) / NS_PER_S)
        return self.within_set()

    def within_set(self) -> bool:
        """Beat and listen, also between shots: nothing else advances the heartbeat."""
        if isinstance(self._clock, WallClock):
            for step in self._clock.steps():
                log.warning("%s", step.message)
                self._persistence.say(CLOCK_STEP, asdict(step))
        self._persistence.watch()
        self.beat()
        if self._persistence.trouble is None:
            self._persistence.do(self._listen)
        else:
            with suppress(*PASSING):  # the trouble is reported; a pause takes effect once it is readable
                self._listen()
        if self._set_assessor.drive is not None:
            self._set_assessor.drive.tick(self._resources.moment().due_h)
        return not self._resources.stop.is_set()

    def until_stored(self) -> None:
        """Let nothing go on before everything is stored, but a stop."""
        while self._persistence.trouble is not None and self.between_sets():
            self._resources.stop.wait(self._resources.host.look_every_s)
        self._persistence.use_reserve()

    def for_worker(self) -> None:
        """Let no simulated time outrun the files: journal and memory would grow with the test."""
        finalizer = self._resources.finalizer
        while finalizer is not None and finalizer.n_under_way > MOST_UNDER_WAY and self.between_sets():
            self._resources.stop.wait(self._resources.host.look_every_s / 10.0)

    def for_files(self) -> None:
        """At the end of a test its last sets get their files; after a stop the next recorder sees to that."""
        finalizer, host, stop = self._resources.finalizer, self._resources.host, self._resources.stop
        if finalizer is None or stop.is_set():
            return
        until_s = host.mono_s() + WAIT_FOR_FILES_S
        while self.between_sets() and host.mono_s() < until_s and finalizer.waits:
            finalizer.try_again()
            stop.wait(host.look_every_s)

    def _listen(self) -> None:
        self.commands.listen()
        self._set_assessor.expire_shelves(self._resources.moment())

    # What the recorder does -----------------------------------------------------------------------

    def beat(self, *, at_once: bool = False) -> None:
        """Show what the recorder does, what a person shall do, and what waits for the disk."""
        parts = (self.doing, self._request, self._persistence.waiting)
        self._resources.heartbeat.beat("; ".join(filter(None, parts)), at_once=at_once)

    def announce(self, doing: str) -> None:
        """Report an activity at once: if it hangs, the supervisor can name it."""
        self.doing = doing
        self.beat()

    def end(self) -> None:
        """Show that the recorder leaves."""
        self._resources.heartbeat.stage, self.doing = "ended", "leaving"
        self.beat(at_once=True)

    def _request_set(self, position: str, author: str, note: str) -> Transaction:
        """Request an unscheduled set by a person's command; it is taken when the line is free.

        Raises
        ------
        ValueError
            It cannot be taken, and why.
        """
        if self.newest is None:
            raise ValueError(
                "no planned set was taken yet, or none is left: nothing is struck beside the plan"
            )
        moment = self._resources.moment()
        return self._set_assessor.order_confirmation(self.newest, position, author, note, moment)

    def _report_request(self, text: str, key: ShotKey | None) -> None:
        """Report what an instrument asks a person to do now; an empty text withdraws it."""
        self._request = text and f"waiting for a person: {text}"
        # The record is waited for from here on, as long as the heartbeat's deadline allows.
        self.beat(at_once=True)
        if not text:
            self._persistence.say(ASKED_OVER, {})
            self._resources.report(ASKED_OVER)
            return
        shot = {} if key is None else asdict(key)
        asked = {"text": text, **shot, "within_s": self._resources.settings.rig.read_timeout_s}
        self._persistence.say(ASKED, asked)
        self._resources.report(ASKED, **asked)

    # The computer's clock -------------------------------------------------------------------------

    def until_clock_is_believed(
        self, not_running_reason: str, opening: Opening | None
    ) -> list[tuple[int, str]]:
        """Let time stand still while it is doubted; return until when (ns of UTC) sets were missed and why.

        The list is in order of time.
        """
        clock, reasons = self._clock, list[str]()
        if not isinstance(clock, WallClock):
            return [(clock.utc_ns(), not_running_reason)]

        def wait(reason: str) -> bool:
            if not reasons:
                log.error("waiting for a set clock: %s", reason)
                self._report_doubt(reason)
            reasons.append(reason)
            self.doing = f"waiting for a set clock: {reason}"
            return self.between_sets()

        started_ns = clock.mono_ns()
        believed = clock.wait_while_doubted(wait)
        if self._resources.stop.is_set():
            return []
        if believed is not None:
            log.warning("%s", believed.message)
            self._persistence.say(CLOCK_BELIEVED, asdict(believed))
        self._report_doubt("")
        now_ns, waited = clock.utc_ns(), f"the recorder waited for a set clock: {''.join(reasons[:1])}"
        offset_ns = now_ns - clock.mono_ns()
        opened = [(offset_ns + started_ns, not_running_reason)]
        if opening is not None:
            opened = [(offset_ns + opening.since_mono_ns, not_running_reason), (opened[0][0], opening.text)]
        return [*opened, (now_ns, waited)]

    def _report_doubt(self, doubt: str) -> None:
        update = partial(self._set_assessor.update_alarm, doubt_condition(doubt), self._resources.moment())
        self._persistence.do(update)
