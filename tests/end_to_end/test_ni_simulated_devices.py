"""A rehearsal on devices that NI's own driver simulates: nothing made up is ever called good.

What they do is NI's word (NI-DAQmx help, "Simulated Devices"): finite tasks are done at once whatever
they wait for, every input is a full-scale sine wave with three percent of noise, calibration cannot be asked.
"""

import json
from dataclasses import asdict, replace
from typing import Any

import pytest
from support.command_line import solimon_here
from support.daqmx_rig import board, parameters_of, quick_description, reach
from support.small_experiment import run
from support.stepped_clock import SteppedClock
from support.stored_files import read_set, set_files

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.rows import AlarmRow, AssessmentRow, BaselineRow, FeatureRow, SetRow, ShotRow
from daq_service.cli.doctor.command import run_doctor
from daq_service.errors import RigError
from daq_service.settings.file import load_settings
from simulator.doubles.transports.library import find_unavailability_reason

pytestmark = pytest.mark.skipif(
    bool(find_unavailability_reason()), reason=find_unavailability_reason() or "it can be built"
)

SIMULATED = replace(board(), serial_number=0, simulated=True)
DESCRIPTION = quick_description(SIMULATED, positions="BCD")
BASELINE_SETS, SETS, SHOTS = 7, 9, 1


@pytest.fixture
def doubles(doubles, monkeypatch):
    reach("library", doubles, monkeypatch)
    return doubles


def configuration(folder, doubles, **changes):
    """Write a configuration file of more sets than a baseline needs."""
    boards = asdict(replace(parameters_of(DESCRIPTION, doubles), **changes))
    values: dict[str, Any] = {
        "clock": {"kind": "wall"},
        "schedule": {
            "phases": [{"until_h": SETS * 0.0004, "interval_h": 0.0004}],
            "shots_per_set": SHOTS,
            "shot_interval_s": 0.05,
        },
        "baseline": {"minimum_valid_shots": 1, "minimum_sets": 7, "hours": BASELINE_SETS * 0.0004},
        "positions": {name: {"method": "solitary_wave"} for name in "BCD"},
        "rig": {"kind": "daqmx", "daqmx": boards, "read_timeout_s": 5.0},
    }
    file = folder / "laboratory.json"
    file.write_text(json.dumps(values), encoding="utf-8")
    return file


def looked_at(config, folder, capsys):
    """Return the exit code of doctor, and its checks of the rig by name."""
    code = run_doctor(config=config, data_dir=folder, strike=None, as_json=True)
    checks = json.loads(capsys.readouterr().out)["checks"]
    return code, {check["name"]: check for check in checks if check["area"] == "rig"}


def test_doctor_passes_a_rehearsal_and_calls_nothing_real_or_calibrated(doubles, tmp_path, capsys):
    config = configuration(tmp_path, doubles, dry_run=True)
    code, checks = looked_at(config, tmp_path / "data", capsys)
    assert {name for name, check in checks.items() if check["state"] == "fail"} == set()
    assert code == 0
    unknown = {name: check["found"] for name, check in checks.items() if check["state"] == "warn"}
    assert "made up" in unknown["board 00000000: real"]
    assert "does not report its last" in unknown["board 00000000: calibrated"]
    for position in "BCD":
        assert "made up" in unknown[f"transducer {position}: noise"]


def test_doctor_fails_for_a_configuration_with_strikes(doubles, tmp_path, capsys):
    code, checks = looked_at(configuration(tmp_path, doubles), tmp_path / "data", capsys)
    assert code == 3
    refused = checks["board 00000000: real"]
    assert refused["state"] == "fail"
    assert "dry_run = true" in refused["remedy"]


def test_a_rehearsal_produces_no_good_sets_no_assessments_and_no_baseline(doubles, tmp_path):
    settings = load_settings(configuration(tmp_path, doubles, dry_run=True))
    folder = tmp_path / "rehearsal"
    assert run(settings, folder, wall_clock=SteppedClock().start)
    with open_catalogue(folder) as catalogue:
        assert [row.state for row in catalogue.rows(SetRow)] == ["done"] * SETS * 3
        assert {row.n_valid for row in catalogue.rows(SetRow)} == {0}
        shots = catalogue.rows(ShotRow)
        assert len(shots) == SETS * 3 * SHOTS
        assert {(row.valid, *row.flags) for row in shots} == {(False, "dry_run")}
        assert {row.quality for row in catalogue.rows(FeatureRow)} == {"bad"}
        baselines = catalogue.rows(BaselineRow)
        assert [
            (row.position, row.n_sets, row.limit_f_predictive, row.limit_mean_3sd) for row in baselines
        ] == [(position, 0, None, None) for position in "BCD"]
        assert {row.outlier for row in catalogue.rows(AssessmentRow)} <= {None}
        assert catalogue.rows(AlarmRow) == [], "what is made up is no damage either"
    shot = read_set(set_files(folder)[0]).shots[0]
    assert shot.settings["calibration_date"] == ""
    # A full-scale sine wave: its rms is the range over the root of two.
    rms_v, range_v = float(shot.waveform.volts().std()), shot.waveform.calibration.range_v
    assert rms_v == pytest.approx(range_v / 2**0.5, rel=0.01)
    assert not any(event["level"] for event in doubles.control.record()["lines"])


def test_a_test_that_would_strike_is_refused_before_its_first_record(doubles, tmp_path):
    settings = load_settings(configuration(tmp_path, doubles))
    with pytest.raises(RigError, match=r"simulated by NI's driver.*dry_run = true"):
        run(settings, tmp_path / "data", wall_clock=SteppedClock().start)
    with open_catalogue(tmp_path / "data") as catalogue:
        assert catalogue.rows(SetRow) == []


def test_setup_writes_a_configuration_without_a_strike_and_refuses_to_strike(doubles, tmp_path):
    wired = ("--transducer", "B=0/ai0/ctr0", "--no-web", "--no-browser")
    file = tmp_path / "rehearsal.toml"
    done = solimon_here("setup", str(file), *wired, env={})
    assert done.returncode == 0, done.stderr
    assert load_settings(file).rig.daqmx.transducers["B"].board_serial == "00000000"
    refused = solimon_here("setup", str(tmp_path / "struck.toml"), *wired, "--strike", env={})
    assert refused.returncode == 3
    assert "simulated by NI's driver" in refused.stderr
    assert not (tmp_path / "struck.toml").exists()
