"""The shipped laboratory.toml: complete, loadable, and safe to read as it is."""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest

from daq_service.cli.inspection import describe_plan
from daq_service.settings.file import config_file, load_settings
from daq_service.settings.tree import RigSettings, Settings

TEXT = config_file("laboratory.toml").read_text(encoding="utf-8")
WITH_EVERYTHING = re.sub(r"^#(?=[a-z\[])", "", TEXT, flags=re.MULTILINE)
"""The tables that the file holds switched off are switched on."""


def load(folder: Path, text: str) -> Settings:
    path = folder / "laboratory.toml"
    path.write_text(text, encoding="utf-8")
    return load_settings(path)


def missing_keys(given: Mapping[str, Any], value: Any, where: str) -> list[str]:
    """Keys of a table of parameters that the file does not write down, its own tables included."""
    if isinstance(value, Mapping):
        return [
            key
            for name, below in value.items()
            for key in missing_keys(given[name], below, f"{where}.{name}")
        ]
    missing = []
    for field in fields(value):
        if field.name not in given:
            missing.append(f"{where}.{field.name}")
        elif is_dataclass(getattr(value, field.name)) or isinstance(getattr(value, field.name), Mapping):
            missing += missing_keys(given[field.name], getattr(value, field.name), f"{where}.{field.name}")
    return missing


@pytest.mark.parametrize("text", [TEXT, WITH_EVERYTHING], ids=["as shipped", "with everything"])
def test_it_is_accepted(text: str, tmp_path: Path) -> None:
    settings = load(tmp_path, text)
    assert settings.rig.kind == "daqmx"
    assert settings.names_of("solitary_wave") == ["B", "C", "D"]
    assert settings.clock.kind == "wall"


def test_every_key_of_the_rig_is_written_down(tmp_path: Path) -> None:
    rig, given = load(tmp_path, WITH_EVERYTHING).rig, tomllib.loads(WITH_EVERYTHING)["rig"]
    # No rig plays back and measures.
    assert set(RigSettings.model_fields) - set(given) == {"playback"}
    tables = ("daqmx", "niscope", "supply", "climate")
    assert [key for name in tables for key in missing_keys(given[name], getattr(rig, name), name)] == []


def test_a_key_that_is_not_written_down_is_noticed(tmp_path: Path) -> None:
    """The check above can fail."""
    text = WITH_EVERYTHING.replace('counter = "ctr1"\n', "").replace("timeout_s = 2.0", "")
    rig, given = load(tmp_path, WITH_EVERYTHING).rig, tomllib.loads(text)["rig"]
    assert missing_keys(given["daqmx"], rig.daqmx, "daqmx") == [
        "daqmx.transducers.C.counter",
        "daqmx.watchdog.timeout_s",
    ]


def test_the_other_tables_say_what_the_paper_s_experiment_says() -> None:
    """The laboratory's file and the twin's plan and judge alike; only the instruments differ."""
    laboratory, simulated = load_settings(config_file("laboratory.toml")), Settings()
    for table in ("schedule", "features", "quality", "baseline", "novelty", "alarms", "ultrasound"):
        assert getattr(laboratory, table) == getattr(simulated, table), table
    assert laboratory.names_of("pulse_echo") == simulated.names_of("pulse_echo")
    boards, adc = laboratory.rig.daqmx, simulated.twin.adc
    assert boards is not None
    assert (boards.sample_rate_hz, boards.record_samples, boards.pretrigger_samples) == (
        adc.sample_rate_hz,
        adc.record_samples,
        adc.pretrigger_samples,
    )


def test_each_coil_has_the_home_terminal_of_its_counter() -> None:
    """X Series: CTR n OUT is PFI 12 + n, which is line 4 + n of port 2."""
    boards = tomllib.loads(WITH_EVERYTHING)["rig"]["daqmx"]
    wiring = boards["transducers"].values()
    numbers = [int(coil["counter"].removeprefix("ctr")) for coil in wiring]
    assert [coil["output_terminal"] for coil in wiring] == [f"PFI{12 + number}" for number in numbers]
    assert boards["watchdog"]["lines"] == [f"port2/line{4 + number}" for number in numbers]


def test_every_placeholder_is_called_one() -> None:
    named = [line for line in TEXT.splitlines() if "FFFFFFFF" in line or "MAKER" in line or "by-id" in line]
    assert len(named) == 9
    assert all("PLACEHOLDER" in line.partition(" #")[2] for line in named)


def test_a_rehearsal_is_one_variable_away(monkeypatch: pytest.MonkeyPatch) -> None:
    assert load_settings(config_file("laboratory.toml")).rig.daqmx.dry_run is False
    monkeypatch.setenv("SOLIMON_RIG__DAQMX__DRY_RUN", "true")
    rehearsal = load_settings(config_file("laboratory.toml"))
    assert rehearsal.rig.daqmx.dry_run is True
    assert list(rehearsal.rig.daqmx.transducers) == ["B", "C", "D"]


def test_the_plan_counts_the_boards_records(tmp_path: Path) -> None:
    text = TEXT.replace("record_samples = 13600", "record_samples = 20000")
    text = text.replace("record_samples = 2048", "record_samples = 4096")
    facts = describe_plan(load(tmp_path, text), tmp_path)
    assert (facts["record_samples"], facts["sample_rate_hz"], facts["record_s"]) == (20_000, 10e6, 2e-3)
    # 425 sets: 3 x 10 strikes of int16, one echo of summed int32.
    assert facts["raw_bytes"] == 425 * (30 * 20_000 * 2 + 4096 * 4)


def test_the_plan_of_the_twin_counts_the_twin_s_records(tmp_path: Path) -> None:
    facts = describe_plan(Settings(), tmp_path)
    assert (facts["record_samples"], facts["raw_bytes"]) == (13_600, 425 * 2 * (30 * 13_600 + 2048))
