"""Export of a whole test to one file: its records equal the set files, its columns the catalogue."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow
import pytest
from click.testing import CliRunner
from scipy.io import loadmat
from support.filed_archive import journal_of
from support.filled_folder import FilledFolder
from support.stored_files import read_set, set_files

from daq_service import shared_file
from daq_service.archive.layout import build_set_image
from daq_service.catalogue import open_catalogue
from daq_service.catalogue.rows import FeatureRow, SetRow, ThicknessRow
from daq_service.cli.main import cli
from daq_service.cli.maintenance.export import export_hdf5
from daq_service.errors import StorageUnavailableError, UsageError
from daq_service.settings.tree import Settings

SETS = 3


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    """Return a folder whose recorder runs; its name has characters that HDF5 could misread."""
    folder = tmp_path_factory.mktemp("data") / "50%b Ø"
    folder.mkdir()
    filled = FilledFolder(folder, Settings(), shots_per_set=2)
    for index in range(SETS):
        filled.add_set(index)
    yield folder
    filled.close()


@pytest.fixture
def folder(running, tmp_path):
    """Return a copy of the folder without a recorder."""
    return shutil.copytree(running, tmp_path / "data")


def solimon(*arguments):
    """Run the command; return the exit code and standard output or the error."""
    done = CliRunner().invoke(cli, [*map(str, arguments), "--json"])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        return done.exception.exit_code, str(done.exception)
    return done.exit_code, json.loads(done.stdout)


def records_of(folder, position):
    """Return the records of all sets with a file, in order."""
    return [
        record
        for path in set_files(folder).values()
        for record in read_set(path).records
        if record.key.position == position
    ]


def test_a_running_test_exports_every_record_with_voltages_and_times(running, tmp_path):
    result = export_hdf5(running, tmp_path / "all.h5")
    assert (result.sets, result.waiting, result.left_out) == (SETS, 0, {})
    with h5py.File(tmp_path / "all.h5") as file:
        assert result.arrays["B_waveforms"] == file["entry/B_waveforms/waveform"].shape
        assert file["entry/B_waveforms/waveform"].is_virtual
        for name, signal in (
            ("A_pulse_echo", "record"),
            ("B_waveforms", "waveform"),
            ("D_waveforms", "waveform"),
        ):
            group, records = file["entry"][name], records_of(running, name[0])
            assert len(records) >= SETS
            assert group["shot_id"][()].tolist() == [record.sequence for record in records]
            np.testing.assert_array_equal(group["time"], records[0].waveform.time_s())
            volts = (group[signal][()] + group[f"{signal}_offset"][()][:, None]) * group[
                f"{signal}_scaling_factor"
            ][()][:, None]
            for row, record in enumerate(records):
                np.testing.assert_array_equal(group[signal][row], record.waveform.counts)
                # A few roundings of numbers up to 10 V; the calibration is linear.
                np.testing.assert_allclose(volts[row], record.waveform.volts(), rtol=0, atol=80 * 2.0**-53)
                assert group["utc_ns"][row] == record.stamp.utc_ns
                assert (group["set_index"][row], group["shot_index"][row]) == (
                    record.key.set_index,
                    record.key.shot_index,
                )


def test_columns_are_the_catalogue_s_with_their_units(running, tmp_path):
    export_hdf5(running, tmp_path / "all.h5")
    with open_catalogue(running) as catalogue, h5py.File(tmp_path / "all.h5") as file:
        entry = file["entry"]
        shots = catalogue.rows(FeatureRow, position="C", scope="shot")
        of_sets = catalogue.rows(FeatureRow, position="C", scope="set")
        walls = catalogue.rows(ThicknessRow, position="A")
        sets = catalogue.rows(SetRow, position="C")
        assert entry["C_waveforms/tof_pp_s"][()].tolist() == [row.tof_pp_s for row in shots]
        assert entry["C_waveforms/due_h"][()].tolist() == [row.due_h for row in shots]
        assert np.isnan(entry["C_waveforms/ssw_time_s"]).all(), "the catalogue has none"
        assert entry["C_sets/amplitude_ratio"][()].tolist() == [row.amplitude_ratio for row in of_sets]
        assert entry["C_sets/set_index"][()].tolist() == [row.set_index for row in sets]
        assert entry["C_sets/state"].asstr()[()].tolist() == ["done"] * SETS
        assert entry["A_sets/thickness_m"][()].tolist() == [row.thickness_m for row in walls]
        assert entry["A_pulse_echo/thickness_m"].attrs["units"] == "m"
        units = {
            name: entry["C_waveforms"][name].attrs["units"] for name in ("waveform", "tof_pp_s", "due_h")
        }
        assert units == {"waveform": "counts", "tof_pp_s": "s", "due_h": "h"}
        configuration = json.loads(entry["provenance/data"].asstr()[0])["configuration"]
        assert configuration == catalogue.read_experiment().configuration


def test_records_of_another_length_have_a_separate_array(folder, tmp_path):
    path = set_files(folder)[1]
    record = read_set(path)
    shorter = [
        replace(shot, waveform=replace(shot.waveform, counts=shot.waveform.counts[:-100]))
        if shot.key.position == "B"
        else shot
        for shot in record.shots
    ]
    path.write_bytes(build_set_image(replace(record, shots=shorter)))
    result = export_hdf5(folder, tmp_path / "all.h5")
    n_samples = shorter[0].waveform.counts.size
    assert result.arrays["B_waveforms"] == (4, n_samples + 100)
    assert result.arrays["B_waveforms_2"] == (2, n_samples)
    assert result.arrays["C_waveforms"] == (6, n_samples + 100)
    with h5py.File(tmp_path / "all.h5") as file:
        assert file["entry/B_waveforms/set_index"][()].tolist() == [0, 0, 2, 2]
        assert file["entry/B_waveforms_2/set_index"][()].tolist() == [1, 1]
        np.testing.assert_array_equal(
            file["entry/B_waveforms_2/waveform"][1],
            [shot for shot in shorter if shot.key.position == "B"][1].waveform.counts,
        )


def test_missing_and_corrupt_files_are_left_out_and_listed(folder, tmp_path):
    files = set_files(folder)
    files[0].unlink()
    files[2].write_bytes(files[2].read_bytes()[:3000])
    code, answer = solimon("export", "--data-dir", folder, "--hdf5", tmp_path / "all.h5")
    assert (code, answer["sets"], answer["waiting"], answer["ok"]) == (4, 1, 0, False)
    assert sorted(answer["left_out"]) == sorted(f"sets/{files[index].name}" for index in (0, 2))
    with h5py.File(tmp_path / "all.h5") as file:
        assert set(file["entry/B_waveforms/set_index"][()]) == {1}
        assert file["entry/B_sets/set_index"][()].tolist() == [0, 1, 2], "its rows are there all the same"


def test_a_set_in_the_journal_is_no_corruption(folder, tmp_path):
    path = set_files(folder)[2]
    record = read_set(path)
    path.unlink()
    with journal_of(folder, record):
        code, answer = solimon("export", "--data-dir", folder, "--hdf5", tmp_path / "all.h5")
    assert (code, answer["sets"], answer["waiting"], answer["left_out"]) == (0, 2, 1, {})


def test_file_and_folder_may_move_together_and_a_set_that_is_gone_is_seen(folder, tmp_path):
    export_hdf5(folder, tmp_path / "all.h5")
    expected = records_of(folder, "B")[0].waveform.counts
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for name in ("data", "all.h5"):
        (tmp_path / name).rename(elsewhere / name)
    with h5py.File(elsewhere / "all.h5") as file:
        np.testing.assert_array_equal(file["entry/B_waveforms/waveform"][0], expected)
    set_files(elsewhere / "data")[0].unlink()
    with h5py.File(elsewhere / "all.h5") as file:
        records = file["entry/B_waveforms/waveform"]
        assert set(records[0]) == {np.iinfo(records.dtype).min}
        assert np.ptp(records[2]) > 0


@pytest.mark.parametrize(
    "target_kind", ["nowhere", "empty", "sets/all.h5", "catalogue.sqlite", "no/such/all.h5"]
)
def test_an_invalid_export_is_rejected_with_code_2(folder, tmp_path, target_kind):
    (tmp_path / "empty").mkdir()
    source, target = folder, folder / target_kind
    if target_kind in ("nowhere", "empty"):
        source, target = tmp_path / target_kind, tmp_path / "all.h5"
    before = sorted(path.name for path in tmp_path.rglob("*"))
    code, answer = solimon("export", "--data-dir", source, "--hdf5", target, "--overwrite")
    assert code == 2, answer
    assert sorted(path.name for path in tmp_path.rglob("*")) == before


def test_a_file_is_replaced_only_with_overwrite_and_only_completely(folder, tmp_path, monkeypatch):
    target = tmp_path / "all.h5"
    target.write_bytes(b"kept")
    with pytest.raises(UsageError, match="--overwrite"):
        export_hdf5(folder, target)

    def refuse(*names):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(shared_file.os, "fsync", refuse)
        with pytest.raises(StorageUnavailableError, match="No space left"):
            export_hdf5(folder, target, overwrite=True)
    assert target.read_bytes() == b"kept"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["all.h5", "data"]
    export_hdf5(folder, target, overwrite=True)
    assert h5py.is_hdf5(target)


def test_progress_counts_the_sets(running, tmp_path):
    calls = []
    export_hdf5(running, tmp_path / "all.h5", progress=lambda done, planned: calls.append((done, planned)))
    assert calls == [(done, SETS) for done in range(SETS + 1)]


def test_a_table_is_written_in_each_format_of_its_names(running, tmp_path):
    asked = ("--table", "features", "--position", "B", "--from-h", 0.6, "--fields", "tof_pp_s")
    endings = ("csv", "parquet", "arrow", "npz", "mat", "h5")
    outputs = [word for ending in endings for word in ("--out", tmp_path / f"b.{ending}")]
    code, answer = solimon("export", "--data-dir", running, *asked, *outputs)
    assert (code, answer["ok"]) == (0, True)
    assert [(file["table"], Path(file["file"]).suffix[1:]) for file in answer["files"]] == [
        ("features", ending) for ending in endings
    ]
    with open_catalogue(running) as catalogue:
        expected = catalogue.columns(FeatureRow, ["tof_pp_s"], position="B", scope="set", first_h=0.6)
    read = {
        "csv": pd.read_csv(tmp_path / "b.csv")["tof_pp_s"],
        "parquet": pd.read_parquet(tmp_path / "b.parquet")["tof_pp_s"],
        "arrow": pyarrow.ipc.open_stream(tmp_path / "b.arrow").read_all()["tof_pp_s"].to_numpy(),
        "npz": np.load(tmp_path / "b.npz")["tof_pp_s"],
        "mat": loadmat(tmp_path / "b.mat", squeeze_me=True)["features"]["tof_pp_s"].item(),
    }
    with h5py.File(tmp_path / "b.h5") as file:
        read["h5"] = file["entry/features/tof_pp_s"][()]
    for ending, values in read.items():
        np.testing.assert_array_equal(values, expected["tof_pp_s"], err_msg=ending)
    assert len(expected["tof_pp_s"]) == SETS - 1
    assert sorted(tmp_path.iterdir()) == sorted(tmp_path / f"b.{ending}" for ending in endings)


def test_records_of_a_range_are_written_in_the_formats_of_their_names(running, tmp_path):
    outputs = [word for ending in ("npz", "h5") for word in ("--out", tmp_path / f"b.{ending}")]
    asked = ("--waveforms", "B", "--first-set", 0, "--last-set", 1)
    code, answer = solimon("export", "--data-dir", running, *asked, *outputs)
    assert (code, answer["ok"]) == (0, True)
    assert [file["table"] for file in answer["files"]] == ["waveforms"] * 2
    stored = [read_set(path) for path in list(set_files(running).values())[:2]]
    expected = [shot.waveform.volts() for taken in stored for shot in taken.shots if shot.key.position == "B"]
    np.testing.assert_array_equal(np.load(tmp_path / "b.npz")["voltage_v"], expected)
    with h5py.File(tmp_path / "b.h5") as file:
        np.testing.assert_array_equal(file["entry/waveforms/voltage_v"][()], expected)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "give --hdf5 FILE, --ro-crate FOLDER, --table NAME with --out FILE"),
        (("--ro-crate", "a", "--out", "a.csv"), "--out does not belong to --ro-crate"),
        (("--hdf5", "a.h5", "--license", "CC0-1.0"), "--license does not belong to --hdf5"),
        (("--table", "sets"), "needs --out"),
        (("--table", "sets", "--out", "a.xlsx"), "choose from csv, parquet"),
        (("--table", "shots", "--out", "a.csv"), "choose from sets, features"),
        (("--table", "sets", "--position", "X", "--out", "a.csv"), "choose from A, B, C, D"),
        (("--table", "sets", "--from-h", 2, "--to-h", 1, "--out", "a.csv"), "let it end later"),
        (("--hdf5", "a.h5", "--position", "B"), "--position does not belong to --hdf5"),
        (("--hdf5", "a.h5", "--out", "a.csv"), "--out does not belong to --hdf5"),
        (("--table", "sets", "--last-set", 1, "--out", "a.csv"), "--last-set does not belong to --table"),
        (("--table", "sets", "--waveforms", "B", "--out", "a.csv"), "or --waveforms POSITION with --out"),
        (("--waveforms", "B"), "--waveforms needs --out"),
        (("--waveforms", "B", "--fields", "x", "--out", "a.h5"), "--fields does not belong to --waveforms"),
        (("--waveforms", "X", "--out", "a.h5"), "choose from A, B, C, D"),
        (("--waveforms", "B", "--from-h", 900, "--out", "a.h5"), "no record of position B"),
    ],
)
def test_an_impossible_export_is_rejected_before_any_file_is_written(
    arguments, message, running, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    code, answer = solimon("export", "--data-dir", running, *arguments)
    assert code == UsageError.exit_code
    assert message in answer
    assert list(tmp_path.iterdir()) == []


def test_a_table_is_complete_or_absent(running, tmp_path, monkeypatch):
    target = tmp_path / "a.csv"
    target.write_text("older")
    assert solimon("export", "--data-dir", running, "--table", "sets", "--out", target)[0] == 2
    assert target.read_text() == "older"

    def full(descriptor, buffers):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(shared_file, "write_all", full)
    code, answer = solimon("export", "--data-dir", running, "--table", "sets", "--out", target, "--overwrite")
    assert (code, target.read_text()) == (4, "older")
    assert "free or repair the disk" in answer
    assert list(tmp_path.iterdir()) == [target]
