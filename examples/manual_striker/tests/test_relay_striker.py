"""Tests of the relay board's protocol, and that a coil goes off after any interruption."""

import re

import manual_striker.relay as relay
import pytest
from manual_striker.doubles import PortDouble, RelayBoardDouble
from manual_striker.relay import KIND, LONGEST_PULSE_S, RelayParameters
from pydantic import ValidationError

from hardware_drivers.conformance.bench import MachineClock
from hardware_drivers.errors import BusyError, ConnectionLostError
from hardware_drivers.kinds import Opening
from hardware_drivers.measurement import ShotKey
from simulator.doubles.serial.link import Framing, SerialLink, find_missing_terminal_reason

KEY = ShotKey(position="C", set_index=0, shot_index=0)
OPENING = Opening(clock=MachineClock(), serves={"striker": ("B", "C")})
PARAMETERS = RelayParameters(port="COM3", relays={"B": 0, "C": 1}, pulse_s=0.1)


@pytest.fixture
def board():
    return RelayBoardDouble({0: "B", 1: "C"})


@pytest.fixture
def sent(board, monkeypatch):
    """Return every line sent to the board, in order."""
    lines = []
    answer = board.answer

    def hear(line):
        lines.append(line)
        return answer(line)

    monkeypatch.setattr(board, "answer", hear)
    return lines


@pytest.fixture
def slept(board, monkeypatch):
    """Provide the board without waiting times."""
    seconds = []
    monkeypatch.setattr("serial.serial_for_url", lambda port, **_: PortDouble(board))
    monkeypatch.setattr(relay.time, "sleep", seconds.append)
    return seconds


def test_a_strike_sends_these_commands(slept, sent):
    with KIND.open(PARAMETERS, OPENING) as instruments:
        sent.clear()
        instruments.striker.strike(KEY)
        assert sent == ["relay on 1", "relay read 1", "relay off 1", "relay read 1"]
    assert slept == [0.1]


def test_a_relay_that_a_dead_program_left_on_goes_off_at_the_opening(slept, board):
    board.answer("relay on 0")
    with KIND.open(PARAMETERS, OPENING):
        assert board.switchings == [("B", True), ("B", False)]


def test_an_interrupt_in_the_pulse_leaves_the_coil_off(slept, board, monkeypatch):
    def interrupted(seconds):
        assert board.switchings[-1] == ("C", True)
        raise KeyboardInterrupt

    monkeypatch.setattr(relay.time, "sleep", interrupted)
    with KIND.open(PARAMETERS, OPENING) as instruments:
        with pytest.raises(KeyboardInterrupt):
            instruments.striker.strike(KEY)
        assert board.switchings == [("C", True), ("C", False)]


def test_a_lost_answer_to_on_still_ends_in_off(slept, board, monkeypatch):
    with KIND.open(PARAMETERS, OPENING) as instruments:
        real = board.answer

        def loses_one(line):
            board.fault = "silent" if line.startswith("relay on") else ""
            return real(line)

        monkeypatch.setattr(board, "answer", loses_one)
        with pytest.raises(ConnectionLostError, match="no whole answer to 'relay on 1'"):
            instruments.striker.strike(KEY)
    assert board.switchings == [("C", True), ("C", False)]


def test_the_error_names_the_plug_to_pull_when_a_relay_stays_on(slept, board, monkeypatch):
    real = board.answer
    with pytest.raises(ConnectionLostError, match=r"relay 1 may be on .* pull the coils' plug"):
        with KIND.open(PARAMETERS, OPENING) as instruments:
            monkeypatch.setattr(board, "answer", lambda line: "" if "off" in line else real(line))
            instruments.striker.strike(KEY)


def test_the_other_relays_go_off_when_one_does_not_answer(slept, board, monkeypatch):
    real = board.answer
    with pytest.raises(ConnectionLostError, match="relay 0 may be on"):
        with KIND.open(PARAMETERS, OPENING) as instruments:
            for line in ("relay on 0", "relay on 1"):
                board.answer(line)
            monkeypatch.setattr(board, "answer", lambda line: "" if line.endswith("0") else real(line))
            instruments.striker.make_safe()
    assert board.switchings == [("B", True), ("C", True), ("C", False)]


def test_a_port_that_another_program_holds_is_busy(monkeypatch):
    from serial import SerialException

    def held(port, **_):
        raise SerialException(11, f"could not exclusively lock port {port}")

    monkeypatch.setattr("serial.serial_for_url", held)
    (finding,) = KIND.check(PARAMETERS, OPENING)
    assert (finding.state, finding.held) == ("fail", True)
    with pytest.raises(BusyError, match="COM3 is held"):
        relay.RelayBoard("COM3", 1.0).version()


def test_a_longer_pulse_is_refused():
    with pytest.raises(ValidationError, match="pulse_s"):
        RelayParameters(port="COM3", relays={"B": 0}, pulse_s=1.001 * LONGEST_PULSE_S)


def test_a_position_without_a_relay_is_refused_when_the_configuration_is_read():
    with pytest.raises(ValueError, match="relays has no 'D'"):
        KIND.require(PARAMETERS, {"striker": ("D",)})


@pytest.mark.skipif(bool(find_missing_terminal_reason()), reason=find_missing_terminal_reason())
def test_the_same_over_a_real_port(board, tmp_path):
    def answer(line):
        return f"{line}\n\r{board.answer(line)}\n\r"

    framing = Framing(commands=re.compile(rb"[^\r]*\r"), reply_end=b">")
    # The double answers within a millisecond; on a busy machine later.
    parameters = PARAMETERS.model_copy(
        update={"port": str(tmp_path / "relays"), "pulse_s": 1e-3, "reply_timeout_s": 10.0}
    )
    with SerialLink(tmp_path / "relays", answer, framing):
        (finding,) = KIND.check(parameters, OPENING)
        assert finding.detail == "firmware 00000008"
        with KIND.open(parameters, OPENING) as instruments:
            instruments.striker.strike(KEY)
    assert board.switchings == [("C", True), ("C", False)]
