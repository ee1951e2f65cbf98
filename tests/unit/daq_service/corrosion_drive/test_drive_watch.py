"""The supply seen from the line: the interlock after a restart, and the supply at the end of a test."""

import pytest
from support.invented_rows import condition
from support.scripted_supply import supply_parameters
from support.serial_rig import TestClock

from daq_service.alarms.operator_actions import acknowledge_alarm
from daq_service.alarms.states import Moment, update_alarm
from daq_service.corrosion_drive.watch import DriveWatch
from daq_service.settings.rig import RigSettings
from hardware_drivers.errors import ConnectionLostError
from hardware_drivers.instruments import Rig
from hardware_drivers.measurement import SupplyReading

MOMENT = Moment(utc_ns=0, due_h=1.0, set_index=None)


class Supply:
    """Supply double that is on; ``error`` is raised by each read."""

    def __init__(self, clock):
        self.clock, self.on, self.error = clock, True, None

    def read(self, timeout_s):
        return SupplyReading(stamp=self.clock.stamp(), voltage_v=10.0, current_a=0.2, output_on=self.on)

    def make_safe(self):
        if self.error is not None:
            raise self.error
        self.on = False

    def energise(self, voltage_v, current_limit_a):
        self.on = True


class EmptyCatalogue:
    """Catalogue double without a row of the supply."""

    def read_last_environment(self):
        return None


def trip_alarm(*, acknowledged=False):
    """Return the stored alarm of a tripped interlock."""
    tripped = condition(position=None, kind="interlock_tripped", evidence={"trip_reason": "hole at B"})
    row = update_alarm(None, tripped, MOMENT).row
    return acknowledge_alarm(row, "Ada", "", MOMENT).row if acknowledged else row


def start_watch(*alarms, off_at_end=False):
    """Return a watch started with these alarms, its supply and the stored rows."""
    clock = TestClock()
    supply, stored = Supply(clock), []
    settings = RigSettings(supply=supply_parameters(off_at_end=off_at_end))
    rig = Rig(kind="simulated", clock=clock, striker=None, digitizer=None, supply=supply)
    known = {(row.position, row.kind): row for row in alarms}

    def carry(condition, moment, transaction):
        change = update_alarm(known.get((condition.position, condition.kind)), condition, moment)
        if change is not None:
            transaction.add_alarm(change.row, change.event(moment))

    return DriveWatch(settings, rig, EmptyCatalogue(), known, carry, stored.append), supply, stored


@pytest.mark.parametrize("acknowledged", [False, True])
def test_an_active_trip_keeps_the_interlock_tripped_after_a_restart(acknowledged):
    watch, supply, _ = start_watch(trip_alarm(acknowledged=acknowledged))
    watch.tick(2.0)
    assert not supply.on
    assert watch.summarise_readings()["supply_tripped"] == "hole at B"


def test_an_alarm_is_stored_when_it_changes_and_once():
    watch, supply, stored = start_watch()
    answer = watch.supply_on("Ada", 0.5, voltage_v=None, current_limit_a=None)
    assert answer() == "the supply is on, read back as commanded"
    watch.tick(1.0)
    assert (supply.on, stored) == (True, [])
    watch.trip("hole at B", 1.5)
    (transaction,) = stored
    assert [(row.kind, row.raised_h) for row in transaction.alarms] == [("interlock_tripped", 1.5)]
    assert not supply.on


@pytest.mark.parametrize(
    ("off_at_end", "error", "expected", "on"),
    [
        (True, None, "the supply is off", False),
        (False, None, "", True),
        (True, ConnectionLostError("gone"), "the supply may still be on, switch it off by hand: gone", True),
    ],
)
def test_the_end_of_a_test_leaves_the_supply_as_configured(off_at_end, error, expected, on):
    watch, supply, _ = start_watch(off_at_end=off_at_end)
    supply.error = error
    assert watch.switch_off_at_end() == expected
    assert supply.on is on
