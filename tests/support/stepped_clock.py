"""A simulated clock for a test in real time."""

from __future__ import annotations

import time
from collections.abc import Callable

from hardware_drivers.instruments import Clock

STEP_NS, LOOK_NS, PAUSE_NS = 50_000_000, 1_000, 1_000_000_000


class SteppedClock:
    """Clock that advances by one step whenever the recorder waits."""

    def __init__(self) -> None:
        self._now_ns = 0

    def start(self, before: object = None) -> Clock:
        """Start a run, later than the run before it."""
        self._now_ns = max(time.time_ns(), self._now_ns + PAUSE_NS)
        return self

    def utc_ns(self) -> int:
        self._now_ns += LOOK_NS
        return self._now_ns

    def mono_ns(self) -> int:
        return self.utc_ns()

    def wait_until(self, utc_ns: int, idle: Callable[[], bool]) -> bool:
        while self._now_ns < utc_ns:
            if not idle():
                return False
            self._now_ns = max(self._now_ns, min(utc_ns, self._now_ns + STEP_NS))
        return idle()
