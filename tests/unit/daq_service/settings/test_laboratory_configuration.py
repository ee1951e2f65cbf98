"""The shipped laboratory.toml is complete, loadable, and safe."""

import tomllib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass

import pytest

from daq_service.cli.inspection import describe_plan
from daq_service.errors import UsageError
from daq_service.settings.commented import uncomment_tables
from daq_service.settings.file import PLACEHOLDER, find_config_file, load_settings
from daq_service.settings.mixed import MixedRig
from daq_service.settings.rig import RigSettings
from daq_service.settings.tree import Settings

SHIPPED = find_config_file("laboratory.toml").read_text(encoding="utf-8")
TEXT = SHIPPED.replace(PLACEHOLDER, "FFFFFFFF")
WITH_EVERYTHING = uncomment_tables(TEXT)


def load(folder, text):
    path = folder / "laboratory.toml"
    path.write_text(text, encoding="utf-8")
    return load_settings(path)


def missing_keys(given, value, where):
    """Return the keys of a parameter table that the file lacks, nested tables included."""
    if isinstance(value, Mapping):
        return [
            key
            for name, below in value.items()
            for key in missing_keys(given[name], below, f"{where}.{name}")
        ]
    missing = []
    for field in fields(value):
        if field.name not in given:
            if getattr(value, field.name) is None:
                continue  # what is absent by choice cannot be written
            missing.append(f"{where}.{field.name}")
        elif is_dataclass(getattr(value, field.name)) or isinstance(getattr(value, field.name), Mapping):
            missing += missing_keys(given[field.name], getattr(value, field.name), f"{where}.{field.name}")
    return missing


@pytest.mark.parametrize("text", [TEXT, WITH_EVERYTHING], ids=["as shipped", "with everything"])
def test_the_shipped_configuration_is_accepted(text, tmp_path):
    settings = load(tmp_path, text)
    assert settings.rig.kind == "daqmx"
    assert settings.list_positions("solitary_wave") == ["B", "C", "D"]
    assert settings.clock.kind == "wall"


def test_every_key_of_the_rig_is_written_down(tmp_path):
    rig, given = load(tmp_path, WITH_EVERYTHING).rig, tomllib.loads(WITH_EVERYTHING)["rig"]
    # No rig plays back and measures; this one is not mixed.
    assert set(RigSettings.model_fields) - set(given) == {"playback", *MixedRig.model_fields}
    tables = ("daqmx", "niscope", "supply", "climate")
    assert [key for name in tables for key in missing_keys(given[name], getattr(rig, name), name)] == []


def test_the_other_tables_have_the_values_of_the_paper(tmp_path):
    """The files of laboratory and twin differ only in the instruments."""
    laboratory, simulated = load(tmp_path, TEXT), Settings()
    for table in ("schedule", "features", "quality", "baseline", "novelty", "alarms", "ultrasound"):
        assert getattr(laboratory, table) == getattr(simulated, table), table
    assert laboratory.list_positions("pulse_echo") == simulated.list_positions("pulse_echo")
    boards, adc = laboratory.rig.daqmx, simulated.twin.adc
    assert (boards.sample_rate_hz, boards.record_samples, boards.pretrigger_samples) == (
        adc.sample_rate_hz,
        adc.record_samples,
        adc.pretrigger_samples,
    )


def test_each_coil_has_the_home_terminal_of_its_counter():
    """X Series: CTR n OUT is PFI 12 + n, which is line 4 + n of port 2."""
    boards = tomllib.loads(WITH_EVERYTHING)["rig"]["daqmx"]
    wiring = boards["transducers"].values()
    numbers = [int(coil["counter"].removeprefix("ctr")) for coil in wiring]
    assert [coil["output_terminal"] for coil in wiring] == [f"PFI{12 + number}" for number in numbers]
    assert boards["watchdog"]["lines"] == [f"port2/line{4 + number}" for number in numbers]


def test_all_placeholders_are_rejected_together():
    unknown = [
        "name: Name of the test.",
        "rig.daqmx.transducers.B.board_serial: Serial number of the digitizer board",
        "rig.daqmx.transducers.C.board_serial: Serial number of the digitizer board",
        "rig.daqmx.transducers.D.board_serial: Serial number of the digitizer board",
        "rig.niscope.probes.A.resource: Name of the board in NI MAX",
        "rig.niscope.probes.A.serial_number: Serial number the board must report",
        "rig.supply.identity: Regular expression that the answer to `*IDN?`",
        "rig.supply.line.port: A path (`/dev/serial/by-id/...`",
    ]
    file = find_config_file("laboratory.toml")
    with pytest.raises(UsageError) as refused:
        load_settings(file)
    first, *lines, last = str(refused.value).splitlines()
    assert first == f"{file} is not finished; still PLACEHOLDER:"
    assert [line.strip()[: len(expected)] for line, expected in zip(lines, unknown, strict=True)] == unknown
    assert last == f"Fill them in and run `solimon check-config {file}`."


def test_a_placeholder_in_a_list_is_recognized(tmp_path):
    with pytest.raises(UsageError, match=r"still PLACEHOLDER:\n  rig\.supply\.setup_commands"):
        load(tmp_path, TEXT.replace("setup_commands = []", 'setup_commands = ["PLACEHOLDER"]'))


def test_the_environment_may_fill_in(tmp_path, monkeypatch):
    text = TEXT.replace('identity = "FFFFFFFF"', 'identity = "PLACEHOLDER"')
    with pytest.raises(UsageError, match=r"rig\.supply\.identity"):
        load(tmp_path, text)
    monkeypatch.setenv("SOLIMON_RIG__SUPPLY__IDENTITY", "MAKER,MODEL,1")
    supply = load(tmp_path, text).rig.supply
    assert supply.identity == "MAKER,MODEL,1"


def test_the_plan_counts_the_boards_records(tmp_path):
    text = TEXT.replace("record_samples = 13600", "record_samples = 20000")
    text = text.replace("record_samples = 2048", "record_samples = 4096")
    facts = describe_plan(load(tmp_path, text), tmp_path)
    assert (facts["record_samples"], facts["sample_rate_hz"], facts["record_s"]) == (20_000, 10e6, 2e-3)
    # 425 sets: 3 x 10 strikes of int16, one echo of summed int32.
    assert facts["raw_bytes"] == 425 * (30 * 20_000 * 2 + 4096 * 4)


def test_the_plan_of_the_twin_counts_the_twin_s_records(tmp_path):
    facts = describe_plan(Settings(), tmp_path)
    assert (facts["record_samples"], facts["raw_bytes"]) == (13_600, 425 * 2 * (30 * 13_600 + 2048))
