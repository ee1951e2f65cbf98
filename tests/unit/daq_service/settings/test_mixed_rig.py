"""A rig of several instruments: each position is served, each instrument used, an error names its key."""

import pytest
from support.offered_kinds import offer
from support.scripted_kinds import OFFERED

from daq_service.errors import UsageError
from daq_service.settings.file import load_settings
from daq_service.settings.instruments import validate_instruments
from daq_service.settings.schema import build_schema_with_kinds
from daq_service.settings.stored import list_settings_differences, restore_settings

HEAD = """
[clock]
kind = "wall"
[positions.B]
method = "solitary_wave"
[positions.C]
method = "solitary_wave"
[rig]
kind = "mixed"
"""
BOARDS = """
[rig.instruments.boards]
kind = "daqmx"
[rig.instruments.boards.transducers.B]
board_serial = "01A2B3C4"
[rig.instruments.boards.transducers.C]
board_serial = "01A2B3C4"
input = ""
counter = "ctr1"
output_terminal = "PFI13"
"""
SCOPE = """
[rig.instruments.scope]
kind = "scripted-scope"
range_v = 5.0
"""
PLACES = """
[rig.positions.B]
digitizer = "boards"
striker = "boards"
[rig.positions.C]
digitizer = "scope"
striker = "boards"
"""
GOOD = HEAD + BOARDS + SCOPE + PLACES


PSU = """
[rig.instruments.psu]
kind = "scripted-supply"
[rig.drive]
instrument = "psu"
"""


@pytest.fixture(autouse=True)
def lab_drivers(tmp_path, monkeypatch):
    offer(monkeypatch, tmp_path / "site", OFFERED)


def load(folder, text):
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return load_settings(path)


def test_each_instrument_has_its_positions_and_defaults(tmp_path):
    settings = load(tmp_path, GOOD)
    boards, scope = validate_instruments(settings)
    assert boards.serves == {"digitizer": ("B",), "striker": ("B", "C")}
    assert (scope.serves, scope.parameters.range_v) == ({"digitizer": ("C",)}, 5.0)
    assert settings.rig.instruments["scope"].parameters == {"range_v": 5.0, "address": "usb"}
    assert settings.rig.instruments["boards"].parameters["pulse_s"] == 0.1


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('digitizer = "scope"\n', "", r"rig.positions.C.digitizer is missing; a solitary_wave position need"),
        ('[rig.positions.C]\ndigitizer = "scope"\nstriker = "boards"', "", "rig.positions.C.digitizer is mi"),
        ('digitizer = "scope"', 'digitizer = "scop"', "rig.positions.C.digitizer is 'scop'; there are: boar"),
        ('digitizer = "scope"', 'digitizer = "boards"', r"transducers.C.input is missing; these boards are "),
        ('digitizer = "boards"', 'digitizer = "scope"', r"transducers.B.input is 'ai0', but these boards ar"),
        ('striker = "boards"\n[', 'striker = "scope"\n[', "rig.positions.B.striker is 'scope', whose kind '"),
        ('striker = "boards"\n[', 'striker = "boards"\npulse_echo = "scope"\n[', "B is a solitary_wave posi"),
        ("[rig.positions.B]", "[rig.positions.E]", r"rig.positions.B.digitizer is missing"),
        (PLACES, PLACES + '[rig.positions.E]\nstriker = "boards"\n', "rig.positions.E is not in .po"),
        (SCOPE, SCOPE + '[rig.instruments.spare]\nkind = "scripted-hammer"\n', "spare: no position uses it;"),
        ('kind = "scripted-scope"', 'kind = "picoscope"', r"rig.instruments.scope: no installed package off"),
        ("range_v = 5.0", "range_v = 70.0", r"rig.instruments.scope.range_v: .*less than or equal to 50 .va"),
        ("range_v = 5.0", "rang_v = 5.0", r"rig.instruments.scope.rang_v: unknown key; did you mean range_v"),
        ('input = ""', 'inputs = ""', r"rig.instruments.boards.transducers.C.inputs: unknown key"),
        ('kind = "mixed"', 'kind = "simulated"', r"kind is 'simulated', which has no \[rig.instruments\]"),
        (BOARDS + SCOPE + PLACES, "", "which needs .rig.instruments.NAME"),
        (SCOPE, SCOPE + "[rig.daqmx.transducers.B]\nboard_serial = '1'\n", r"has no \[rig.daqmx\]; make it"),
        ("[rig.instruments.scope]", '[rig.instruments."my scope"]', "instrument name 'my scope': use up"),
        ('kind = "wall"', 'kind = "simulated"', "a real rig needs the wall clock"),
        ('kind = "daqmx"', 'kind = "daqmx"\nholdoff_s = 0.01', "holdoff_s is 0.01 s, but transducers.C has "),
    ],
)  # fmt: skip
def test_an_invalid_instrument_is_rejected_with_key_and_remedy(old, new, complaint, tmp_path):
    assert old in GOOD
    if "holdoff" in new:  # C digitized without its counter
        text = GOOD.replace('input = ""\ncounter = "ctr1"', 'input = "ai1"\ncounter = ""')
        text = text.replace('"scope"\nstriker = "boards"', '"boards"\nstriker = "hammer"')
        text = text.replace(SCOPE, '[rig.instruments.hammer]\nkind = "scripted-hammer"\n')
    else:
        text = GOOD
    with pytest.raises(UsageError, match=complaint) as refusal:
        load(tmp_path, text.replace(old, new, 1))
    assert str(refusal.value).startswith(str(tmp_path / "rig.toml"))


def test_two_instruments_of_one_kind_are_two(tmp_path):
    second = '[rig.instruments.second]\nkind = "scripted-scope"\n'
    boards = BOARDS.replace('"01A2B3C4"\n', '"01A2B3C4"\ninput = ""\n', 1)
    settings = load(tmp_path, HEAD + boards + SCOPE + second + PLACES.replace('"boards"\n', '"second"\n', 1))
    assert [item.name for item in validate_instruments(settings)] == ["boards", "scope", "second"]


def test_the_address_of_an_instrument_does_not_change_the_hash(tmp_path):
    first = load(tmp_path, GOOD)
    moved = load(tmp_path, GOOD.replace("range_v = 5.0", 'range_v = 5.0\naddress = "lan"'))
    other = load(tmp_path, GOOD.replace("range_v = 5.0", "range_v = 10.0"))
    assert first.configuration_hash() == moved.configuration_hash() != other.configuration_hash()
    stored = first.model_dump(mode="json")
    assert list_settings_differences(stored, moved) == []
    assert list_settings_differences(stored, other) == [
        "rig.instruments.scope.range_v started with 5.0, is 10.0 now"
    ]


def test_a_default_that_a_plug_in_got_later_is_no_difference(tmp_path):
    settings = load(tmp_path, GOOD)
    stored = settings.model_dump(mode="json")
    del stored["rig"]["instruments"]["scope"]["range_v"]
    assert list_settings_differences(stored, load(tmp_path, GOOD.replace("range_v = 5.0", ""))) == []


def test_a_folder_is_read_where_the_plug_in_is_not_installed(tmp_path, monkeypatch):
    stored = load(tmp_path, GOOD).model_dump(mode="json")
    monkeypatch.undo()
    settings = restore_settings(stored)
    assert settings.rig.instruments["scope"].kind == "scripted-scope"
    assert settings.configuration_hash()
    with pytest.raises(UsageError, match="no installed package offers the kind 'scripted-scope'"):
        load(tmp_path, GOOD)


def test_the_environment_reaches_a_plug_in_s_parameters(tmp_path, monkeypatch):
    monkeypatch.setenv("SOLIMON_RIG__INSTRUMENTS__SCOPE__RANGE_V", "2.5")
    assert load(tmp_path, GOOD).rig.instruments["scope"].parameters["range_v"] == 2.5


def test_the_drive_is_an_instrument_s_by_its_name(tmp_path):
    settings = load(tmp_path, GOOD + PSU)
    (psu,) = (item for item in validate_instruments(settings) if item.name == "psu")
    assert psu.serves == {"supply": ()}
    assert settings.rig.driven is settings.rig.drive is not None
    assert settings.rig.drive.voltage_v == 10.0
    watched = load(tmp_path, GOOD + PSU + "watchdog_timeout_s = 60.0\n")
    stronger = load(tmp_path, GOOD + PSU + "voltage_v = 11.0\n")
    assert settings.configuration_hash() == watched.configuration_hash() != stronger.configuration_hash()


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('instrument = "psu"', 'instrument = "pso"', "rig.drive.instrument is 'pso'; there are: boards, sco"),
        ('instrument = "psu"', 'instrument = "scope"', "rig.drive.instrument is 'scope', whose kind 'scrip"),
        ('instrument = "psu"', 'instrument = "psu"\nvoltage_v = 13.0', "voltage_v is 13.0; it must be at m"),
        ("[rig.drive]", "[rig.air]", "rig.air.instrument is 'psu', whose kind 'scripted-supply' is a suppl"),
        ("[rig.drive]", '[rig.supply]\nline={port="COM4"}\nidentity="A,B"\n[rig.drive]', "are both given"),
    ],
)  # fmt: skip
def test_a_drive_that_cannot_work_is_refused(old, new, complaint, tmp_path):
    with pytest.raises(UsageError, match=complaint):
        load(tmp_path, GOOD + PSU.replace(old, new))


def test_the_printed_schema_has_the_installed_kinds():
    schema = build_schema_with_kinds()
    kinds = {
        choice["then"]["properties"]["kind"]["const"]: choice["then"]
        for choice in schema["$defs"]["InstrumentSettings"]["allOf"]
    }
    assert kinds["scripted-scope"]["properties"]["range_v"]["maximum"] == 50.0
    assert kinds["scripted-scope"]["additionalProperties"] is False
    below = kinds["daqmx"]["properties"]["transducers"]["additionalProperties"]["$ref"]
    wiring = schema["$defs"][below.removeprefix("#/$defs/")]
    assert wiring["properties"]["counter"]["description"].startswith("Counter that times the coil's pulse")


def test_a_rehearsal_of_one_instrument_is_one_of_the_rig(tmp_path):
    assert not load(tmp_path, GOOD).rig.dry_run
    assert load(tmp_path, GOOD.replace('kind = "daqmx"', 'kind = "daqmx"\ndry_run = true')).rig.dry_run
