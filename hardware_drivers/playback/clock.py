"""Clock of a recording: the recorded times as the test's time."""

from __future__ import annotations

from collections.abc import Callable

from hardware_drivers.instruments import Clock
from hardware_drivers.nanoseconds import NS_PER_S


class RecordedClock:
    """Clock that stops at the recorded moments: a replayed shot has the time of its strike.

    A real rig strikes a little after each planned time. This clock waits for the recorded moment that
    belongs to the planned time, where there is one; otherwise for the planned time itself.

    Parameters
    ----------
    clock
        Passes the time: one that jumps, or one that is paced. It must be able to stand at a past time.
    next_moment
        First recorded moment after a time, ns of UTC; None after the last one.
    tolerance_s
        A moment at most this long after the planned time belongs to it: half the interval of the strikes,
        so that a strike that was missed does not borrow the time of the next one.
    """

    def __init__(
        self, clock: Clock, next_moment: Callable[[int], int | None], *, tolerance_s: float = 2.0
    ) -> None:
        """Store clock and recorded moments; ValueError if ``tolerance_s`` (s) is negative or NaN."""
        if not tolerance_s >= 0.0:
            raise ValueError(f"tolerance_s is {tolerance_s}; it must be at least 0")
        self._clock = clock
        self._next_moment = next_moment
        self._tolerance_ns = round(tolerance_s * NS_PER_S)

    def utc_ns(self) -> int:
        """Return the test time (UTC) in ns: that of the recorded moment or planned time reached last."""
        return self._clock.utc_ns()

    def mono_ns(self) -> int:
        """Return the monotonic time of the underlying clock, ns."""
        return self._clock.mono_ns()

    def wait_until(self, utc_ns: int, idle: Callable[[], bool]) -> bool:
        """Wait for the recorded moment at most ``tolerance_s`` after ``utc_ns``, else for ``utc_ns`` itself.

        Return False as soon as ``idle()`` returns False, else True.
        """
        # Each moment belongs to one wait: the next one lies after now, and not before the planned time.
        moment_ns = self._next_moment(max(self._clock.utc_ns(), utc_ns - 1))
        if moment_ns is not None and moment_ns - utc_ns <= self._tolerance_ns:
            return self._clock.wait_until(moment_ns, idle)
        return self._clock.wait_until(utc_ns, idle)
