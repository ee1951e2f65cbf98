"""Alarms of a process that does not run, raised by another one."""

from __future__ import annotations

from daq_service.alarms.states import Condition

RECORDER_NOT_RUNNING = "recorder_not_running"
WEB_NOT_RESPONDING = "web_not_responding"


def build_recorder_condition(finding: str, hour: float) -> Condition:
    """Return the condition ``recorder_not_running`` (priority high), present if there is a ``finding``.

    Parameters
    ----------
    finding
        Evidence that no recorder runs, a sentence of the message; empty: not present.
    hour
        Hour of the test, for the message.
    """
    message = f"Recorder not running, sets are missed. {finding} (hour {hour:.1f})."
    action = "Read `logs/`, then run `solimon run`."
    return Condition(
        kind=RECORDER_NOT_RUNNING,
        priority="high",
        present=bool(finding),
        message=f"{message} {action}",
    )


def build_web_condition(hour: float, *, present: bool) -> Condition:
    """Return the condition ``web_not_responding`` (priority medium): no heartbeat of the test's web service.

    Parameters
    ----------
    hour
        Hour of the test, for the message.
    present
        False: the alarm returns to normal.
    """
    message = f"Dashboard not responding. No heartbeat (hour {hour:.1f})."
    action = "Read `logs/`, then restart `solimon serve`."
    return Condition(
        kind=WEB_NOT_RESPONDING,
        priority="medium",
        present=present,
        message=f"{message} {action}",
    )
