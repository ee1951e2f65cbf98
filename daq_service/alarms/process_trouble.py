"""Alarms of a process that does not run, raised by another one."""

from __future__ import annotations

from daq_service.alarms.states import Condition

RECORDER_NOT_RUNNING = "recorder_not_running"
WEB_NOT_RESPONDING = "web_not_responding"


def build_recorder_condition(finding: str, hour: float) -> Condition:
    """Return the condition of a missing recorder; it ends when a scheduled set is stored.

    Parameters
    ----------
    finding
        Evidence that it is missing; empty when a set is stored.
    hour
        Of the test, h.
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
    """Return the condition of a web service of this test that stalls, or has ended without notice.

    Parameters
    ----------
    hour
        Of the test, h.
    """
    message = f"Dashboard not responding. No heartbeat (hour {hour:.1f})."
    action = "Read `logs/`, then restart `solimon serve`."
    return Condition(
        kind=WEB_NOT_RESPONDING,
        priority="medium",
        present=present,
        message=f"{message} {action}",
    )
