"""Checks of software, machine and folder by `solimon doctor`, with each state of each check."""

import json
import sys
import time
import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path, PureWindowsPath
from types import SimpleNamespace
from typing import Any, cast

import pytest
from support.kept_folder import lay_out
from support.small_experiment import small_settings

from daq_service.cli.doctor.check import Check, build_finding_check, choose_exit_code
from daq_service.cli.doctor.command import run_doctor
from daq_service.cli.doctor.machine import check_machine
from daq_service.cli.doctor.software import check_software
from daq_service.cli.doctor.storage import check_storage, lock_folder, read_lock_owner
from daq_service.cli.doctor.trial import Trial
from daq_service.cli.doctor.unattended import run_program
from daq_service.cli.forecast import (
    CATALOGUE_BYTES_A_RECORD,
    predict_confirmation_bytes,
    predict_set_file_bytes,
    predict_stored_bytes,
)
from daq_service.errors import BusyError, UsageError
from daq_service.processes.data_folder import (
    hold_recorder_lock,
    load_settings_for_reading,
    prepare_data_folder,
)
from daq_service.settings.file import find_config_file
from daq_service.settings.instruments import validate_instruments
from daq_service.settings.tree import Settings, StorageSettings
from hardware_drivers.daqmx.look import find_digital_line, yield_board_findings
from hardware_drivers.daqmx.survey import Survey, format_trigger

VALUES = tomllib.loads(
    find_config_file("laboratory.toml").read_text("utf-8").replace("PLACEHOLDER", "FFFFFFFF")
)
LABORATORY = Settings(**VALUES).rig
PACKAGES = [
    name for item in validate_instruments(Settings(**VALUES)) for name in item.kind.packages(item.parameters)
]


def by_name(checks):
    return {check.name: check for check in checks}


# The checks themselves ------------------------------------------------------------------------------


def check(area, state):
    return Check(area, "it", state, "something", "fix it")


@pytest.mark.parametrize(
    ("checks", "code"),
    [
        ([check("rig", "ok"), check("machine", "warn"), check("rig", "skipped")], 0),
        ([check("software", "fail")], 2),
        ([check("software", "fail"), check("folder", "fail")], 4),
        ([check("folder", "fail"), check("rig", "fail"), check("software", "fail")], 3),
        ([check("rig", "fail"), check("recorder", "fail")], 5),
    ],
)
def test_the_worst_area_gives_the_exit_code(checks, code):
    assert choose_exit_code(checks) == code


def test_a_passed_check_has_no_remedy():
    assert Check("rig", "coils", "ok", "cool", "let them cool").remedy == ""


def test_a_failed_check_needs_a_remedy():
    with pytest.raises(ValueError, match="needs a remedy"):
        Check("rig", "it", "warn", "something")


# Software -------------------------------------------------------------------------------------------


def test_the_packages_of_this_environment_pass():
    checks = by_name(check_software(PACKAGES))
    assert {check.state for check in checks.values()} == {"ok"}
    assert checks["numpy"].found == f"{version('numpy')} (at least 2.0)"
    assert {"nidaqmx", "niscope", "pyserial"} <= set(checks)


def test_a_rig_without_boards_needs_no_board_packages():
    (twin,) = validate_instruments(Settings())
    assert list(twin.kind.packages(twin.parameters)) == ["numba", "llvmlite"]
    assert not {"numba", "llvmlite"} & set(by_name(check_software(())))
    assert not {"nidaqmx", "niscope", "pyserial", "grpcio"} & set(by_name(check_software(())))


def test_a_missing_and_an_old_package_have_a_remedy():
    def installed(name):
        if name in ("niscope", "numba", "picosdk"):
            raise PackageNotFoundError(name)
        return {"nidaqmx": "0.9.0", "numpy": "1.26.4"}.get(name, "99.0")

    checks = by_name(check_software([*PACKAGES, "numba", "picosdk"], installed=installed))
    assert checks["picosdk"].remedy == 'install it: python -m pip install "picosdk"', "no extra of ours"
    assert checks["niscope"].found == "not installed"
    assert "solimon[niscope]" in checks["niscope"].remedy
    assert "solimon[twin]" in checks["numba"].remedy
    assert checks["nidaqmx"].found == "0.9.0 (at least 1.0)"
    assert checks["numpy"].state == "fail"
    failing = {name for name, one in checks.items() if one.state == "fail"}
    assert failing == {"niscope", "nidaqmx", "numba", "numpy", "picosdk"}


def test_a_package_that_does_not_load_is_named():
    def load(name):
        if name == "numba":
            raise OSError("libLLVM: cannot open shared object file")

    found = by_name(check_software(["numba"], load=load))["compiled packages"]
    assert (found.state, "numba does not load (OSError: libLLVM" in found.found) == ("fail", True)
    assert found.remedy.endswith("--force-reinstall numba")


# Machine --------------------------------------------------------------------------------------------

FOLDER = Path("data")
ON_BATTERY_AND_MAINS = """\
GUID des Energieschemas: 381b4222-f694-41f0-9685-ff5bb260df2e  (Ausbalanciert)
    Minimale Einstellung: 0x00000000
    Index der aktuellen Wechselstromeinstellung: {mains}
    Index der aktuellen Gleichstromeinstellung: 0x00000384
"""


def answers(**by_program):
    def ask(command):
        return by_program.get(command[0].replace("-", "_"))

    return ask


@pytest.mark.parametrize(
    ("system", "answer", "state"),
    [
        ("linux", {"timedatectl": "yes"}, "ok"),
        ("linux", {"timedatectl": "no"}, "warn"),
        ("linux", {"chronyc": "A29FC801,time,3,1.0,0.0,0.0,0.0,0.0,0.0,0.0,0.0,0.0,64.0,Normal"}, "ok"),
        (
            "linux",
            {"chronyc": "00000000,,0,0.0,0.0,0.0,0.0,0.0,0.0,0.0,1.0,1.0,0.0,Not synchronised"},
            "warn",
        ),
        ("linux", {}, "warn"),
        ("win32", {"w32tm": "Sprungindikator: 0(keine Warnung)"}, "ok"),
        ("win32", {"w32tm": "Leap Indicator: 3(not synchronized)"}, "warn"),
        ("win32", {}, "warn"),
        ("darwin", {}, "warn"),
    ],
)
def test_the_clock_check_has_state_and_source(system, answer, state):
    found = by_name(check_machine("wall", FOLDER, ask=answers(**answer), system=system))["clock synchronised"]
    assert found.state == state
    assert ("unknown" in found.found) == (not answer)
    assert next(iter(answer), "") in found.found, "it says who was asked"


@pytest.mark.parametrize(
    ("system", "answer", "state"),
    [
        ("linux", {"systemctl": "masked"}, "ok"),
        ("linux", {"systemctl": "static"}, "warn"),
        ("linux", {}, "warn"),
        ("win32", {"powercfg": ON_BATTERY_AND_MAINS.format(mains="0x00000000")}, "ok"),
        ("win32", {"powercfg": ON_BATTERY_AND_MAINS.format(mains="0x00000708")}, "warn"),
        ("win32", {}, "warn"),
    ],
)
def test_the_sleep_check_follows_the_power_settings(system, answer, state):
    found = by_name(check_machine("wall", FOLDER, ask=answers(**answer), system=system))["sleep"]
    assert found.state == state
    assert ("unknown" in found.found) == (not answer)


def test_the_sleep_check_names_the_settings():
    ask = answers(systemctl="static", busctl='s "suspend"')
    found = by_name(check_machine("wall", FOLDER, ask=ask, system="linux"))["sleep"]
    assert "not switched off (systemctl, IdleAction of logind is suspend)" in found.found


def test_a_computer_that_hibernates_sleeps_too():
    def ask(command):
        hibernates = "0x00000e10" if command[-1] == "HIBERNATEIDLE" else "0x00000000"
        return ON_BATTERY_AND_MAINS.format(mains=hibernates) if command[0] == "powercfg" else None

    assert by_name(check_machine("wall", FOLDER, ask=ask, system="win32"))["sleep"].state == "warn"


UPGRADES = 'APT "";\nAPT::Periodic::Unattended-Upgrade "1";\n'
REBOOTS = UPGRADES + 'Unattended-Upgrade::Automatic-Reboot "true";\n'
KEY = r"HKEY_LOCAL_MACHINE\SOFTWARE\Policies\Microsoft\Windows\WindowsUpdate\AU"


@pytest.mark.parametrize(
    ("system", "answer", "restarts", "waits"),
    [
        ("linux", {"apt_config": UPGRADES}, False, False),
        ("linux", {"apt_config": REBOOTS}, True, False),
        ("linux", {"apt_config": REBOOTS.replace('"1"', '"0"')}, False, False),
        ("linux", {"apt_config": UPGRADES, "ls": "/run/reboot-required"}, False, True),
        ("linux", {"systemctl": "disabled"}, False, False),
        ("linux", {"systemctl": "enabled"}, None, False),
        ("linux", {}, None, False),
        ("win32", {"reg": f"{KEY}\n    NoAutoUpdate    REG_DWORD    0x1"}, False, True),
        ("win32", {"reg": f"{KEY}\n    AUOptions    REG_DWORD    0x2"}, False, True),
        ("win32", {"reg": f"{KEY}\n    AUOptions    REG_DWORD    0x4"}, None, True),
        ("win32", {}, None, False),
        ("darwin", {}, None, None),
    ],
)
def test_the_update_check_follows_the_restart_settings(system, answer, restarts, waits):
    found = by_name(check_machine("wall", FOLDER, ask=answers(**answer), system=system))["updates"]
    assert (found.values["restart_by_themselves"], found.values["restart_waits"]) == (restarts, waits)
    assert found.state == ("ok" if restarts is False and not waits else "warn")
    assert ("unknown" in found.found) == (restarts is None)
    assert ("restart it before the test" in found.remedy) == bool(waits)


HIDDEN = "True\nN/A: Must be an administrator to view exclusions"


@pytest.mark.parametrize(
    ("system", "answer", "left_alone", "message"),
    [
        ("linux", {"ps": "systemd\nbash"}, True, "none that is known"),
        ("linux", {"ps": "systemd\nclamonacc"}, None, "ClamAV"),
        ("linux", {}, None, "unknown"),
        ("win32", {"powershell": "False"}, True, "off"),
        ("win32", {"powershell": "True\nC:\\other\nc:\\LAB"}, True, "an exception"),
        ("win32", {"powershell": "True\nC:\\lab\\data2"}, False, "no exception"),
        ("win32", {"powershell": "True"}, False, "no exception"),
        ("win32", {"powershell": HIDDEN}, None, "only administrators"),
        ("win32", {}, None, "unknown"),
        ("darwin", {}, None, "not asked"),
    ],
)
def test_the_scanner_check_follows_the_exclusions(system, answer, left_alone, message):
    folder = cast(Path, PureWindowsPath("C:\\Lab\\Data")) if system == "win32" else FOLDER
    found = by_name(check_machine("wall", folder, ask=answers(**answer), system=system))["antivirus"]
    assert (found.values["data_folder_left_alone"], message in found.found) == (left_alone, True)
    assert found.state == ("ok" if left_alone else "warn")
    assert str(folder) in found.remedy or found.state == "ok"


def test_on_simulated_time_computer_checks_are_skipped():
    checks = by_name(check_machine("simulated", FOLDER, ask=answers(), system="linux"))
    skipped = {name for name, one in checks.items() if one.state == "skipped"}
    assert skipped == {"clock synchronised", "sleep", "updates", "antivirus"}


@pytest.mark.parametrize(("step_s", "state"), [(0.0, "ok"), (3600.0, "warn"), (-2.0, "warn")])
def test_a_clock_step_during_the_check_is_detected(step_s, state):
    checks = check_machine(
        "simulated", FOLDER, started_wall_s=time.time() - 5.0 - step_s, started_mono_s=time.monotonic() - 5.0
    )
    assert by_name(checks)["monotonic clock"].state == state


def test_a_missing_or_failing_program_gives_no_answer():
    assert run_program(["solimon-no-such-program"]) is None
    assert run_program([sys.executable, "-c", "raise SystemExit(1)"]) is None
    assert run_program([sys.executable, "-c", "print('masked'); raise SystemExit(1)"]) == "masked"


# Folder ---------------------------------------------------------------------------------------------


AMPLE = dict.fromkeys(("warn_free_fraction", "alarm_free_fraction", "stop_free_fraction"), 0.0)
"""However full this machine's volume is."""


def test_a_new_folder_passes_and_is_not_created(tmp_path):
    folder = tmp_path / "a" / "b"
    checks = by_name(check_storage(Settings(storage=AMPLE), folder))
    assert {item.state for item in checks.values()} == {"ok"}
    assert "to be made" in checks["data folder: writable"].found
    assert list(tmp_path.iterdir()) == [], "the probe is gone, the folder was not made"


def test_a_folder_of_the_same_test_passes_with_its_counts(tmp_path):
    settings, _ = load_settings_for_reading(None, lay_out(tmp_path))
    settings = settings.model_copy(update={"storage": StorageSettings(**AMPLE)})
    checks = by_name(check_storage(settings, tmp_path))
    assert {item.state for item in checks.values()} == {"ok"}
    assert checks["disk: space"].values["stored_bytes"] == sum(
        path.stat().st_size for path in (tmp_path / "sets").glob("*.h5")
    )
    lost, emptied, *_ = sorted((tmp_path / "sets").glob("*.h5"))
    lost.unlink()
    emptied.write_bytes(b"")
    found = by_name(check_storage(settings, tmp_path))["data folder: sets"]
    assert (found.state, found.values["lost_sets"]) == ("fail", 2)
    assert found.found == f"sets/{lost.name} is missing; sets/{emptied.name} is empty"
    other = by_name(check_storage(small_settings(twin={"seed": 2}), tmp_path))
    assert other["data folder: configuration"].state == "fail"
    assert "belongs to the test" in other["data folder: configuration"].found


def test_a_lost_catalogue_fails_and_the_sets_identify_the_test(tmp_path):
    settings, _ = load_settings_for_reading(None, lay_out(tmp_path))
    for name in ("catalogue.sqlite", "experiment.json", "history.jsonl"):
        (tmp_path / name).unlink()
    own = by_name(check_storage(settings, tmp_path))
    assert own["data folder: configuration"].state == "ok"
    assert own["data folder: catalogue"].state == "fail"
    assert f"`solimon rebuild --data-dir {tmp_path}` makes it again" in own["data folder: catalogue"].found
    other = by_name(check_storage(small_settings(twin={"seed": 2}), tmp_path))
    assert other["data folder: configuration"].state == "fail"
    assert "belongs to the test" in other["data folder: configuration"].found


@pytest.mark.parametrize(
    ("free_gb", "total_gb", "state"),
    [
        (10.0, 10, "ok"),
        (0.6, 10, "warn"),
        (0.3, 10, "fail"),
        # A full volume is reported even if the test would fit.
        (210.0, 1000, "ok"),
        (190.0, 1000, "warn"),
        (90.0, 1000, "warn"),
        (49.0, 1000, "fail"),
    ],
)
def test_the_disk_is_compared_with_the_plan(tmp_path, monkeypatch, free_gb, total_gb, state):
    usage = SimpleNamespace(free=round(free_gb * 1e9), total=total_gb * 10**9)
    monkeypatch.setattr("daq_service.processes.disk_policy.shutil.disk_usage", lambda place: usage)
    found = by_name(check_storage(Settings(), tmp_path))["disk: space"]
    assert found.state == state
    assert found.values["needed_bytes"] == predict_stored_bytes(Settings(), 425)


def test_confirmation_sets_are_forecast_as_an_upper_bound():
    """Two per day at each of three transducers, in the fourteen days after a baseline of 24 h."""
    a_set = predict_confirmation_bytes(Settings(), 350.0) / (2 * 3 * 14)
    rows = CATALOGUE_BYTES_A_RECORD * Settings().schedule.shots_per_set
    # Ten records of one transducer: a third of the set's strikes, and what each file has of its own.
    whole = predict_set_file_bytes(Settings())
    assert whole / 3.0 < a_set - rows < whole / 2.0
    assert predict_confirmation_bytes(Settings(), 24.0) == 0
    assert predict_confirmation_bytes(Settings(alarms={"confirmation_sets_a_day": 0}), 350.0) == 0


# Owner ----------------------------------------------------------------------------------------------


def recorder_error(folder):
    """Run a recorder that takes the folder and ends; return its error if the folder is in use."""
    try:
        with hold_recorder_lock(folder, patience_s=0.0):
            return ""
    except BusyError as error:
        return str(error)


@pytest.mark.parametrize(
    ("does", "strike", "refusal"),
    [("strike_transducer", "B", "another recorder owns"), ("run_rig_checks", None, "")],
    ids=["strikes", "looks"],
)
def test_no_recorder_starts_while_the_doctor_strikes(tmp_path, capsys, monkeypatch, does, strike, refusal):
    """While it only looks, a restarted recorder finds its folder unlocked: else its test would end."""
    folder = tmp_path / "data"
    prepare_data_folder(folder)
    assert recorder_error(folder) == "", "a recorder was here"
    seen = []

    def doing(*arguments, **driven):
        seen.append(recorder_error(folder))
        return Trial(position="B", checks=()) if strike else []

    monkeypatch.setattr(f"daq_service.cli.doctor.command.{does}", doing)
    run_doctor(config=coarse(tmp_path), data_dir=folder, strike=strike, as_json=True)
    capsys.readouterr()
    assert refusal in seen[0] if refusal else seen == [""]
    assert recorder_error(folder) == ""


def test_an_unreadable_lock_counts_as_a_running_recorder(tmp_path, monkeypatch):
    """It may be the recorder of another user, whose boards must not be used."""
    prepare_data_folder(tmp_path)
    (tmp_path / "recorder.lock").touch()

    def forbidden(path, *mode):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", forbidden)
    assert "Permission denied); look as the user that runs the recorder" in read_lock_owner(tmp_path)


def test_a_folder_without_a_recorder_is_left_unchanged(tmp_path):
    with lock_folder(tmp_path) as owner:
        assert owner == ""
    assert list(tmp_path.iterdir()) == []


# Boards, with what the driver would find ------------------------------------------------------------


@pytest.fixture
def checks_with_driver(monkeypatch):
    """Return the checks of the laboratory's boards by name; the survey finds a driver and nothing else."""

    def checks(driver_version="24.8.0", shot_interval_s=4.0):
        assert LABORATORY.daqmx is not None
        survey = Survey(LABORATORY.daqmx, driver_version=driver_version)
        monkeypatch.setattr("hardware_drivers.daqmx.look.survey_rig", lambda _: survey)
        found = yield_board_findings(LABORATORY.daqmx, shot_interval_s=shot_interval_s)
        return by_name([build_finding_check(finding) for finding in found])

    return checks


@pytest.mark.parametrize(
    ("version", "state"), [("24.8.0", "ok"), ("20.1.0", "ok"), ("20.0.0", "fail"), ("9.5", "fail")]
)
def test_the_driver_s_version_is_compared_by_numbers(checks_with_driver, version, state):
    found = checks_with_driver(version)["driver: version"]
    assert (found.state, found.found) == (state, f"NI-DAQmx {version} (at least 20.1)")


def test_a_driver_that_was_not_reached_has_no_version(checks_with_driver):
    assert "driver: version" not in checks_with_driver("")


def test_a_faulty_board_of_another_program_is_no_failure(monkeypatch):
    nameless = SimpleNamespace(name="", product_type="")
    listed = {"01C16021": nameless, "FFFFFFFF": nameless}
    monkeypatch.setattr("hardware_drivers.daqmx.survey.list_boards", lambda _: listed)
    assert LABORATORY.daqmx is not None
    survey = Survey(LABORATORY.daqmx)
    survey.list_boards(cast(Any, None), ours={"FFFFFFFF"})
    checks = by_name([build_finding_check(finding) for finding in survey.findings])
    assert checks["board 01C16021: answers"].state == "warn"
    assert checks["board FFFFFFFF: answers"].state == "fail"
    assert "faults-daqmx.md" in checks["board FFFFFFFF: answers"].remedy, "the driver named none"


def test_the_accepted_trigger_is_reported_with_units():
    assert LABORATORY.daqmx is not None
    assert format_trigger(LABORATORY.daqmx, LABORATORY.daqmx.transducers["B"]) == (
        "0.25 V rising at ai0, 1000 of 13600 samples before it, held off for 10 ms"
    )


@pytest.mark.parametrize(("interval_s", "state"), [(4.0, "ok"), (0.4, "ok"), (0.39, "warn")])
def test_a_coil_with_a_high_duty_cycle_causes_a_warning(checks_with_driver, interval_s, state):
    found = checks_with_driver(shot_interval_s=interval_s)["coils: duty cycle"]
    assert (found.state, found.values["duty"]) == (state, pytest.approx(0.1 / interval_s, rel=1e-12))


# The command on the twin ----------------------------------------------------------------------------


def coarse(folder):
    path = folder / "twin.toml"
    path.write_text("[plate]\nelements_per_edge = 16\n", encoding="utf-8")
    return path


def test_the_twin_is_struck_like_a_normal_shot(tmp_path, capsys):
    code = run_doctor(config=coarse(tmp_path), data_dir=tmp_path / "data", strike="B", as_json=True)
    out = capsys.readouterr()
    report = json.loads(out.out)
    assert (code, report["exit_code"], report["rig"]) == (0, 0, "simulated")
    features = report["strike"]["features"]
    # A coarse plate: anything between the rigid wall (317 us) and a plate softer than the paper's.
    assert 317e-6 < features["tof_pp_s"] < 360e-6
    assert features["flags"] == []
    assert "one test strike at B" in out.err


def test_without_strike_nothing_is_struck(tmp_path, capsys, monkeypatch):
    def opened(*arguments):
        pytest.fail("the rig was opened")

    monkeypatch.setattr("daq_service.cli.doctor.trial.open_rig", opened)
    assert run_doctor(config=coarse(tmp_path), data_dir=tmp_path / "d", strike=None, as_json=False) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("ok       python ")
    assert lines[-1].startswith("0 fail, ")


@pytest.mark.parametrize(("position", "message"), [("A", "B, C, D"), ("Z", "B, C, D")])
def test_only_a_transducer_can_be_struck(tmp_path, position, message):
    with pytest.raises(UsageError, match=message):
        run_doctor(config=coarse(tmp_path), data_dir=tmp_path / "data", strike=position, as_json=True)


@pytest.mark.parametrize(
    ("terminal", "line"),
    [("PFI0", "port1/line0"), ("PFI12", "port2/line4"), ("PFI15", "port2/line7"), ("Ctr0Out", "")],
)
def test_a_terminal_s_digital_name(terminal, line):
    assert find_digital_line(terminal) == line
