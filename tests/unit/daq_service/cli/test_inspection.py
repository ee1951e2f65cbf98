"""Output of `check-config` for a planned test, and what it refuses."""

import json
from types import SimpleNamespace

import pytest
from support.small_experiment import run, small_settings

from daq_service.cli.doctor.command import run_checks
from daq_service.cli.inspection import print_configuration
from daq_service.errors import UsageError
from daq_service.processes import disk_policy
from daq_service.settings.file import load_settings

NEEDS = "at least 15 are needed, 200 or more are advised"
PLAYBACK = '[rig]\nkind = "playback"\n[rig.playback]\nsource = '


def check(folder, text, *, as_json=False):
    """Run `check-config` on a file with this text."""
    (folder / "test.toml").write_text(text, encoding="utf-8")
    print_configuration(config=folder / "test.toml", data_dir=folder / "data", schema=False, as_json=as_json)


def refusal(folder, text):
    """Return the lines of the refusal of a file with this text."""
    with pytest.raises(UsageError) as refused:
        check(folder, text)
    assert refused.value.exit_code == 2
    first, *lines = str(refused.value).splitlines()
    assert first == "this test cannot run:"
    assert not (folder / "data").exists(), "nothing is made for it"
    return lines


@pytest.mark.parametrize(
    ("text", "n_sets", "warning"),
    [
        ("", 48, ""),
        ("[baseline]\nhours = 7.5", 15, ""),
        ("[baseline]\nhours = 5.0", 10, "baseline.hours = 5 takes 10 "),
        ("[schedule]\nend_h = 24.5", 48, ""),
        ("[baseline]\nminimum_sets = 7\nhours = 7.0", 14, "baseline.hours = 7 takes 14 "),
    ],
)
def test_a_baseline_without_possible_limits_causes_a_warning(tmp_path, capsys, text, n_sets, warning):
    check(tmp_path, text)
    printed = capsys.readouterr()
    assert f"baseline   {n_sets} sets of each transducer; {NEEDS}\n" in printed.out
    complete = f"WARNING: no set would be assessed: {warning}sets of each transducer; {NEEDS}\n"
    assert printed.err == (complete if warning else "")


@pytest.mark.parametrize(
    ("text", "warnings"),
    [
        ("[chain]\nradius_m = 0.02\nmass_kg = 0.261\nspheres_below = 4", [" 1.14, above 0.7"]),
        ("[chain]\nspheres_below = 1", ["1.6 of its widths, below 2.5: they overlap"]),
        ("[chain]\nspheres_below = 24", ["lasts 1260 us after its trigger", "below 1407 us: record longer"]),
        ("[plate]\nthickness_m = 2e-3", ["inelasticity is 2.60", "ratio is 0.00, below 0.2"]),
        ("[positions.B]\nmethod = 'solitary_wave'\nwaves = {isw_fwhm_s = 3e-4}", ["below 2362 us"]),
    ],
)
def test_a_transducer_whose_waves_cannot_be_assessed_causes_a_warning(tmp_path, capsys, text, warnings):
    check(tmp_path, text)
    printed = capsys.readouterr().err
    assert "WARNING: position B: " in printed
    assert [words for words in warnings if words not in printed] == []


BASELINE = "Shorten the baseline, or end the test later."
LATER = "no set is due up to hour {}; the first interval is {} h. Shorten interval_h, or end the test later."


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            "[schedule]\nend_h = 24.0",
            "  baseline.hours = 24 takes 48 sets, and the schedule has 48: no set would be assessed. "
            + BASELINE,
        ),
        ("[schedule]\nend_h = 0.25", "  schedule: " + LATER.format("0.25", "0.5")),
        (
            "[schedule]\nphases = [{until_h = 1.0, interval_h = 2.0}]",
            "  schedule: " + LATER.format("1", "2"),
        ),
    ],
)
def test_a_schedule_without_an_assessed_set_is_refused(tmp_path, text, line):
    assert refusal(tmp_path, text) == [line]


def test_everything_that_prevents_a_test_is_listed_at_once(tmp_path, capsys):
    reachable = "[web]\nhost_names = ['lab.example']\nproxy = '127.0.0.1'\n"
    text = f"[schedule]\nend_h = 8.0\n{reachable}{PLAYBACK}'nowhere'"
    baseline, recording, web = refusal(tmp_path, text)
    assert baseline.startswith("  baseline.hours = 24 takes 48 sets, and the schedule has 16")
    assert "nowhere holds no sets" in recording
    assert "no valid access token" in web
    assert "sets       16, the last one due at hour 8\n" in capsys.readouterr().out
    with pytest.raises(UsageError):
        check(tmp_path, text, as_json=True)
    assert json.loads(capsys.readouterr().out)["sets"] == 16


def test_a_disk_that_is_too_small_is_refused_before_the_first_set_only(tmp_path, monkeypatch):
    usage = SimpleNamespace(free=300_000_000, total=4_000_000_000)
    monkeypatch.setattr(disk_policy.shutil, "disk_usage", lambda folder: usage)
    (line,) = refusal(tmp_path, "")
    assert line.startswith("  storage: the test needs 0.")
    assert line.endswith(
        f"GB, and {tmp_path / 'data'} has 0.1 GB until recording stops (storage.stop_free_fraction). "
        "Free disk space, or choose another --data-dir."
    )
    settings = small_settings(schedule={"end_h": 0.5})
    assert run(settings, tmp_path / "data")
    (tmp_path / "test.json").write_text(settings.model_dump_json(), encoding="utf-8")
    usage.free = 1_000
    with pytest.raises(UsageError) as refused:
        print_configuration(
            config=tmp_path / "test.json", data_dir=tmp_path / "data", schema=False, as_json=False
        )
    assert "storage" not in str(refused.value)


def test_the_folder_of_another_test_is_refused(tmp_path):
    assert run(small_settings(schedule={"end_h": 0.5}), tmp_path / "data")
    with pytest.raises(UsageError, match=r"data belongs to the test "):
        check(tmp_path, "")


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("'nowhere'", "nowhere holds no sets; give the data folder of a test"),
        ("'nowhere'\nformat = 'tdms'", "there is no TDMS file or folder "),
        ("'recording'", "the recording does not fit the configuration: "),
    ],
)
def test_a_recording_that_cannot_be_played_back_is_refused(tmp_path, source, message):
    if source == "'recording'":
        settings = small_settings(schedule={"end_h": 0.5})
        kept = {name: settings.positions[name] for name in ("A", "B")}
        assert run(settings.model_copy(update={"positions": kept}), tmp_path / "recording")
    (line,) = refusal(tmp_path, PLAYBACK + source)
    assert message in line


@pytest.mark.parametrize(("due_on", "is_overdue"), [("2020-01-31", True), ("2999-01-31", False)])
def test_an_overdue_calibration_causes_a_warning(tmp_path, capsys, due_on, is_overdue):
    path, positions = tmp_path / "test.toml", '[positions.B]\nmethod = "solitary_wave"\n'
    path.write_text(f"{positions}[positions.B.calibration]\ndue_on = {due_on}", encoding="utf-8")
    print_configuration(config=path, data_dir=tmp_path / "data", schema=False, as_json=False)
    warning = f"WARNING: positions.B.calibration.due_on = {due_on} is over; calibrate the sensor"
    assert (warning in capsys.readouterr().err) is is_overdue
    checks = run_checks(load_settings(path), tmp_path / "data", "", lambda step: None)
    states = [check.state for check in checks if check.name == "sensors: calibration"]
    assert states == ["warn" if is_overdue else "ok"]
