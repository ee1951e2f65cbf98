"""Parsing of replies, on a line whose other end is a table."""

import pytest

from hardware_drivers.errors import ConnectionLostError
from hardware_drivers.measurement import Stamp
from hardware_drivers.serial_port import line as line_module
from hardware_drivers.serial_port.line import SerialLine
from hardware_drivers.serial_port.parameters import SerialLineParameters

LATER_S = 1e9


class Answering:
    """Port whose instrument sends one reply to every query."""

    in_waiting = 65_536

    def __init__(self):
        self.says = b""
        self.comes = b""

    def write(self, data):
        self.comes = b"NAME\n" if data == b"*IDN?\n" else self.says

    def read(self, size):
        comes, self.comes = self.comes[:size], self.comes[size:]
        return comes

    def reset_input_buffer(self):
        self.comes = b""


@pytest.fixture
def instrument():
    return Answering()


@pytest.fixture
def line(instrument, monkeypatch):
    monkeypatch.setattr(line_module, "open_port", lambda parameters: instrument)
    line = SerialLine(
        SerialLineParameters(port="COM1"),
        identity="NAME",
        stamp=lambda: Stamp(utc_ns=0, mono_ns=0, boot_id="test"),
    )
    line.connect(LATER_S)
    return line


@pytest.mark.parametrize(
    ("says", "value"),
    [
        ("10.000V", 10.0),
        ("10.000 v", 10.0),
        ("500mV", 0.5),
        ("1.5kV", 1500.0),
        ("V1 -2.5E-1", -0.25),
        ("VP1 12.00", 12.0),
        (".5", 0.5),
        ("7K", 7.0),
    ],
)
def test_units_headers_and_strays_are_understood(line, instrument, says, value):
    instrument.says = f"{says}\n".encode()
    number = line.query_number("V1?", LATER_S, units=("V",), header="VP1", stray="K")
    assert number == pytest.approx(value, rel=1e-12)  # the prefix is a product


@pytest.mark.parametrize("says", ["10.000A", "10.000MV", "10 Vrms", "I1 10.000", "V2 10.0", "10,000", "1_0"])
def test_a_wrong_reply_is_refused(line, instrument, says):
    instrument.says = f"{says}\n".encode()
    with pytest.raises(ConnectionLostError, match=r"expected V|another question|no number"):
        line.query_number("V1?", LATER_S, units=("V",), header="VP1")
    assert not line.in_step


@pytest.mark.parametrize(
    ("says", "how", "flag"),
    [
        (b"YES\n", {}, True),
        (b"NO\n", {}, False),
        (b"OP1 1\n", {}, True),
        (b"12\n", {"mask": 4}, True),
        (b"3\n", {"mask": 4}, False),
        (b"\x41\n", {"mask": 0x40, "raw": True}, True),
        (b"\x01\n", {"mask": 0x40, "raw": True}, False),
    ],
)
def test_flags_are_words_or_bits(line, instrument, says, how, flag):
    instrument.says = says
    assert line.query_flag("OP1?", LATER_S, **how) is flag


@pytest.mark.parametrize(
    ("says", "how"),
    [
        (b"2\n", {}),
        (b"ON\n", {"mask": 4}),
        (b"-1\n", {"mask": 4}),
        (b"\x41\x41\n", {"mask": 0x40, "raw": True}),
    ],
)
def test_an_invalid_flag_is_refused(line, instrument, says, how):
    instrument.says = says
    with pytest.raises(ConnectionLostError, match="expected"):
        line.query_flag("OP1?", LATER_S, **how)


@pytest.mark.parametrize(
    ("says", "bare", "error"), [("0", True, None), ("100", True, "100"), ("0,x", False, None)]
)
def test_an_error_is_a_number_and_perhaps_a_text(line, instrument, says, bare, error):
    instrument.says = f"{says}\n".encode()
    assert line.query_error("EER?", LATER_S, bare=bare) == error


@pytest.mark.parametrize(("says", "bare"), [("0", False), ("1.0", True), ("ON", True)])
def test_a_reply_that_is_no_error_entry_is_refused(line, instrument, says, bare):
    instrument.says = f"{says}\n".encode()
    with pytest.raises(ConnectionLostError, match="no entry of an error queue"):
        line.query_error("EER?", LATER_S, bare=bare)
