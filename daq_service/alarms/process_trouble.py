"""Alarms of a process that does not run, or whose computer clock is unverified."""

from __future__ import annotations

from daq_service.alarms.states import Condition

CLOCK_UNVERIFIED = "clock_unverified"
RECORDER_NOT_RUNNING = "recorder_not_running"
WEB_NOT_RESPONDING = "web_not_responding"


def build_reason_condition(kind: str, reason: str) -> Condition:
    """Return the condition `CLOCK_UNVERIFIED` or `RECORDER_NOT_RUNNING` (priority high).

    Parameters
    ----------
    kind
        Which of the two; with an unverified clock the recorder waits.
    reason
        Evidence of an unverified clock, or that no recorder runs; empty: the condition is not present.
    """
    return Condition(kind=kind, priority="high", present=bool(reason), evidence={"reason": reason})


def build_web_condition(*, present: bool) -> Condition:
    """Return the condition ``web_not_responding`` (priority medium): no heartbeat of the test's web service.

    ``present`` False: the alarm returns to normal.
    """
    return Condition(kind=WEB_NOT_RESPONDING, priority="medium", present=present)
