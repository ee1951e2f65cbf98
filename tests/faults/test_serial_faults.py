"""Faults of serial lines: each the right error, a way back, and never a supply that comes on by itself."""

import itertools
import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest
import serial
from serial.tools.list_ports_common import ListPortInfo
from support.serial_rig import NO_TERMINALS, READ_TIMEOUT_S, SerialRig
from support.waiting import ended

from hardware_drivers.errors import BusyError, ConfigurationError, ConnectionLostError
from hardware_drivers.serial_port import port as port_module
from hardware_drivers.serial_port.line import ATTEMPTS_PER_OPENING, SHOWN_BYTES
from hardware_drivers.serial_port.parameters import SerialLineParameters, SupplyParameters
from hardware_drivers.serial_port.power_supply import ScpiPowerSupply
from simulator.doubles.serial.link import GARBAGE, SerialLink
from simulator.doubles.serial.supply import SUPPLY_IDENTITY

termios = pytest.importorskip("termios", reason="serial faults are tested on pseudo terminals")
pytestmark = pytest.mark.skipif(bool(NO_TERMINALS), reason=NO_TERMINALS)

TIMEOUT_S = READ_TIMEOUT_S
LOOK_S = 0.01
"""What a look at a clock of a test's own takes."""
ORDERED = [(True, "command")]
"""The output's record after one order: nothing else ever switched it on."""


@pytest.fixture
def rig(tmp_path):
    with SerialRig(tmp_path) as rig:
        yield rig


@pytest.fixture
def energised(rig):
    """Return a rig whose supply was switched on by command; no fault may switch it on again."""
    rig.supply.energise(10.0, 1.0)
    yield rig
    on = [cause for on, cause in rig.switched() if on]
    assert on == ["command"], "only the order switched it on"


def change_supply(rig, **attributes):
    for name, value in attributes.items():
        rig.instruments.supply_link.do(lambda n=name, v=value: setattr(rig.instruments.supply, n, v))


# Lost and found ------------------------------------------------------------------------------------


def test_an_unplugged_supply_is_lost_and_comes_back_as_it_was(energised):
    rig = energised
    rig.instruments.supply_link.unplug()
    with pytest.raises(ConnectionLostError, match="check its plug"):
        rig.supply.read(TIMEOUT_S)
    with pytest.raises(ConnectionLostError, match="No such file"):
        rig.supply.read(TIMEOUT_S)
    rig.instruments.supply_link.plug()
    rig.clock.advance(1.0)
    reading = rig.supply.read(TIMEOUT_S)
    assert reading.output_on, "nobody switched it off, and the driver neither"
    assert reading.voltage_v == 10.0
    assert rig.switched() == ORDERED


def test_a_supply_unplugged_while_it_is_asked_is_lost(energised):
    rig = energised
    link, answer = rig.instruments.supply_link, rig.instruments.supply.answer
    link.answer = lambda command: link.unplug()
    with pytest.raises(ConnectionLostError, match="check its plug"):
        rig.supply.read(TIMEOUT_S)
    link.answer = answer
    link.plug()
    assert rig.supply.read(TIMEOUT_S).output_on


def test_a_supply_that_returns_without_power_stays_off(energised):
    rig = energised
    rig.instruments.brown_out()
    with pytest.raises(ConnectionLostError):
        rig.supply.read(TIMEOUT_S)
    assert not rig.supply.read(TIMEOUT_S).output_on
    assert rig.supply.read_back(TIMEOUT_S)["set_voltage_v"] == 0.0, "nothing is set again either"
    assert rig.switched() == [(True, "command"), (False, "brown-out")]


def test_attempts_back_off_on_the_callers_clock(rig):
    rig.instruments.supply_link.unplug()
    waits_s = []
    for _ in range(9):
        with pytest.raises(ConnectionLostError, match=rf"after {len(waits_s) + 1} attempts?\)$"):
            rig.supply.read(TIMEOUT_S)
        waited_s = 0.0
        while True:
            with pytest.raises(ConnectionLostError) as refusal:
                rig.supply.read(TIMEOUT_S)
            if "next attempt in" not in str(refusal.value):
                pytest.fail("an attempt before its time")
            left_s = float(str(refusal.value).rpartition("in ")[2].removesuffix(" s"))
            rig.clock.advance(left_s * 0.999)  # printed to three digits
            waited_s += left_s * 0.999
            if left_s < 0.01:
                break
        rig.clock.advance(0.02)
        waits_s.append(round(waited_s))
    assert waits_s == [1, 2, 4, 8, 16, 32, 60, 60, 60]
    rig.instruments.supply_link.plug()
    rig.clock.advance(60.0)
    assert not rig.supply.read(TIMEOUT_S).output_on


@pytest.mark.parametrize(
    ("command", "switched"),
    [(ScpiPowerSupply.make_safe, []), (lambda supply: supply.energise(10.0, 1.0), ORDERED)],
    ids=["off", "on"],
)
def test_a_command_does_not_wait_for_the_next_attempt(rig, command, switched):
    rig.instruments.supply_link.unplug()
    with pytest.raises(ConnectionLostError):
        rig.supply.read(TIMEOUT_S)
    rig.instruments.supply_link.plug()
    with pytest.raises(ConnectionLostError, match="next attempt in"):
        rig.supply.read(TIMEOUT_S)
    command(rig.supply)
    assert (rig.switched(), rig.supply.read(TIMEOUT_S).output_on) == (switched, bool(switched))


def test_a_supply_that_cannot_be_reached_cannot_be_made_safe(energised):
    rig = energised
    rig.instruments.supply_link.unplug()
    with pytest.raises(ConnectionLostError, match="what its output does is unknown"):
        rig.supply.make_safe()


def test_making_safe_gets_through_one_fault(energised):
    rig = energised
    rig.instruments.supply_link.inject(garbage=1)
    rig.supply.make_safe()
    assert rig.switched() == [*ORDERED, (False, "command")]


def test_a_silent_supply_is_lost_in_the_time_given(energised):
    rig = energised
    rig.supply.close()
    rig.instruments.supply_link.inject(silent=True)
    looks = itertools.count()
    supply = supply_on(
        str(rig.instruments.supply_link.path),
        rig,
        reply_timeout_s=0.1,
        monotonic_s=lambda: LOOK_S * next(looks),
    )
    with pytest.raises(ConnectionLostError, match=r"does not answer \*IDN\? within 0.1 s"):
        supply.read(TIMEOUT_S)
    # Its clock goes on when it is looked at: one reply's time was waited for, and not the whole timeout.
    assert 0.1 <= LOOK_S * next(looks) < 0.2


def test_the_port_of_a_silent_supply_is_reopened(energised, tmp_path):
    rig = energised
    link = rig.instruments.supply_link
    link.inject(silent=True)
    with pytest.raises(ConnectionLostError, match=r"(does|did) not answer"):
        rig.supply.read(TIMEOUT_S)
    # Its path leads to another terminal now, and the old one never said that it is gone.
    with SerialLink(tmp_path / "moved", rig.instruments.supply.answer) as moved:
        link.path.unlink()
        link.path.symlink_to(moved.path.resolve())
        attempts = 0
        while not rig.supply_is_read():
            attempts += 1
            assert attempts <= ATTEMPTS_PER_OPENING
        assert rig.supply.read(TIMEOUT_S).output_on
        rig.supply.close()


def test_a_port_that_is_gone_and_back_is_found_by_one_attempt(energised):
    rig = energised
    link = rig.instruments.supply_link
    link.inject(silent=True)
    with pytest.raises(ConnectionLostError):
        rig.supply.read(TIMEOUT_S)
    link.clear_faults()
    link.unplug()
    link.plug()
    assert rig.supply.read(TIMEOUT_S).output_on


def test_a_slow_supply_is_read_if_the_timeout_allows(energised):
    rig = energised
    rig.instruments.supply_link.inject(slow_s=0.01)
    assert rig.supply.read(TIMEOUT_S).voltage_v == 10.0
    with pytest.raises(ConnectionLostError, match=r"in time|no time left"):
        rig.supply.read(0.015)  # three answers take 0.03 s
    rig.instruments.supply_link.clear_faults()
    assert rig.supply.read(TIMEOUT_S).current_a == pytest.approx(8.5 / 40.0, abs=1e-6)  # printed digits


# Out of step ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("late", range(1, 5))
def test_a_late_reply_answers_no_later_question(energised, late):
    rig = energised
    # Each late reply arrives with the next command, just before that command's own.
    rig.instruments.supply_link.inject(hold=late)
    assert not rig.supply_is_read()
    for _ in range(late):
        rig.supply_is_read()
    for _ in range(3):
        reading = rig.supply.read(TIMEOUT_S)
        assert (reading.voltage_v, reading.output_on) == (10.0, True)
        assert reading.current_a == pytest.approx(8.5 / 40.0, abs=1e-6)  # printed digits


def test_an_unsolicited_reply_answers_no_query(energised):
    rig = energised
    rig.supply.read(TIMEOUT_S)
    rig.instruments.supply_link.send_unrequested(b"+9.990000E+00\n")
    reading = rig.supply.read(TIMEOUT_S)
    assert reading.voltage_v == 10.0


@pytest.mark.parametrize(
    ("answer_bytes", "complaint"),
    [
        (GARBAGE, "no text"),
        (b"\n", "no text"),
        (b"ten volts\n", "no number"),
        (b"nan\n", "no value"),
        (b"9.91E37\n", "no value"),
        (b"+1.0E+01\n+1.0E+01\n", "twice"),
        (b"+1.0E", "sent only"),
        (b"x" * 1000, "without a terminator"),
    ],
)
def test_garbage_is_refused_with_its_bytes_and_the_next_reading_is_right(energised, answer_bytes, complaint):
    rig = energised
    rig.instruments.supply_link.inject(garbage=1, garbage_bytes=answer_bytes)
    with pytest.raises(ConnectionLostError, match=complaint) as error:
        rig.supply.read(TIMEOUT_S)
    shown = repr(answer_bytes.strip(b"\r\n").split(b"\n")[0][:SHOWN_BYTES])[1:]
    assert shown.strip("'") in str(error.value)
    rig.instruments.supply_link.heard()  # asked once the clock knows that the rest is withheld
    assert rig.supply.read(TIMEOUT_S).voltage_v == 10.0


def test_an_instrument_that_sends_endlessly_is_given_up(energised):
    rig = energised
    rig.supply.close()
    answer = rig.instruments.supply.answer
    rig.instruments.supply_link.answer = lambda command: "\n".join(["+1.0E+00"] * 100) + answer(command)
    with pytest.raises(ConnectionLostError, match=r"answered b'\+1\.0E\+00"):
        rig.supply.read(TIMEOUT_S)


# Who is there --------------------------------------------------------------------------------------


def test_another_instrument_is_refused_and_receives_only_the_identity_query(rig):
    change_supply(rig, identity="OTHER,THING,7,2.0")
    for attempt in (rig.supply.identity, lambda: rig.supply.read(TIMEOUT_S)):
        with pytest.raises(ConfigurationError, match=r"'OTHER,THING,7,2.0'"):
            attempt()
        rig.clock.advance(60.0)
    with pytest.raises(ConfigurationError, match=r"connect the right instrument.*left as it was"):
        rig.supply.energise(10.0, 1.0)
    with pytest.raises(ConnectionLostError, match="could not be switched off"):
        rig.supply.make_safe()
    assert set(rig.heard()) == {"*IDN?"}
    # Nor is its port kept from the program it belongs to.
    its_own = supply_on(str(rig.instruments.supply_link.path), rig, identity="OTHER,THING")
    assert its_own.identity()["maker"] == "OTHER"
    its_own.close()


def test_an_instrument_that_was_exchanged_while_unplugged_is_refused(energised):
    rig = energised
    rig.instruments.supply_link.unplug()
    change_supply(rig, identity="OTHER,THING,7,2.0")
    rig.instruments.supply_link.plug()
    with pytest.raises(ConnectionLostError):
        rig.supply.read(TIMEOUT_S)
    before = len(rig.heard())
    with pytest.raises(ConfigurationError, match="OTHER"):
        rig.supply.read(TIMEOUT_S)
    assert rig.heard()[before:] == ["*IDN?"]
    change_supply(rig, identity=SUPPLY_IDENTITY)
    rig.clock.advance(60.0)
    assert rig.supply.read(TIMEOUT_S).output_on


def test_a_second_owner_gets_an_error_with_the_port_and_its_owner(rig):
    rig.supply.read(TIMEOUT_S)
    second = rig.new_supply()
    with pytest.raises(BusyError) as error:
        second.read(TIMEOUT_S)
    assert str(rig.instruments.supply_link.path) in str(error.value)
    if sys.platform == "linux":  # elsewhere no file shows who has a port open
        assert f"process {os.getpid()}" in str(error.value)
    rig.supply.read(TIMEOUT_S)
    rig.supply.close()
    rig.clock.advance(60.0)
    assert second.identity()["serial_number"] == "SD0001"
    second.close()


# Orders --------------------------------------------------------------------------------------------


def test_values_above_the_caps_are_not_sent(rig):
    with pytest.raises(ConfigurationError, match="voltage_cap_v = 12"):
        rig.supply.energise(12.1, 1.0)
    with pytest.raises(ConfigurationError, match="current_cap_a = 2"):
        rig.supply.energise(10.0, 2.1)
    assert rig.heard() == []


def test_a_supply_that_refuses_what_is_set_stays_off(tmp_path):
    with SerialRig(tmp_path, voltage_cap_v=40.0) as rig:
        with pytest.raises(ConfigurationError, match="Data out of range"):
            rig.supply.energise(35.0, 1.0)
        assert rig.switched() == []
        assert rig.instruments.supply_link.do(lambda: rig.instruments.supply.answer("SYST:ERR?"))[0:2] == "+0"


def test_earlier_errors_are_not_attributed_to_the_command(rig):
    link = rig.instruments.supply_link
    link.do(lambda: [rig.instruments.supply.answer("NONSENSE") for _ in range(5)])
    rig.supply.energise(10.0, 1.0)
    assert rig.supply.read(TIMEOUT_S).output_on


def test_an_error_queue_without_an_end_is_refused(rig):
    answer = rig.instruments.supply.answer
    rig.instruments.supply_link.answer = lambda command: (
        '-350,"full"' if command == "SYST:ERR?" else answer(command)
    )
    with pytest.raises(ConnectionLostError, match=r"does not end.*the output is off"):
        rig.supply.energise(10.0, 1.0)
    assert rig.switched() == []


@pytest.mark.parametrize("lost", range(1, 18))
def test_a_command_with_a_lost_reply_leaves_the_output_off_or_reports_unknown(rig, lost):
    """Silence from each reply on in turn: off, or an error that says unknown; never on and believed."""
    answered = iter(range(1, 1000))
    link, answer = rig.instruments.supply_link, rig.instruments.supply.answer

    def answer_some(command):
        reply = answer(command)
        return reply if reply is None or next(answered) < lost else None

    link.answer = answer_some
    error = None
    try:
        rig.supply.energise(10.0, 1.0)
    except ConnectionLostError as caught:
        error = str(caught)
    if error is None:
        assert next(answered) <= lost, "every reply had come"
        assert rig.switched() == ORDERED
    else:
        assert not rig.instruments.supply.on or "unknown" in error


@pytest.mark.parametrize("garbled", range(1, 14))
def test_a_command_with_one_wrong_reply_leaves_the_output_off(rig, garbled):
    rig.garble_reply(garbled)
    with pytest.raises((ConnectionLostError, ConfigurationError)):
        rig.supply.energise(10.0, 1.0)
    assert not rig.instruments.supply.on


def test_a_supply_that_trips_when_switched_on_is_reported(rig):
    supply = rig.instruments.supply
    answer = supply.answer

    def trips(command):
        reply = answer(command)
        if command == "OUTP ON":
            supply.trip("CURR")
        return reply

    rig.instruments.supply_link.answer = trips
    with pytest.raises(ConfigurationError, match=r"switched itself off again \(CURR:PROT:TRIP\?\)"):
        rig.supply.energise(10.0, 1.0)


def test_setup_commands_follow_every_check_of_the_name(tmp_path):
    with SerialRig(tmp_path, setup_commands=("SYST:REM",)) as rig:
        rig.supply.read(TIMEOUT_S)
        rig.instruments.supply_link.unplug()
        rig.instruments.supply_link.plug()
        with pytest.raises(ConnectionLostError):
            rig.supply.read(TIMEOUT_S)
        rig.supply.read(TIMEOUT_S)
        assert [command for command in rig.heard() if command in {"*IDN?", "SYST:REM"}] == [
            "*IDN?",
            "SYST:REM",
        ] * 2


def test_a_supply_without_protections_is_not_queried_for_them(tmp_path):
    with SerialRig(tmp_path, protection_queries=()) as rig:
        rig.supply.energise(10.0, 1.0)
        rig.supply.make_safe()
        rig.supply.read(TIMEOUT_S)
        assert not [command for command in rig.heard() if "PROT" in command]


# The climate probe ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("temperature_c", "complaint"), [(850.0, "temperature"), (-200.0, "temperature")])
def test_a_probe_without_its_sensor_is_refused(rig, temperature_c, complaint):
    rig.instruments.climate_link.do(lambda: setattr(rig.instruments.climate, "temperature_c", temperature_c))
    with pytest.raises(ConnectionLostError, match=complaint):
        rig.climate.read(TIMEOUT_S)


def test_a_humidity_in_the_wrong_unit_is_refused(rig):
    rig.instruments.climate_link.do(lambda: setattr(rig.instruments.climate, "relative_humidity", 45.0))
    with pytest.raises(ConnectionLostError, match="reported in percent"):
        rig.climate.read(TIMEOUT_S)


# Ports ---------------------------------------------------------------------------------------------


def supply_on(port, rig, identity="SOLIMON", monotonic_s=time.monotonic, **line):
    parameters = SupplyParameters(line=SerialLineParameters(port=port, **line), identity=identity)
    return ScpiPowerSupply(parameters, stamp=rig.clock.stamp, monotonic_s=monotonic_s)


def usb_port(path, serial_number):
    info = ListPortInfo(str(path))
    info.serial_number = serial_number
    return info


def test_a_port_is_found_by_the_serial_number_of_its_adapter(rig, monkeypatch):
    path = rig.instruments.supply_link.path
    found = [usb_port("/dev/ttyUSB0", "FT111"), usb_port(path, "FT222")]
    monkeypatch.setattr(port_module.list_ports, "comports", lambda: found)
    supply = supply_on("serial:FT222", rig)
    assert supply.identity()["serial_number"] == "SD0001"
    supply.close()
    with pytest.raises(ConnectionLostError, match=r"FT333; found: /dev/ttyUSB0 \(FT111\)"):
        supply_on("serial:FT333", rig).identity()
    found.append(usb_port("/dev/ttyUSB7", "FT222"))
    with pytest.raises(ConfigurationError, match="2 ports have the USB serial number FT222"):
        supply_on("serial:FT222", rig).identity()


def test_a_file_without_a_serial_port_is_refused(rig, tmp_path):
    plain = tmp_path / "notes.txt"
    plain.write_text("", encoding="utf-8")
    for path in ("/dev/null", str(plain), str(tmp_path)):
        with pytest.raises(ConfigurationError, match="is no serial port"):
            supply_on(path, rig).identity()


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (serial.SerialException(13, "could not open port"), "dialout"),
        (ValueError("Invalid baud rate: 1"), "Invalid baud rate"),
    ],
)
def test_a_port_that_cannot_be_opened_is_reported_with_its_reason(rig, monkeypatch, error, message):
    def fails(**_):
        raise error

    monkeypatch.setattr(port_module.serial, "Serial", fails)
    with pytest.raises(ConfigurationError, match=message):
        rig.supply.identity()


VENDOR_ERRORS = [
    serial.SerialException("gone"),
    serial.SerialTimeoutException("full"),
    serial.PortNotOpenError(),
    OSError(5, "Input/output error"),
    termios.error(5, "Input/output error"),
]


@pytest.mark.parametrize("call", ["reset_input_buffer", "write", "read"])
@pytest.mark.parametrize("raised", VENDOR_ERRORS, ids=lambda error: type(error).__name__)
def test_every_port_error_is_translated_by_the_line(energised, call, raised, monkeypatch):
    """Each call of pyserial fails in each way seen: the type depends on where an unplugging strikes."""
    rig = energised

    def fails(*_):
        raise raised

    with monkeypatch.context() as patched:
        patched.setattr(serial.Serial, call, fails)
        with pytest.raises(ConnectionLostError) as refusal:
            rig.supply.read(TIMEOUT_S)
    assert refusal.value.__cause__ is raised
    assert rig.supply.read(TIMEOUT_S).output_on


@pytest.mark.parametrize("raised", VENDOR_ERRORS, ids=lambda error: type(error).__name__)
def test_a_port_that_fails_to_close_is_closed_all_the_same(energised, raised, monkeypatch):
    rig = energised

    def fails(*_):
        raise raised

    with monkeypatch.context() as patched:
        patched.setattr(serial.Serial, "reset_output_buffer", fails)
        rig.supply.close()
    assert rig.supply.read(TIMEOUT_S).output_on


# The doubles as a process of their own --------------------------------------------------------------


@contextmanager
def child():
    command = [sys.executable, "-m", "simulator.doubles.serial.instruments", "--json", "--noise-a", "0"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8"
    ) as process:

        def order(**what):
            process.stdin.write(json.dumps(what) + "\n")
            process.stdin.flush()
            return json.loads(process.stdout.readline())

        try:
            yield process, json.loads(process.stdout.readline()), order
        finally:
            process.stdin.close()
            ended(process, "the doubles left")


def test_the_doubles_run_as_a_process_and_take_commands(rig):
    with child() as (process, ready, order):
        assert ready["event"] == "ready"
        supply = supply_on(ready["supply"], rig, reply_timeout_s=60.0)
        supply.energise(10.0, 1.0)
        assert order(do="unplug") == {"event": "done"}
        with pytest.raises(ConnectionLostError):
            supply.read(TIMEOUT_S)
        order(do="plug")
        assert supply.read(TIMEOUT_S).output_on
        order(do="resistance", resistance_ohm=1.0)
        assert supply.read(TIMEOUT_S).current_a == 1.0
        order(do="inject", garbage=1)
        with pytest.raises(ConnectionLostError, match="no text"):
            supply.read(TIMEOUT_S)
        order(do="trip", protection="CURR")
        assert not supply.read(TIMEOUT_S).output_on
        assert order(do="inject", nonsense=1)["event"] == "refused"
        assert order(do="explode")["event"] == "refused"
        record = order(do="record")
        assert [(change["on"], change["cause"]) for change in record["output"]] == [
            (True, "command"),
            (False, "protection CURR"),
        ]
        assert "OUTP ON" in [command for _, command in record["supply_heard"]]
        supply.close()
    assert process.returncode == 0
    assert not os.path.lexists(ready["supply"])
