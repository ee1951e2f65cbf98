"""Both clocks keep the contract."""

import pytest

from daq_service.clock import WallClock
from hardware_drivers.conformance.clock_contract import ClockContract
from simulator.clock import SimulatedClock

EPOCH_NS = 1_704_067_200_000_000_000


class TestWallClock(ClockContract):
    AHEAD_S = 0.45

    @pytest.fixture
    def clock(self):
        return WallClock()


class TestJumpingClock(ClockContract):
    AHEAD_S = 0.0

    @pytest.fixture
    def clock(self):
        return SimulatedClock(EPOCH_NS)

    def test_waiting_jumps(self, clock):
        assert clock.wait_until(EPOCH_NS + 10**15, lambda: True) is True
        assert clock.utc_ns() == clock.mono_ns() == EPOCH_NS + 10**15


class TestWalkingClock(ClockContract):
    """Paced: wall time is a counter that only sleeping moves, so the test does not wait."""

    @pytest.fixture
    def clock(self):
        wall_ns = [0]

        def sleep(seconds):
            wall_ns[0] += round(seconds * 1e9)

        return SimulatedClock(EPOCH_NS, pace_h_per_s=5.0, mono_ns=lambda: wall_ns[0], sleep=sleep)

    # An hour and a half of experiment in 0.3 s of wall time: at least one look around on the way.
    AHEAD_S = 0.3 * 5.0 * 3600.0

    def test_a_wait_calls_idle(self, clock):
        looks = []
        clock.wait_until(clock.utc_ns() + round(self.AHEAD_S * 1e9), lambda: not looks.append(1))
        assert len(looks) >= int(0.3 / 0.2)
