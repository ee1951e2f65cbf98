"""Experiment time that jumps to the next due time, or walks there at a pace so that a person can watch."""

from __future__ import annotations

import time
from collections.abc import Callable

from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S

LATE_S = 2.0
"""A clock that is later than this does not keep its pace."""
IDLE_INTERVAL_S = 0.2
"""Longest wait between two calls of ``idle`` (`hardware_drivers.instruments.Clock`)."""


class SimulatedClock:
    """Clock whose time passes only while a caller waits.

    Parameters
    ----------
    start_utc_ns
        First reading; a resumed experiment passes the time of its last committed row.
    pace_h_per_s
        Hours of experiment a second of wall time; None jumps.
    mono_ns, sleep
        Monotonic time of the computer, and how it waits.
    """

    def __init__(
        self,
        start_utc_ns: int,
        *,
        pace_h_per_s: float | None = None,
        mono_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Start the clock at ``start_utc_ns``; raise ValueError for a pace that is not positive."""
        if pace_h_per_s is not None and not pace_h_per_s > 0.0:
            raise ValueError(f"pace_h_per_s is {pace_h_per_s}; it must be positive, or None to jump")
        self._utc_ns = start_utc_ns
        self._pace_h_per_s = pace_h_per_s
        self._mono_ns, self._sleep = mono_ns, sleep
        # Where experiment time met wall time last: pacing is measured from here, so that the
        # time spent on striking and storing is part of the pace and not added to it. The first wait sets
        # it: a rig takes a while to open.
        self._anchor: tuple[int, int] | None = None

    def utc_ns(self) -> int:
        """Return the experiment time as UTC in ns since the Unix epoch."""
        return self._utc_ns

    def mono_ns(self) -> int:
        """Return the experiment time as monotonic time in ns; a simulated clock is never set back."""
        return self._utc_ns

    def finish_now(self) -> None:
        """Stop pacing: later waits jump to their end."""
        self._pace_h_per_s = None

    def measure_late_pace_h_per_s(self) -> float | None:
        """Return the mean pace in h per s since the first wait if the set one is not kept, else None."""
        if self._pace_h_per_s is None or self._anchor is None:
            return None
        test_h, wall_s = (
            (self._utc_ns - self._anchor[0]) / NS_PER_H,
            (self._mono_ns() - self._anchor[1]) / NS_PER_S,
        )
        return test_h / wall_s if wall_s - test_h / self._pace_h_per_s > LATE_S else None

    def wait_until(self, utc_ns: int, idle: Callable[[], bool]) -> bool:
        """Wait until ``utc_ns`` at the set pace, or jump; return False once ``idle`` returns False.

        ``idle`` is called at least every 0.2 s of wall time, and at the end. If it ends the wait early, the
        time does not advance. A past time is reached at once.
        """
        anchor = self._anchor = self._anchor or (self._utc_ns, self._mono_ns())
        while self._pace_h_per_s is not None and utc_ns > self._utc_ns:
            due_wall_ns = anchor[1] + (utc_ns - anchor[0]) / (self._pace_h_per_s * NS_PER_H) * NS_PER_S
            left_s = (due_wall_ns - self._mono_ns()) / NS_PER_S
            if left_s <= 0.0:
                break
            if not idle():
                return False
            self._sleep(min(left_s, IDLE_INTERVAL_S))
        self._utc_ns = max(self._utc_ns, utc_ns)
        return idle()
