"""What is planned after a strike is what `take_set` strikes."""

from itertools import islice

import pytest

from daq_service.acquisition.schedule import DueSet
from daq_service.acquisition.take_set import SetPlan, strikes_after, take_set
from hardware_drivers.errors import AcquisitionTimeoutError
from hardware_drivers.instruments import Rig
from hardware_drivers.measurement import ShotKey

NS_PER_S = 1_000_000_000
INTERVAL_S = 2.5
SETS = [DueSet(set_index=k, due_h=0.5 + k, due_utc_ns=(1_800 + 3_600 * k) * NS_PER_S) for k in range(4)]


class Clock:
    """Simulated time."""

    def __init__(self):
        self.now_ns = 0

    def utc_ns(self):
        return self.now_ns

    mono_ns = utc_ns

    def wait_until(self, utc_ns, idle):
        self.now_ns = max(self.now_ns, utc_ns)
        return idle()


class Deaf:
    """Striker and digitizer that note each strike and hear nothing."""

    def __init__(self, clock):
        self.clock = clock
        self.strikes = []

    def arm(self, key):
        self.armed = key

    def strike(self, key):
        assert key == self.armed
        self.strikes.append((key, self.clock.utc_ns()))

    def read(self, timeout_s):
        raise AcquisitionTimeoutError("nothing came")

    def disarm(self):
        self.armed = None

    def make_safe(self):
        self.armed = None


def struck(positions, shots_per_set):
    """Strikes of every set, as `take_set` makes them."""
    clock = Clock()
    deaf = Deaf(clock)
    rig = Rig(kind="simulated", clock=clock, striker=deaf, digitizer=deaf)
    for due in SETS:
        plan = SetPlan(
            due=due,
            positions=dict.fromkeys(positions, "solitary_wave"),
            shots_per_set=shots_per_set,
            shot_interval_s=INTERVAL_S,
            read_timeout_s=1.0,
        )
        list(take_set(rig, plan, first_sequence=1, boot_id="test", idle=lambda: True))
    return deaf.strikes


def planned(positions, shots_per_set):
    return strikes_after(SETS, positions, shots_per_set=shots_per_set, shot_interval_s=INTERVAL_S)


@pytest.mark.parametrize("number", [0, 3, 4, 12, 31])
def test_the_plan_is_what_take_set_strikes(number):
    strikes = struck(("B", "C"), 4)
    assert len(strikes) == len(SETS) * 2 * 4
    assert list(planned(("B", "C"), 4)(*strikes[number])) == strikes[number + 1 :]


def test_a_shot_outside_the_schedule_is_followed_by_nothing():
    plan = planned(("B",), 4)
    assert list(plan(ShotKey(position="X", set_index=0, shot_index=0), 0)) == []
    assert list(plan(ShotKey(position="B", set_index=0, shot_index=4), 0)) == []


def test_a_repetition_is_followed_by_what_its_first_attempt_is_followed_by():
    plan = planned(("B", "C"), 4)
    first = ShotKey(position="B", set_index=1, shot_index=2)
    again = ShotKey(position="B", set_index=1, shot_index=2, attempt=1)
    later_ns = 1_000 * NS_PER_S
    keys = [key for key, _ in plan(first, later_ns)]
    assert [key for key, _ in plan(again, later_ns)] == keys
    # One interval on from the repetition, not from the first attempt.
    assert next(islice(plan(again, later_ns), 1))[1] == later_ns + round(INTERVAL_S * NS_PER_S)
