"""Wait with the first set until the computer's clock is believed."""

from __future__ import annotations

import logging
from dataclasses import asdict
from functools import partial

from daq_service.alarms.process_trouble import CLOCK_UNVERIFIED, build_reason_condition
from daq_service.clock import WallClock
from daq_service.recording.opening import Opening
from daq_service.recording.persistence import Persistence
from daq_service.recording.resources import Resources
from daq_service.recording.resumed_time import CLOCK_BELIEVED
from daq_service.recording.set_assessor import SetAssessor
from daq_service.recording.waiting import Waiting

log = logging.getLogger(__name__)


def wait_for_verified_clock(
    resources: Resources,
    assessor: SetAssessor,
    persistence: Persistence,
    waiting: Waiting,
    not_running_reason: str,
    opening: Opening | None,
) -> list[tuple[int, str]]:
    """Block until the clock is verified; return the times until which sets were missed, with reasons.

    The list has pairs of time (ns of UTC) and reason in order of time: no recorder ran, the rig was opened,
    the clock was awaited. It is empty if the recorder was stopped meanwhile. A doubtful clock raises an
    alarm; a simulated clock is never in doubt.
    """
    clock, reasons = resources.rig.clock, list[str]()
    if not isinstance(clock, WallClock):
        return [(clock.utc_ns(), not_running_reason)]

    def report_doubt(doubt: str) -> None:
        """Raise the alarm of the clock with a reason, or clear it with an empty one; store it or queue it."""
        condition = build_reason_condition(CLOCK_UNVERIFIED, doubt)
        persistence.do(partial(assessor.update_alarm, condition, resources.moment()))

    def wait(reason: str) -> bool:
        """Log and report the first reason and run the work between sets; False if the recorder stops."""
        if not reasons:
            log.error("waiting for a set clock: %s", reason)
            report_doubt(reason)
        reasons.append(reason)
        waiting.activity.doing = f"waiting for a set clock: {reason}"
        return waiting.run_between_sets()

    started_ns = clock.mono_ns()
    believed = clock.wait_while_doubted(wait)
    if resources.stop.is_set():
        return []
    if believed is not None:
        log.warning("%s", believed.message)
        persistence.say(CLOCK_BELIEVED, asdict(believed))
    report_doubt("")
    now_ns, waited = clock.utc_ns(), f"the recorder waited for a set clock: {''.join(reasons[:1])}"
    offset_ns = now_ns - clock.mono_ns()
    opened = [(offset_ns + started_ns, not_running_reason)]
    if opening is not None:
        opened = [(offset_ns + opening.since_mono_ns, not_running_reason), (opened[0][0], opening.text)]
    return [*opened, (now_ns, waited)]
