"""What no double can prove of the supply: that it follows its dialect, and always switches off.

The first tests only ask. The others put some volts on a resistor that is wired in place of the specimen; they
come only where ``SOLIMON_TEST_LOAD_OHM`` says that it is there, and each ends with the output off, read back.
"""

from __future__ import annotations

import math
from contextlib import contextmanager
from dataclasses import dataclass, replace

import pytest

from daq_service.cli.doctor.check import read_time_stamp
from daq_service.clock import WallClock
from daq_service.corrosion_drive.charge import DriveState
from daq_service.corrosion_drive.drive import SupplyLogger
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.nanoseconds import NS_PER_S
from hardware_drivers.serial_port.parameters import SupplyParameters
from hardware_drivers.serial_port.power_supply import ScpiPowerSupply

READ_TIMEOUT_S = 10.0
"""Slow supplies take a tenth of a second an answer."""
MOST_W = 1.0
"""Into the resistor: one of 2 W stays below its rating."""
LOAD_TOLERANCE = 0.1
"""Of the resistor with its leads, warm."""
TRIPS_WITHIN = 20
"""Readings: three in a row trip the interlock, the first ones read back what was found."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """Resistor at the output, with its voltage and current."""

    resistance_ohm: float
    parameters: SupplyParameters

    @property
    def voltage_v(self):
        """Return the voltage of the supply, reduced where the resistor would become warm."""
        return min(self.parameters.voltage_v, math.sqrt(MOST_W * self.resistance_ohm))

    @property
    def current_a(self):
        """Return the current at that voltage."""
        return self.voltage_v / self.resistance_ohm


@pytest.fixture
def supply(supply_parameters):
    """Yield the supply; check that it is off before and after."""
    opened = ScpiPowerSupply(supply_parameters, stamp=read_time_stamp)
    try:
        if opened.read(supply_parameters.read_timeout_s).output_on:
            pytest.fail(
                "the output is on: somebody's test? switch it off at the instrument, then start again"
            )
        try:
            yield opened
        finally:
            opened.make_safe()
    finally:
        opened.close()


@pytest.fixture
def load(supply_parameters, load_ohm):
    """Return the current of the resistor, limited by the caps of the configuration."""
    its = Load(resistance_ohm=load_ohm, parameters=supply_parameters)
    if 2.0 * its.current_a > supply_parameters.current_cap_a:
        pytest.fail(
            f"{load_ohm:g} ohm take {its.current_a:.3g} A: give a resistor that needs half of current_cap_a"
        )
    return its


@contextmanager
def energised(supply, voltage_v, current_limit_a):
    """Switch the output on within this block only."""
    try:
        supply.energise(voltage_v, current_limit_a)
        yield supply.read(READ_TIMEOUT_S)
    finally:
        supply.make_safe()


def is_off(supply):
    """Return whether both queries read the output back as off."""
    reading = supply.read(READ_TIMEOUT_S)
    state = supply.read_back(READ_TIMEOUT_S)
    return not reading.output_on and state["output"] == "off"


# Nothing is energised -------------------------------------------------------------------------------


def test_the_supply_reports_its_identity_and_setpoints(supply):
    identity = supply.identity()
    assert identity["maker"] or identity["model"]
    state = supply.read_back(READ_TIMEOUT_S)
    assert state["output"] == "off"
    assert state["tripped"] == "", "clear the protection at the instrument first"
    assert float(state["set_voltage_v"]) >= 0.0
    assert float(state["set_current_limit_a"]) > 0.0


def test_a_command_above_the_caps_sets_nothing(supply, supply_parameters):
    before = supply.read_back(READ_TIMEOUT_S)
    with pytest.raises(ConfigurationError, match="nothing was sent"):
        supply.energise(1.01 * supply_parameters.voltage_cap_v, supply_parameters.current_limit_a)
    with pytest.raises(ConfigurationError, match="nothing was sent"):
        supply.energise(supply_parameters.voltage_v, 1.01 * supply_parameters.current_cap_a)
    assert supply.read_back(READ_TIMEOUT_S) == before


# A resistor is wired to the output ------------------------------------------------------------------


def test_it_holds_its_voltage_and_reads_back_what_was_set(supply, load):
    parameters = load.parameters
    with energised(supply, load.voltage_v, 2.0 * load.current_a) as reading:
        state = supply.read_back(READ_TIMEOUT_S)
    assert reading.output_on
    assert reading.voltage_v == pytest.approx(load.voltage_v, abs=parameters.readback_tolerance_v)
    assert reading.current_a == pytest.approx(
        load.current_a, rel=LOAD_TOLERANCE, abs=parameters.readback_tolerance_a
    )
    assert float(state["set_voltage_v"]) == pytest.approx(load.voltage_v, abs=parameters.readback_tolerance_v)
    assert state["output"] == "on"
    assert is_off(supply)


def test_its_limit_holds_the_current_and_lets_the_voltage_go(supply, load):
    parameters, limit_a = load.parameters, 0.5 * load.current_a
    with energised(supply, load.voltage_v, limit_a) as reading:
        pass
    assert reading.output_on
    assert reading.current_a == pytest.approx(limit_a, abs=parameters.readback_tolerance_a)
    held_v = limit_a * load.resistance_ohm
    slack_v = parameters.readback_tolerance_a * load.resistance_ohm + parameters.readback_tolerance_v
    assert reading.voltage_v == pytest.approx(held_v, rel=LOAD_TOLERANCE, abs=slack_v)
    assert is_off(supply)


def test_the_interlock_switches_off_at_its_current(supply, load):
    """As a hole or a short circuit would: the drive itself reads, trips, switches off and stays off."""
    parameters = replace(load.parameters, interlock_current_a=0.5 * load.current_a, log_interval_s=0.1)
    clock = WallClock()
    drive = SupplyLogger(supply, clock, parameters, DriveState())
    drive.energise("pytest -m hardware", voltage_v=load.voltage_v, current_limit_a=2.0 * load.current_a)
    for _ in range(TRIPS_WITHIN):
        drive.tick()
        if drive.tripped is not None:
            break
        clock.wait_until(clock.utc_ns() + round(0.11 * NS_PER_S), lambda: True)
    assert drive.tripped is not None
    assert f"interlock_current_a = {parameters.interlock_current_a:g} A" in drive.tripped
    assert is_off(supply)
    drive.tick()
    assert is_off(supply), "nothing but a person's order switches it on again"


def test_a_failure_while_the_output_is_on_switches_it_off(supply, load):
    class FellOverError(Exception):
        """Any error of a user of the supply."""

    with pytest.raises(FellOverError), energised(supply, load.voltage_v, 2.0 * load.current_a):
        raise FellOverError
    assert is_off(supply)


def test_a_restarted_driver_finds_the_output_on_and_switches_it_off(supply, load):
    """A process that ended leaves the output as it is; who comes next sees that before it does anything."""
    try:
        supply.energise(load.voltage_v, 2.0 * load.current_a)
        supply.close()
        assert supply.read(READ_TIMEOUT_S).output_on
    finally:
        supply.make_safe()
    assert is_off(supply)
