"""What an order to switch on demands of the supply, against a supply that answers by a table: no line."""

from dataclasses import replace

import pytest

from hardware_drivers.errors import ConfigurationError, ConnectionLostError
from hardware_drivers.measurement import Stamp
from hardware_drivers.serial_port.parameters import SerialLineParameters, SupplyParameters
from hardware_drivers.serial_port.power_supply import ScpiPowerSupply

PARAMETERS = SupplyParameters(line=SerialLineParameters(port="COM1"), identity="ACME,PSU,1")


class AnsweringLine:
    """The supply's end of the line: it stores commands, and may falsify one answer."""

    name = "the supply"
    in_step = True

    def __init__(self, **lies):
        self.values = {"VOLT": 0.0, "CURR": 0.0, "OUTP": False}
        self.lies = lies
        self.sent = []

    def connect(self, deadline_s, *, at_once=False):
        return False

    def monotonic_s(self):
        return 0.0

    def send(self, command):
        self.sent.append(command)
        word, value = command.split()
        self.values[word] = value == "ON" if word == "OUTP" else float(value)

    def query_number(self, question, deadline_s, **_):
        number = self.values[question.rstrip("?").removeprefix("MEAS:")]
        return number + self.lies.get(question, 0.0)

    def query_flag(self, question, deadline_s, **_):
        return self.values["OUTP"] if question == "OUTP?" else question in self.lies

    def query_error(self, question, deadline_s, **_):
        return None


def supply_on(line):
    supply = ScpiPowerSupply(PARAMETERS, stamp=lambda: Stamp(utc_ns=0, mono_ns=0, boot_id="test"))
    supply._line = line  # instead of a serial port
    return supply


def test_a_setpoint_within_the_tolerance_is_accepted_and_the_limit_is_set_first():
    line = AnsweringLine(**{"VOLT?": 0.049, "CURR?": -0.019, "MEAS:VOLT?": 0.049})
    supply_on(line).energise(10.0, 1.0)
    assert line.sent == ["OUTP OFF", "CURR 1", "VOLT 10", "OUTP ON"]


@pytest.mark.parametrize(
    ("question", "off_by", "message"),
    [
        ("VOLT?", 0.051, r"set to 10 V and reads back 10.051 V: more than 0.05 V off"),
        ("VOLT?", -0.051, r"set to 10 V and reads back 9.949 V"),
        ("CURR?", 0.021, r"set to 1 A and reads back 1.021 A: more than 0.02 A off"),
        ("MEAS:VOLT?", 0.051, r"gives 10.051 V; at most 10.05 V was asked for"),
        ("MEAS:CURR?", 0.021, r"gives 1.021 A; at most 1.02 A was asked for"),
    ],
)
def test_a_setpoint_outside_the_tolerance_is_switched_off(question, off_by, message):
    line = AnsweringLine(**{question: off_by})
    with pytest.raises(ConfigurationError, match=message + ".*; the output is off"):
        supply_on(line).energise(10.0, 1.0)
    assert line.sent[-1] == "OUTP OFF"
    assert line.values["OUTP"] is False


def test_a_tripped_protection_is_not_reset():
    line = AnsweringLine(**{"CURR:PROT:TRIP?": True})
    with pytest.raises(ConfigurationError, match=r"has tripped .*; the output was left as it was"):
        supply_on(line).energise(10.0, 1.0)
    assert line.sent == []


@pytest.mark.parametrize(
    ("changes", "unknown"),
    [
        ({}, ""),
        ({"protection_queries": ()}, "dialect scpi asks no protection"),
        ({"dialect": "korad"}, "dialect korad asks no protection"),
    ],
)
def test_a_protection_that_is_not_queried_is_reported_as_unknown(changes, unknown):
    supply = ScpiPowerSupply(
        replace(PARAMETERS, **changes), stamp=lambda: Stamp(utc_ns=0, mono_ns=0, boot_id="test")
    )
    assert supply.protection_unknown.startswith(unknown)
    assert bool(supply.protection_unknown) == bool(unknown)


class StuckLine(AnsweringLine):
    """A supply whose output stays on after any command."""

    def query_flag(self, question, deadline_s, **_):
        return question == "OUTP?"

    def mark_lost(self, message):
        return ConnectionLostError(message)


def test_an_output_that_reads_back_as_on_is_never_reported_as_off():
    line = StuckLine()
    with pytest.raises(
        ConnectionLostError, match=r"what its output does is unknown: .* reports that it is on"
    ):
        supply_on(line).make_safe()
    assert line.sent == ["OUTP OFF", "OUTP OFF"]  # tried again
