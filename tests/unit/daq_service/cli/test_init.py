"""`solimon init`: the written file loads and runs, or names the missing values."""

import json
import tomllib

import pytest
from click.testing import CliRunner
from support.small_experiment import rows_of, run, small_settings

from daq_service.cli.main import cli
from daq_service.errors import UsageError
from daq_service.settings.file import find_config_file, load_settings
from daq_service.settings.tree import Settings

LAB = [
    *("--set", "name=Tank 3"),
    *("--set", "rig.daqmx.transducers.*.board_serial=01A2B3C4"),
    *("--set", "rig.niscope.probes.A.resource=PXI1Slot3"),
    *("--set", "rig.niscope.probes.A.serial_number=1E2F3A4B"),
    *("--set", "rig.supply.identity=MAKER,MODEL,7"),
    *("--set", "rig.supply.line.port=COM4"),
]


def init(*arguments):
    return CliRunner().invoke(cli, ["init", *map(str, arguments)])


def write_configuration(*arguments):
    result = init(*arguments, "--json")
    assert result.exception is None, result.exception
    return json.loads(result.stdout)


def refusal(*arguments):
    error = init(*arguments).exception
    assert isinstance(error, UsageError), error
    return str(error)


def test_the_twin_s_is_the_paper_s_experiment(tmp_path):
    file = tmp_path / "twin.toml"
    answer = write_configuration("twin", file)
    assert answer == {
        "kind": "twin",
        "file": str(file),
        "schema": str(tmp_path / "settings.schema.json"),
        "placeholders": [],
    }
    assert load_settings(file) == Settings()
    text = file.read_text(encoding="utf-8")
    assert text.startswith("#:schema ./settings.schema.json\n")
    shipped = find_config_file("settings.schema.json").read_bytes()
    assert (tmp_path / "settings.schema.json").read_bytes() == shipped


def test_the_rig_s_is_the_shipped_laboratory_toml(tmp_path):
    answer = write_configuration("rig", tmp_path / "lab.toml")
    shipped = find_config_file("laboratory.toml")
    assert (tmp_path / "lab.toml").read_bytes() == shipped.read_bytes(), (
        "renew it: solimon init rig NEW, then NEW in the place of config/laboratory.toml"
    )
    assert len(answer["placeholders"]) == 8
    assert "rig.supply.line.port" in answer["placeholders"]


@pytest.mark.parametrize("command", ["check-config", "run", "record", "doctor", "serve", "status"])
def test_no_command_accepts_a_rig_with_placeholders(command, tmp_path):
    write_configuration("rig", tmp_path / "lab.toml")
    data = tmp_path / "data"
    error = CliRunner().invoke(cli, [command, str(tmp_path / "lab.toml"), "--data-dir", str(data)]).exception
    assert isinstance(error, UsageError)
    assert error.exit_code == 2
    assert str(error).count("\n  rig.") == 7
    assert not data.exists(), "nothing is made for it"


def test_flags_fill_a_rig_in(tmp_path):
    answer = write_configuration("rig", tmp_path / "lab.toml", *LAB, "--set", "schedule.shots_per_set=12")
    assert answer["placeholders"] == []
    settings = load_settings(tmp_path / "lab.toml")
    assert {wiring.board_serial for wiring in settings.rig.daqmx.transducers.values()} == {"01A2B3C4"}
    assert settings.schedule.shots_per_set == 12


def test_tables_are_switched_on_and_off(tmp_path):
    file = tmp_path / "lab.toml"
    without = ["--without", "rig.niscope", "--without", "positions.A", "--without", "rig.supply"]
    answer = write_configuration("rig", file, *without, "--with", "rig.climate", *LAB[:4])
    assert answer["placeholders"] == ["rig.climate.identity", "rig.climate.line.port"]
    rig = tomllib.loads(file.read_text(encoding="utf-8"))["rig"]
    assert [name for name, value in rig.items() if isinstance(value, dict)] == ["daqmx", "climate"]
    assert '\n#[rig.supply.line]\n#port = "PLACEHOLDER" ' in file.read_text(encoding="utf-8")


def test_a_recording_of_solimon_is_played_back_as_it_was_recorded(tmp_path):
    recording = tmp_path / "recording"
    assert run(small_settings(schedule={"end_h": 0.5}, clock={"epoch": "2025-03-01T00:00:00Z"}), recording)
    file = tmp_path / "playback.toml"
    assert write_configuration("playback", file, "--source", recording)["placeholders"] == []
    settings = load_settings(file)
    assert run(settings, tmp_path / "played")
    assert rows_of(tmp_path / "played")["set_features"] == rows_of(recording)["set_features"] != []


def test_no_file_is_overwritten(tmp_path):
    file, schema = tmp_path / "twin.toml", tmp_path / "settings.schema.json"
    file.write_text("mine")
    assert "is not written over" in refusal("twin", file)
    assert not schema.exists()
    schema.write_text("another")
    assert "maybe of another version" in refusal("twin", tmp_path / "other.toml")
    assert (file.read_text(), schema.read_text()) == ("mine", "another")
    assert not (tmp_path / "other.toml").exists()


def test_only_a_toml_file_is_written(tmp_path):
    assert "let its name end in .toml" in refusal("twin", tmp_path / "new.json")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["twin", "--source", "."], "--source names the recording"),
        (["playback"], "--source names the recording"),
        (["playback", "--source", "nowhere"], "nowhere is not there"),
        (["twin", "--set", "schedule.shots_pr_set=5"], "did you mean schedule.shots_per_set?"),
        (["twin", "--set", "schedule.shots_per_set=five"], "five is not a TOML value"),
        (["twin", "--set", "schedule.shots_per_set=0"], "schedule.shots_per_set: Input should be greater"),
        (["rig", "--with", "rig.climat"], "did you mean rig.climate?"),
    ],
)
def test_an_impossible_request_is_rejected_before_the_file_is_written(arguments, message, tmp_path):
    kind, *options = arguments
    assert message in refusal(kind, tmp_path / "new.toml", *options)
    assert list(tmp_path.iterdir()) == []
