"""The corrosion drive on real lines: what the supply's own record of its output says after each fault."""

import pytest
from support.serial_rig import NO_TERMINALS, SerialRig

from daq_service.corrosion_drive.charge import DriveState, restored_state
from daq_service.corrosion_drive.climate import ClimateLog
from daq_service.corrosion_drive.drive import SupplyLogger, summary
from simulator.doubles.serial.supply import Cell

pytestmark = pytest.mark.skipif(bool(NO_TERMINALS), reason=NO_TERMINALS)

CURRENT_A = 8.5 / 40.0
"""Of the double's cell at 10 V; it drifts by 0.1 % an hour of the machine's time, so by nothing here."""


class DriveRig(SerialRig):
    """Supply on the doubles, ticked as by an idle recorder."""

    def __init__(self, folder, **supply):
        super().__init__(folder, **supply)
        self.drive = self.new_drive(DriveState())

    def new_drive(self, state):
        self.climate_log = ClimateLog(self.climate, self.clock, self.climate_parameters)
        return SupplyLogger(self.supply, self.clock, self.supply_parameters, state)

    def summary(self):
        return summary(self.climate_log.add_to_row(self.drive.row(0, 0.0)))

    def run(self, seconds):
        for _ in range(round(seconds)):
            self.drive.tick()
            self.climate_log.tick()
            self.clock.advance(1.0)

    def active(self):
        return {condition.name for condition in self.drive.conditions() if condition.active}


@pytest.fixture
def rig(tmp_path):
    with DriveRig(tmp_path) as rig:
        rig.drive.energise("Ada")
        rig.run(100.0)
        yield rig
        commanded = [cause for on, cause in rig.switched() if on and cause == "command"]
        assert commanded == ["command"], "one command, one switching on"


def test_charge_and_climate_come_from_the_instruments(rig):
    row = rig.summary()
    assert row["supply_state"] == "on"
    assert row["charge_coulomb"] == pytest.approx(90.0 * CURRENT_A, rel=1e-4)  # printed digits and drift
    assert row["temperature_c"] == pytest.approx(22.0, abs=0.1)  # a day's slow swing
    assert rig.active() == set()


def test_an_unplugged_supply_is_unknown_then_lost_then_found_on(rig):
    rig.instruments.supply_link.unplug()
    rig.run(10.0)
    assert rig.drive.output() == "unknown"
    rig.run(30.0)
    assert rig.active() == {"supply_not_responding"}
    rig.instruments.supply_link.plug()
    rig.run(60.0)
    assert rig.drive.output() == "on"
    assert rig.active() == set()
    assert rig.summary()["unknown_s"] > 30.0
    assert rig.switched() == [(True, "command")]


def test_a_supply_lost_for_long_is_switched_off_when_it_is_back(rig):
    rig.instruments.supply_link.unplug()
    rig.run(320.0)
    assert rig.active() == {"supply_not_responding", "interlock_tripped", "supply_switch_off_pending"}
    rig.instruments.supply_link.plug()
    rig.run(20.0)
    assert rig.switched() == [(True, "command"), (False, "command")]
    assert rig.active() == {"interlock_tripped"}


def test_a_brown_out_is_reported_and_not_corrected(rig):
    rig.instruments.brown_out()
    rig.run(60.0)
    assert rig.active() == {"supply_off_unexpectedly"}
    assert rig.switched() == [(True, "command"), (False, "brown-out")]
    rig.instruments.supply_link.do(lambda: rig.instruments.supply.press_output_key(True))  # and back on
    rig.run(10.0)
    assert not rig.instruments.supply.on
    assert "supply_on_unexpectedly" in rig.active()


def test_a_tripped_protection_is_named(rig):
    rig.instruments.supply_link.do(rig.instruments.supply.trip)
    rig.run(20.0)
    message = next(c.message for c in rig.drive.conditions() if c.name == "supply_off_unexpectedly")
    assert "CURR:PROT:TRIP?" in message


def test_a_short_circuit_trips_the_interlock(rig):
    rig.instruments.supply_link.do(lambda: setattr(rig.instruments.supply, "cell", Cell(resistance_ohm=1.0)))
    rig.run(10.0)
    assert rig.active() == {"supply_current_limit"}
    rig.run(30.0)
    assert rig.active() == {"interlock_tripped"}
    assert rig.switched() == [(True, "command"), (False, "command")]


@pytest.mark.parametrize("fault", [{"garbage": 1}, {"hold": 1}, {"silent": True}])
def test_one_bad_answer_is_no_alarm_and_costs_no_charge(rig, fault):
    before = rig.summary()["charge_coulomb"]
    rig.instruments.supply_link.inject(**fault)
    rig.run(10.0)
    assert rig.active() == set()
    rig.instruments.supply_link.clear_faults()
    rig.run(20.0)
    row = rig.summary()
    assert (row["supply_state"], row["unknown_s"]) == ("on", 0.0)
    assert row["charge_coulomb"] - before == pytest.approx(30.0 * CURRENT_A, rel=1e-4)  # as above


def test_another_instrument_at_the_port_is_lost_and_receives_no_command(rig):
    rig.instruments.supply_link.unplug()
    rig.instruments.supply_link.do(lambda: setattr(rig.instruments.supply, "identity", "OTHER,THING,7,2.0"))
    rig.instruments.supply_link.plug()
    before = len(rig.heard())
    rig.run(400.0)
    assert rig.active() == {"supply_not_responding", "interlock_tripped", "supply_switch_off_pending"}
    assert set(rig.heard()[before:]) == {"*IDN?"}


def test_a_port_that_another_program_took_is_lost_and_says_to_whom(rig):
    rig.supply.close()
    thief = rig.new_supply()
    thief.read(1.0)
    rig.run(40.0)
    assert rig.active() == {"supply_not_responding"}
    message = next(c.message for c in rig.drive.conditions() if c.name == "supply_not_responding")
    assert f"{rig.instruments.supply_link.path} is in use by" in message
    thief.close()
    rig.run(60.0)
    assert rig.active() == set()
    assert rig.drive.output() == "on"


def test_a_restarted_recorder_finds_the_supply_as_it_was(rig):
    row, written_ns = rig.drive.row(0, 0.0), rig.clock.utc_ns()
    rig.supply.close()
    heard = len(rig.heard())
    rig.drive = rig.new_drive(
        restored_state(row, written_utc_ns=written_ns, parameters=rig.supply_parameters)
    )
    rig.run(20.0)
    assert rig.drive.output() == "on"
    assert all(command.endswith("?") for command in rig.heard()[heard:]), "asked, never told"
