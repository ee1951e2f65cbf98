"""Sets of mixed rigs through the recorder: NI boards (on doubles) with instruments of another package."""

import json
import threading
from dataclasses import replace

import pytest
from pydantic import TypeAdapter
from support.daqmx_rig import coil_pulses_s, parameters_of, quick_description, reach, why_no
from support.offered_kinds import offer
from support.scripted_kinds import OFFERED, begin_script
from support.small_experiment import run
from support.stored_files import read_set, set_files

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.rows import EnvironmentRow, SetRow
from daq_service.cli.doctor.command import run_doctor
from daq_service.clock import WallClock
from daq_service.corrosion_drive.watch import DriveWatch
from daq_service.processes.data_folder import hold_recorder_lock, prepare_data_folder
from daq_service.recording.session import compute_longest_call_s, record_test
from daq_service.rig.open_rig import open_rig, open_supply
from daq_service.settings.instruments import fill_instrument_defaults
from daq_service.settings.tree import Settings
from hardware_drivers.daqmx.parameters import DaqmxParameters

HAMMER, SCOPE = {"kind": "scripted-hammer"}, {"kind": "scripted-scope"}
SHOTS = 3
SOON_H = 1e-6
"""The only set is due as soon as the test begins."""

on_boards = pytest.mark.skipif(bool(why_no("library")), reason=why_no("library") or "the double can be built")


@pytest.fixture
def script(tmp_path, monkeypatch):
    offer(monkeypatch, tmp_path / "site", OFFERED)
    return begin_script()


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "data"


DESCRIPTION = quick_description()


@pytest.fixture
def doubles(doubles, monkeypatch):
    reach("library", doubles, monkeypatch)
    return doubles


def mixed(instruments, places, **rig):
    """Return settings of one set of a mixed rig; places name digitizer and striker."""
    served = {name: {"digitizer": one, "striker": other} for name, (one, other) in places.items()}
    return fill_instrument_defaults(
        Settings(
            positions={name: {"method": "solitary_wave"} for name in places},
            clock={"kind": "wall"},
            rig={"kind": "mixed", "instruments": instruments, "positions": served, **rig},
            schedule={
                "phases": [{"until_h": SOON_H, "interval_h": SOON_H}],
                "shots_per_set": SHOTS,
                "shot_interval_s": 1e-4,
            },
            baseline={"minimum_valid_shots": 2},
            quality={"restrikes_per_set": 0},
        )
    )


def boards(doubles, position, **ends):
    """Return the table of the boards with one transducer that is only partly wired."""
    parameters = parameters_of(DESCRIPTION, doubles)
    wiring = replace(parameters.transducers[position], **ends)
    values = TypeAdapter(DaqmxParameters).dump_python(
        replace(parameters, transducers={position: wiring}), mode="json"
    )
    return {"kind": "daqmx", **values}


def set_rows(folder):
    with open_catalogue(folder) as catalogue:
        return {row.position: row for row in catalogue.rows(SetRow)}


def events_of(folder, *kinds):
    with open_catalogue(folder) as catalogue:
        return [row for row in catalogue.read_events_after(0) if row.kind in kinds]


@on_boards
def test_boards_strike_and_another_instrument_digitizes(script, doubles, folder):
    instruments = {"boards": boards(doubles, "C", input=""), "scope": SCOPE}
    assert run(mixed(instruments, {"C": ("scope", "boards")}), folder)
    assert set_rows(folder)["C"].state == "done"
    record = doubles.control.record()
    assert coil_pulses_s(record) == pytest.approx([3e-3] * SHOTS)
    assert not [call for call in record["calls"] if "AIVoltage" in call["function"]], "no input is taken"
    assert script.events == ["open", *["arm C", "read C"] * SHOTS, "disarm", "close"]
    stored = read_set(set_files(folder)[0])
    assert (stored.rig_kind, len(stored.shots)) == ("mixed", SHOTS)
    identity = stored.provenance["rig_identity"]
    assert identity["scope"] == "scripted-scope, lab-drivers 1.2"
    assert identity["scope.serial_number"] == "S-77"
    assert identity["boards"].startswith("daqmx, solimon ")
    assert "boards.daqmx_driver_version" in identity


@on_boards
def test_boards_digitize_what_another_instrument_strikes(script, doubles, folder):
    instruments = {"boards": boards(doubles, "C", counter=""), "relay": {"kind": "scripted-relay"}}
    settings = mixed(instruments, {"C": ("boards", "relay")}, read_timeout_s=60.0)
    assert run(settings, folder)
    stored = read_set(set_files(folder)[0])
    assert [shot.settings["input"] for shot in stored.shots] == ["ai0"] * SHOTS
    # The wave of the specimen behind the board passes its own trigger level.
    assert all(shot.waveform.volts().max() > 0.25 for shot in stored.shots)
    assert script.events == ["open", *["strike C"] * SHOTS, "make_safe", "close"]
    assert len(coil_pulses_s(doubles.control.record())) == SHOTS


def test_a_person_is_prompted_on_every_channel_until_the_strike_ends(script, folder):
    heard = []
    settings = mixed({"hammer": HAMMER, "scope": SCOPE}, {"B": ("scope", "hammer")}, read_timeout_s=400.0)
    prepare_data_folder(folder)
    with hold_recorder_lock(folder):
        assert record_test(
            settings,
            folder,
            open_rig,
            stop=threading.Event(),
            report=lambda event, **values: heard.append((event, values)),
        )
    asked = events_of(folder, "asked", "asked_over")
    assert [row.kind for row in asked] == ["asked", "asked_over"] * SHOTS
    assert asked[2].payload == {
        "text": "strike B now", "position": "B", "set_index": 0, "unscheduled_index": 0,
        "shot_index": 1, "attempt": 0,
        "within_s": 400.0,
    }  # fmt: skip
    assert [event for event, _ in heard if event.startswith("asked")] == ["asked", "asked_over"] * SHOTS
    doing = [values["doing"] for event, values in heard if event == "beat"]
    assert "taking set 0; waiting for a person: strike B now" in doing
    # A beat lasts as long as the read may, or as the plug-in says that a call does, and the stall's margin.
    deadlines = {values["deadline_s"] for event, values in heard if event == "beat"}
    assert deadlines == {500.0 + settings.rig.stall_timeout_s}
    assert compute_longest_call_s(settings) == 500.0


def test_each_instrument_is_opened_once_with_the_positions_it_serves(script):
    settings = mixed({"hammer": HAMMER, "scope": SCOPE}, {"B": ("scope", "hammer"), "C": ("scope", "hammer")})
    clock = WallClock()
    with open_rig(settings, clock, 5):
        pass
    hammer, scope = script.openings
    assert (hammer.serves, scope.serves) == ({"striker": ("B", "C")}, {"digitizer": ("B", "C")})
    assert (scope.positions, scope.epoch_utc_ns, scope.shot_interval_s) == (("B", "C"), 5, 1e-4)
    assert scope.experiment["rig"]["instruments"]["scope"]["range_v"] == 10.0


def test_supply_and_climate_of_other_packages_are_logged(script, folder):
    instruments = {
        "hammer": HAMMER,
        "scope": SCOPE,
        "psu": {"kind": "scripted-supply"},
        "weather": {"kind": "scripted-climate"},
    }
    settings = mixed(
        instruments,
        {"B": ("scope", "hammer")},
        drive={"instrument": "psu", "log_interval_s": 1e-3},
        air={"instrument": "weather", "log_interval_s": 1e-3},
    )
    assert run(settings, folder)
    with open_catalogue(folder) as catalogue:
        (row,) = catalogue.rows(EnvironmentRow)
    assert (row.voltage_v, row.temperature_c, row.relative_humidity) == (9.5, 21.5, 0.4)
    assert read_set(set_files(folder)[0]).environment["voltage_v"] == 9.5
    assert "supply off" in script.events, "the end of the test switches it off"
    clock = WallClock()
    with open_supply(settings, clock) as supply:
        assert supply.identity() == {"maker": "nobody"}
    with open_catalogue(folder, writer=True) as catalogue, open_rig(settings, clock, 0) as rig:
        catalogue.restore_rows([replace(row, charge_coulomb=123.0)])
        restarted = DriveWatch(settings.rig, rig, catalogue, {}, lambda *_: None, lambda _: None)
        assert restarted.summarise_readings()["charge_coulomb"] == 123.0, "a restart goes on counting"
    # The recorder leaves a supply that has a process of its own to that process.
    with open_rig(settings.model_copy(update={"rig": settings.rig.copy_without_supply()}), clock, 0) as rig:
        assert (rig.supply, rig.climate is None) == (None, False)


def test_the_doctor_checks_each_kind_and_strikes_with_the_instruments_of_the_position(
    script, tmp_path, capsys
):
    places = {"B": ("scope", "hammer"), "C": ("scope", "other")}
    settings = mixed({"hammer": HAMMER, "other": HAMMER, "scope": SCOPE}, places)
    config = tmp_path / "rig.json"
    config.write_text(settings.model_dump_json(), encoding="utf-8")
    assert run_doctor(config=config, data_dir=tmp_path / "data", strike="B", as_json=True) == 0
    printed = capsys.readouterr()
    assert "strike B now" in printed.err.splitlines()
    report = json.loads(printed.out)
    checks = {check["name"]: check for check in report["checks"]}
    assert (checks["scope: front panel: lamp"]["state"], checks["scope: front panel: lamp"]["remedy"]) == (
        "warn", "switch on",
    )  # fmt: skip
    assert "other: front panel: lamp" in checks
    assert report["strike"]["features"]["quality"] == "good"
    assert checks["strike B: trigger level"]["values"]["trigger_level_v"] == 0.25
    assert script.events.count("open") == 2, "C's striker is left alone"
    assert "strike B" in script.events
