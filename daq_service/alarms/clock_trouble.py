"""The alarm of an unverified computer clock."""

from __future__ import annotations

from daq_service.alarms.states import Condition

CLOCK_UNVERIFIED = "clock_unverified"


def build_clock_condition(reason: str) -> Condition:
    """Return the condition ``clock_unverified`` (priority high): the recorder waits for a verified clock.

    Parameters
    ----------
    reason
        Why the system's clock is unverified; empty: it is verified, and the condition is not present.
    """
    return Condition(
        kind=CLOCK_UNVERIFIED,
        priority="high",
        present=bool(reason),
        evidence={"reason": reason},
    )
