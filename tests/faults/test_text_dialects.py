"""Every dialect of a supply on every kind of line: right state, and the output off after any doubt."""

import itertools
import sys

import pytest
from support.serial_rig import NO_TERMINALS, READ_TIMEOUT_S, REPLY_TIMEOUT_S, SerialRig

from hardware_drivers.errors import ConfigurationError, ConnectionLostError

pytestmark = pytest.mark.skipif(bool(NO_TERMINALS), reason=NO_TERMINALS)

DIALECTS = ("scpi", "aim_tti", "korad", "rigol")
WAYS = ("pty", "tcp", "visa")
EVERY_DAY = {("aim_tti", way) for way in WAYS} | {(dialect, "tcp") for dialect in DIALECTS}
"""One dialect on each kind of line, each dialect on one; the others are slow for their number only."""
PAIRS = [
    pytest.param(pair, marks=[] if pair in EVERY_DAY else pytest.mark.slow, id="-".join(pair))
    for pair in itertools.product(DIALECTS, WAYS)
]
ORDERED = [(True, "command")]
MEASURED = {
    "scpi": "MEAS:VOLT?",
    "aim_tti": "V1O?",
    "korad": "VOUT1?",
    "rigol": ":MEAS:VOLT? CH1",
}


@pytest.fixture(params=PAIRS)
def pair(request):
    if request.param[1] == "visa":
        pytest.importorskip("pyvisa_py", reason="the extra visa is not installed")
    return request.param


@pytest.fixture
def rig(pair, tmp_path):
    dialect, way = pair
    with SerialRig(tmp_path, dialect=dialect, way=way) as rig:
        yield rig


@pytest.fixture
def energised(rig):
    """Return a rig whose supply was switched on by command; nothing else may switch it on."""
    rig.supply.energise(10.0, 1.0)
    yield rig
    assert [cause for on, cause in rig.switched() if on] == ["command"]


def test_a_command_is_set_read_back_and_measured(energised):
    rig = energised
    reading = rig.supply.read(READ_TIMEOUT_S)
    assert (reading.voltage_v, reading.output_on) == (10.0, True)
    assert reading.current_a == pytest.approx(8.5 / 40.0, abs=1e-3)  # the coarsest shows milliamperes
    state = rig.supply.read_back(READ_TIMEOUT_S)
    assert (state["set_voltage_v"], state["set_current_limit_a"], state["output"]) == (10.0, 1.0, "on")
    assert (state["tripped"], bool(state["protection_unknown"])) == ("", rig.dialect == "korad")
    rig.supply.make_safe()
    assert rig.switched() == [*ORDERED, (False, "command")]


def test_a_trip_that_the_supply_reports_is_reported_and_never_overruled(energised):
    rig = energised
    rig.instruments.supply_link.do(lambda: rig.instruments.supply.trip("VOLT"))
    assert not rig.supply.read(READ_TIMEOUT_S).output_on
    assert not rig.supply.read(READ_TIMEOUT_S).output_on
    assert bool(rig.supply.tripped_protections) != bool(rig.supply.protection_unknown)
    for _ in range(2):  # also where asking has taken the trip away
        with pytest.raises(
            ConfigurationError, match=r"has tripped|switched itself off again|refused to switch"
        ):
            rig.supply.energise(10.0, 1.0)
    assert not rig.instruments.supply.on


@pytest.mark.parametrize("garbled", [2, 6, *(pytest.param(n, marks=pytest.mark.slow) for n in range(1, 16))])
def test_a_command_with_one_wrong_reply_leaves_the_output_off(rig, garbled):
    answered = rig.garble_reply(garbled)
    try:
        rig.supply.energise(10.0, 1.0)
    except (ConnectionLostError, ConfigurationError):
        assert not rig.instruments.supply.on
    else:
        assert next(answered) <= garbled, "every reply had come"


@pytest.mark.parametrize("reply", ["10.000A", "I1 10.000"])
def test_a_wrong_unit_or_header_switches_off(rig, reply):
    link, answer = rig.instruments.supply_link, rig.instruments.supply.answer
    question = MEASURED[rig.dialect]
    link.answer = lambda command: reply if command == question else answer(command)
    with pytest.raises(ConnectionLostError, match=r"(expected V behind|another question).*the output is off"):
        rig.supply.energise(10.0, 1.0)
    assert rig.switched() == [*ORDERED, (False, "command")]


def test_the_instrument_reports_its_identity(rig):
    identity = rig.supply.identity()
    assert identity["model"] in {"DC SUPPLY DOUBLE", "PL303-P", "KA3005P", "DP832A"}
    assert identity["port"] == rig.supply_parameters.line.port


# What only some do ---------------------------------------------------------------------------------


@pytest.mark.parametrize("dialect", ["scpi", "aim_tti", "rigol"])
@pytest.mark.parametrize("before_v", [5.0, 30.0])
def test_protections_are_set_and_read_back_before_the_output_goes_on(tmp_path, dialect, before_v):
    """Whatever stood there before: none may lie below the voltage that is set at that moment."""
    with SerialRig(tmp_path, dialect=dialect, over_voltage_v=12.5, over_current_a=1.5) as rig:
        supply = rig.instruments.supply
        supply._set["VOLT"], supply._protection["VOLT"] = before_v, before_v + 1.0
        rig.supply.energise(10.0, 1.0)
        assert supply._protection == {"VOLT": 12.5, "CURR": 1.5}
        heard = rig.heard()
        on = heard.index(
            next(command for command in heard if command in {"OUTP ON", "OP1 1", ":OUTP CH1,ON"})
        )
        asked = [
            command for command in heard[:on] if command in {"VOLT:PROT?", "OVP1?", ":OUTP:OVP:VAL? CH1"}
        ]
        assert len(asked) == 1
        supply.obeys_set_commands = False
        supply._protection["VOLT"] = 20.0
        with pytest.raises(ConfigurationError, match=r"reads back.*the output is off"):
            rig.supply.energise(10.0, 1.0)
        assert not supply.on


def test_a_protection_that_stays_off_keeps_the_output_off(tmp_path):
    with SerialRig(tmp_path, dialect="rigol", over_voltage_v=12.5) as rig:
        answer = rig.instruments.supply.answer
        rig.instruments.supply_link.answer = lambda command: (
            "OFF" if command == ":OUTP:OVP? CH1" else answer(command)
        )
        with pytest.raises(ConfigurationError, match=r"received :OUTP:OVP CH1,ON and reports that it is off"):
            rig.supply.energise(10.0, 1.0)
        assert rig.switched() == []


def test_a_supply_that_does_not_support_the_query_is_reported_as_unknown(tmp_path):
    with SerialRig(tmp_path) as rig:
        rig.instruments.supply.has_protections = False
        # One reply's time for each silence: an order has that of several.
        rig.instruments.supply_link.withheld = lambda: rig.deadlines.skip(REPLY_TIMEOUT_S)
        rig.supply.energise(10.0, 1.0)
        assert rig.supply.protection_unknown == "the supply does not know VOLT:PROT:TRIP?, CURR:PROT:TRIP?"
        rig.instruments.supply_link.do(lambda: rig.instruments.supply.press_output_key(False))
        asked = len(rig.heard())
        assert not rig.supply.read(READ_TIMEOUT_S).output_on
        assert not any("PROT" in command for command in rig.heard()[asked:]), "it is not asked again"
        assert rig.supply.tripped_protections == ()


def test_a_lost_answer_is_not_an_unknown_query(tmp_path):
    with SerialRig(tmp_path) as rig:
        answer = rig.instruments.supply.answer
        rig.instruments.supply_link.answer = lambda command: None if "TRIP" in command else answer(command)
        rig.instruments.supply_link.withheld = lambda: rig.deadlines.skip(REPLY_TIMEOUT_S)
        with pytest.raises(ConnectionLostError, match=r"VOLT:PROT:TRIP\? in time"):
            rig.supply.energise(10.0, 1.0)
        assert rig.supply.protection_unknown == ""
        assert rig.switched() == []


def test_echoes_are_no_answers(tmp_path):
    with SerialRig(tmp_path, setup_commands=("SYST:REM",)) as rig:
        rig.instruments.supply_link.inject(echo=True)
        rig.supply.energise(10.0, 1.0)
        assert rig.supply.read(READ_TIMEOUT_S).voltage_v == 10.0
        rig.instruments.supply_link.inject(silent=True)
        with pytest.raises(ConnectionLostError, match="in time"):
            rig.supply.read(READ_TIMEOUT_S)


def test_the_climate_probe_may_send_its_units(tmp_path):
    with SerialRig(tmp_path, way="tcp") as rig:
        replies = {"MEAS:TEMP?": "22.50 C", "MEAS:HUM?": "45.0 %RH"}
        answer = rig.instruments.climate.answer
        rig.instruments.climate_link.answer = lambda asked: replies.get(asked) or answer(asked)
        reading = rig.climate.read(READ_TIMEOUT_S)
        assert (reading.temperature_c, reading.relative_humidity) == (22.5, 0.45)
        replies["MEAS:TEMP?"] = "72.50 F"
        with pytest.raises(ConnectionLostError, match="expected C or degC"):
            rig.climate.read(READ_TIMEOUT_S)


# Ways ----------------------------------------------------------------------------------------------


def test_a_socket_without_a_listener_is_reported_with_its_address(tmp_path):
    with SerialRig(tmp_path, way="tcp") as rig:
        rig.instruments.supply_link.unplug()
        with pytest.raises(ConnectionLostError, match=r"tcp:127\.0\.0\.1:\d+ takes no connection .*address"):
            rig.supply.read(READ_TIMEOUT_S)


def visa_supply(rig, resource):
    from dataclasses import replace

    line = replace(rig.supply_parameters.line, port=f"visa:{resource}")
    return type(rig.supply)(replace(rig.supply_parameters, line=line), stamp=rig.clock.stamp)


@pytest.mark.parametrize(
    ("resource", "kind", "complaint"),
    [
        ("NONSENSE", ConfigurationError, "cannot be opened"),
        ("GPIB0::5::INSTR", ConfigurationError, "cannot be opened"),
        (
            "TCPIP0::127.0.0.1::1::SOCKET",
            ConnectionLostError,
            r"check its plug and power|check cable and power",
        ),
    ],
)
def test_a_resource_that_cannot_be_opened_is_reported(tmp_path, monkeypatch, resource, kind, complaint):
    pytest.importorskip("pyvisa_py", reason="the extra visa is not installed")
    monkeypatch.setenv("PYVISA_LIBRARY", "@py")  # whatever is installed here
    with SerialRig(tmp_path) as rig, pytest.raises(kind, match=complaint):
        visa_supply(rig, resource).identity()


def test_without_pyvisa_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvisa", None)
    monkeypatch.delitem(sys.modules, "hardware_drivers.serial_port.visa_port", raising=False)
    with SerialRig(tmp_path) as rig, pytest.raises(ConfigurationError, match=r'install "solimon\[visa\]"'):
        visa_supply(rig, "GPIB0::5::INSTR").identity()
