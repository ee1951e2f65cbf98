"""Wait until the computer's clock is believed, and report its steps."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import asdict
from functools import partial

from daq_service.alarms.clock_trouble import doubt_condition
from daq_service.alarms.states import Moment
from daq_service.clock import WallClock
from daq_service.recording.opening import Opening
from daq_service.recording.persistence import Idle, Persistence
from daq_service.recording.presence import Presence
from daq_service.recording.resumed_time import CLOCK_BELIEVED, CLOCK_STEP
from daq_service.recording.set_assessor import SetAssessor
from hardware_drivers.instruments import Clock

log = logging.getLogger(__name__)


class ClockWatch:
    """Watches the clock of a test in real time; a simulated one is always believed."""

    def __init__(
        self,
        clock: Clock,
        assessor: SetAssessor,
        persistence: Persistence,
        presence: Presence,
        moment: Callable[[], Moment],
        stop: threading.Event,
    ) -> None:
        self._clock, self._set_assessor, self._persistence = clock, assessor, persistence
        self._presence, self._moment, self._stop = presence, moment, stop

    def wait_until_believed(
        self, idle: Idle, *, not_running_reason: str, opening: Opening | None
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
            self._presence.doing = f"waiting for a set clock: {reason}"
            return idle()

        started_ns = clock.mono_ns()
        believed = clock.wait_while_doubted(wait)
        if self._stop.is_set():
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
        update = partial(self._set_assessor.update_alarm, doubt_condition(doubt), self._moment())
        self._persistence.do(update)

    def report_steps(self) -> None:
        """Report each step of the computer's clock since the last call."""
        if isinstance(self._clock, WallClock):
            for step in self._clock.steps():
                log.warning("%s", step.message)
                self._persistence.say(CLOCK_STEP, asdict(step))
