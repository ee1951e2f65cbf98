"""The alarm of a clock that cannot be believed."""

from __future__ import annotations

from daq_service.alarms.states import Condition

CLOCK_DOUBTED = "clock_doubted"


def doubt_condition(reason: str) -> Condition:
    """Alarm while the recorder waits for a set clock; it takes no set and writes no gap meanwhile.

    Parameters
    ----------
    reason
        Why the system's clock is doubted; empty: it is not, or no longer.
    """
    return Condition(
        kind=CLOCK_DOUBTED,
        severity="high",
        present=bool(reason),
        message=f"{reason}; the test waits until it is set, or trusted with `solimon trust-clock`",
    )
