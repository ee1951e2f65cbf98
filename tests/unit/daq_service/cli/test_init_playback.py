"""`solimon init playback`: positions, patterns and sets come from the files of the recording."""

import re
import shutil
from itertools import product

import numpy as np
import pytest
from click.testing import CliRunner
from support.labview_files import waveform_properties, write
from support.small_experiment import run, small_settings

from daq_service.cli.inspection import print_configuration
from daq_service.cli.main import cli
from daq_service.clock import parse_utc
from daq_service.errors import UsageError
from daq_service.settings.file import load_settings
from hardware_drivers.measurement import Calibration, Waveform

EPOCH_NS, INTERVAL_NS = parse_utc("2025-03-01T00:00:00Z"), 1200 * 10**9
WAVE = Waveform(
    counts=np.zeros(100, dtype=np.int16),
    sample_rate_hz=1e6,
    pretrigger_samples=10,
    calibration=Calibration(coefficients_v=np.array([0.0, 1e-3]), resolution_bits=16, range_v=5.0),
)


def record(path, set_number, names, *, samples=100, properties=None):
    """Write a TDMS file of one set whose channels have these groups and names."""
    stored = waveform_properties(WAVE, EPOCH_NS + set_number * INTERVAL_NS)
    values = np.linspace(-1.0, 1.0, samples)
    write(
        path, [(group, name, values, stored if properties is None else properties) for group, name in names]
    )


def init(folder, source, *more):
    """Run `solimon init playback`; return what it prints and the settings of its file."""
    result = CliRunner().invoke(
        cli, ["init", "playback", str(folder / "new.toml"), "--source", str(source), *more]
    )
    if result.exception is not None:
        raise result.exception
    return result.stdout.splitlines(), load_settings(folder / "new.toml")


LAYOUTS = {
    "one group for each position": (
        "March 2/Run {}.tdms",
        [(group, f"Strike {shot}") for group, shot in product(("B", "C"), "123")],
    ),
    "one channel for each shot": (
        "2025_run-{:03d}_v2.tdms",
        [("Untitled", f"{name} shot {shot}") for name, shot in product(("B", "C"), "123")],
    ),
    "a letter and a number": ("r{}.tdms", [("all", f"{name}{shot}") for name, shot in product("BC", "123")]),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_patterns_positions_and_sets_are_proposed_from_names_and_times(layout, tmp_path):
    file, names = LAYOUTS[layout]
    for number in (1, 2, 3, 4):
        record(tmp_path / "labview" / file.format(number), number, names)
    lines, settings = init(tmp_path, tmp_path / "labview")
    assert lines[0] == "positions: B (solitary_wave), C (solitary_wave)"
    assert lines[2] == "sets: 4 of 3 shots, every 0.333 h"
    mapping = settings.rig.playback.tdms
    assert (mapping.first_set, mapping.first_shot, mapping.appended) == (1, 1, False)
    (phase,) = settings.schedule.phases
    assert (phase.until_h, phase.interval_h) == pytest.approx((4 / 3, 1 / 3))
    assert parse_utc(settings.clock.epoch) == EPOCH_NS
    assert settings.schedule.shots_per_set == 3
    assert settings.name == "Playback of labview"
    print_configuration(config=tmp_path / "new.toml", data_dir=tmp_path / "data", schema=False, as_json=False)


def test_channels_of_a_board_hold_the_records_of_a_set_one_after_the_other(tmp_path):
    for number in (7, 8):
        record(tmp_path / f"{number}.tdms", number, [("Log", "Dev1/ai0"), ("Log", "Dev1/ai1")], samples=300)
    lines, settings = init(tmp_path, tmp_path / "*.tdms")
    assert lines[0] == "positions: Dev1ai0 (solitary_wave), Dev1ai1 (solitary_wave)"
    mapping = settings.rig.playback.tdms
    assert mapping.appended
    assert mapping.files == "*.tdms"
    assert dict(mapping.rename) == {"Dev1/ai0": "Dev1ai0", "Dev1/ai1": "Dev1ai1"}
    assert settings.schedule.shots_per_set == 3


def test_the_usual_names_need_no_other_patterns_and_a_is_the_probe(tmp_path):
    for number in (0, 1):
        names = [("A", "shot_0"), ("B", "shot_0"), ("B", "shot_1")]
        record(tmp_path / f"set_{number:06d}.tdms", number + 1, names)
    lines, settings = init(tmp_path, tmp_path)
    assert lines[0] == "positions: A (pulse_echo), B (solitary_wave)"
    assert settings.rig.playback.tdms.pulse_echo_positions == ("A",)
    assert settings.rig.playback.tdms.first_set == 0


def test_one_file_without_times_is_one_set_at_the_usual_interval(tmp_path):
    stored = waveform_properties(WAVE)
    record(tmp_path / "one.tdms", 0, [("B", "shot_0"), ("B", "shot_1")], properties=stored)
    lines, settings = init(tmp_path, tmp_path / "one.tdms")
    assert lines[2] == "sets: 1 of 2 shots, every 0.5 h"
    assert settings.baseline.hours == 0.25


def test_a_recording_that_needs_another_key_is_written_down_with_it(tmp_path):
    record(tmp_path / "r1.tdms", 1, [("B", "Strike 1")], properties={"wf_samples": 100})
    lines, settings = init(tmp_path, tmp_path)
    assert re.search(r"^not complete: .*r1\.tdms, group 'B', channel 'Strike 1'.*sample_rate_hz", lines[0])
    assert settings.rig.playback.tdms.channel_pattern == r"Strike (?P<shot>\d+)"


def test_a_copy_of_the_sets_alone_has_the_configuration_of_its_sets(tmp_path):
    settings = small_settings(schedule={"end_h": 0.5}, clock={"epoch": "2025-03-01T00:00:00Z"})
    assert run(settings, tmp_path / "recording")
    shutil.copytree(tmp_path / "recording" / "sets", tmp_path / "copy" / "sets")
    _, played = init(tmp_path, tmp_path / "copy")
    assert played.schedule == settings.schedule
    assert parse_utc(played.clock.epoch) == EPOCH_NS


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (
            "waves.npy",
            b"\x93NUMPY",
            "waves.npy is a .npy file; playback reads the data folder of a test, or TDMS",
        ),
        ("waves.csv", b"1,2", "waves.csv is a .csv file;"),
        (
            "cut.tdms",
            b"TDSm\x00",
            "cut.tdms is cut short, or has other bytes at its end; bring the file back",
        ),
        ("sets.txt", b"", r"has no file '**/*.tdms'; give another folder or pattern"),
    ],
)
def test_files_that_cannot_be_played_back_are_refused_with_a_remedy(tmp_path, name, content, message):
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / name).write_bytes(content)
    source = tmp_path / "old" if name == "sets.txt" else tmp_path / "old" / name
    with pytest.raises(UsageError, match=re.escape(message)):
        init(tmp_path, source)
    assert not (tmp_path / "new.toml").exists()
