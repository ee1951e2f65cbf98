"""The alarms of a process that is missing, raised by one that is left."""

from __future__ import annotations

from daq_service.alarms.states import Condition
from daq_service.catalogue.rows import Severity

RECORDER_NOT_RUNNING, WEB_NOT_RESPONDING = "recorder_not_running", "web_not_responding"


def recorder_condition(finding: str, hour: float) -> Condition:
    """Alarm from the moment at which the recorder is missing until a planned set is stored.

    Parameters
    ----------
    finding
        What shows that it is missing; empty: a set is stored.
    hour
        Of the test, h.
    """
    message = f"Recorder not running, sets are missed. {finding} (hour {hour:.1f})."
    action = "Read `logs/`, then run `solimon run`."
    return _condition(RECORDER_NOT_RUNNING, "high", f"{message} {action}", present=bool(finding))


def web_condition(hour: float, *, present: bool) -> Condition:
    """Alarm while a web service that has served this test stalls, or has ended without notice.

    Parameters
    ----------
    hour
        Of the test, h.
    """
    message = f"Dashboard not responding. No heartbeat (hour {hour:.1f})."
    action = "Read `logs/`, then restart `solimon serve`."
    return _condition(WEB_NOT_RESPONDING, "medium", f"{message} {action}", present=present)


def _condition(kind: str, severity: Severity, message: str, *, present: bool) -> Condition:
    return Condition(
        position=None, kind=kind, family="device", severity=severity, present=present, message=message
    )
