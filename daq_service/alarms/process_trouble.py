"""Alarms of a process that does not run, raised by another one."""

from __future__ import annotations

from daq_service.alarms.states import Condition

RECORDER_NOT_RUNNING = "recorder_not_running"
WEB_NOT_RESPONDING = "web_not_responding"


def build_recorder_condition(finding: str) -> Condition:
    """Return the condition ``recorder_not_running`` (priority high), present if there is a ``finding``.

    Parameters
    ----------
    finding
        Evidence that no recorder runs; empty: not present.
    """
    return Condition(
        kind=RECORDER_NOT_RUNNING, priority="high", present=bool(finding), evidence={"reason": finding}
    )


def build_web_condition(*, present: bool) -> Condition:
    """Return the condition ``web_not_responding`` (priority medium): no heartbeat of the test's web service.

    ``present`` False: the alarm returns to normal.
    """
    return Condition(kind=WEB_NOT_RESPONDING, priority="medium", present=present)
