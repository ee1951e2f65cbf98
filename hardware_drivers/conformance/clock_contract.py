"""Rules for every clock of a test: inherit `ClockContract` and provide its fixtures."""

from __future__ import annotations

import itertools

from hardware_drivers.instruments import Clock

NS_PER_S = 1_000_000_000


class ClockContract:
    """Rules for a clock: time passes during a wait, and never runs back.

    A class that inherits the rules provides these fixtures.

    Fixtures
    --------
    clock : Clock
        The clock under test.
    """

    AHEAD_S = 0.0
    """Experiment seconds to wait for: several looks around (0.2 s of wall time each) if time is real."""

    def test_is_a_clock(self, clock: Clock) -> None:
        """Check that the clock has the methods of `Clock`."""
        assert isinstance(clock, Clock)

    def test_times_are_whole_nanoseconds_that_never_run_back(self, clock: Clock) -> None:
        """Check that times are of type int, and that monotonic time does not decrease."""
        utc_ns = [clock.utc_ns() for _ in range(5)]
        mono_ns = [clock.mono_ns() for _ in range(5)]
        assert all(type(t) is int for t in (*utc_ns, *mono_ns))
        assert mono_ns == sorted(mono_ns)

    def test_waiting_reaches_the_time(self, clock: Clock) -> None:
        """Check that a wait of `AHEAD_S` returns True at its time; monotonic time does not go back."""
        target_ns = clock.utc_ns() + round(self.AHEAD_S * NS_PER_S)
        mono_ns = clock.mono_ns()
        assert clock.wait_until(target_ns, lambda: True) is True
        assert clock.utc_ns() >= target_ns
        assert clock.mono_ns() >= mono_ns

    def test_a_time_in_the_past_is_reached_at_once_and_changes_nothing(self, clock: Clock) -> None:
        """Check that a wait for a past time returns True and does not set the clock back."""
        now_ns = clock.utc_ns()
        assert clock.wait_until(now_ns - 3600 * NS_PER_S, lambda: True) is True
        assert clock.utc_ns() >= now_ns

    def test_a_wait_calls_idle(self, clock: Clock) -> None:
        """Check that a wait calls ``idle`` at least once, and at least once per 0.2 s of `AHEAD_S`."""
        looks = itertools.count()
        clock.wait_until(clock.utc_ns() + round(self.AHEAD_S * NS_PER_S), lambda: next(looks) >= 0)
        # At least every 0.2 s of wall time; a clock that jumps looks around once.
        assert next(looks) >= max(1, int(self.AHEAD_S / 0.2))

    def test_waiting_ends_as_soon_as_the_caller_wants(self, clock: Clock) -> None:
        """Check that a wait returns False after the first ``idle()`` that returns False."""
        looks = itertools.count()
        century_ns = 100 * 365 * 86_400 * NS_PER_S
        assert clock.wait_until(clock.utc_ns() + century_ns, lambda: next(looks) < 0) is False
        assert next(looks) == 1
