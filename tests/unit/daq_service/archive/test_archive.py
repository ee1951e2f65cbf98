"""The archive returns the stored data or names what cannot be read."""

import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import h5py
import numpy as np
import pytest
from support.archived_sets import (
    CURVED,
    LINEAR,
    SET_INDEX,
    assert_same_set,
    assert_same_waveform,
    make_echo,
    make_set,
    make_shot,
    other_set,
)
from support.filed_archive import FiledArchive
from support.stored_files import read_set, read_waveform, set_files, verify_set

from daq_service.archive import ArchiveWriteError, CorruptArchiveError, PositionRecord, compute_crc32
from daq_service.archive.layout import build_set_image
from daq_service.archive.nexus import new_image, read_image
from daq_service.errors import StorageError
from hardware_drivers.measurement import SetKey
from hardware_drivers.units import find_unit


def store(folder, record):
    """Store a set and return the path of its file."""
    return folder / FiledArchive(folder).store_set(record).file


@pytest.fixture
def stored(tmp_path):
    return store(tmp_path, make_set())


def test_the_checksum_is_that_of_the_little_endian_counts():
    # CRC-32 of the ASCII digits 1 to 9 is the algorithm's published check value; with an "x": gzip's.
    counts = np.frombuffer(b"12345678", dtype="<i2").astype(np.int16)
    shot = make_shot("B", 0, 1)
    assert compute_crc32(replace(shot.waveform, counts=counts, pretrigger_samples=0)) == 0x9AE0DAAF


def test_images_may_be_built_at_the_same_time_and_leave_no_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    expected = build_set_image(make_set())
    with new_image() as one, new_image() as other:
        assert read_image(one) == read_image(other)
        assert build_set_image(make_set()) == expected
    with ThreadPoolExecutor(4) as pool:
        assert set(pool.map(lambda _: build_set_image(make_set()), range(12))) == {expected}
    assert list(tmp_path.iterdir()) == []


def test_no_object_stores_its_time_of_writing():
    # Object headers of version 2 say by bit 5 of their flags that times follow (HDF5 format, IV.A.1.b).
    flags = [match[1][0] for match in re.finditer(rb"OHDR\x02(.)", build_set_image(make_set()), re.DOTALL)]
    assert len(flags) > 50
    assert not any(flag & 0x20 for flag in flags)


def test_sets_are_listed_in_order_without_foreign_files(tmp_path):
    archive = FiledArchive(tmp_path)
    for index in (12, 7, 1_000_001, 999_999):
        archive.store_set(other_set(make_set(), index))
    (tmp_path / "sets" / "set_7.h5").write_bytes(b"")
    (tmp_path / "sets" / "set_000008_20240101T040000Z.h5.tmp").write_bytes(b"")
    assert list(set_files(tmp_path)) == [7, 12, 999_999, 1_000_001]
    assert read_set(set_files(tmp_path)[12]).set_index == 12


def test_the_number_of_an_unscheduled_set_in_a_file_of_format_1_5_is_its_key(stored):
    with h5py.File(stored, "r+") as file:
        file.attrs["solimon_format_version"] = "1.5"
        file["entry/set_index"][...] = 10_000_000 + SET_INDEX
        del file["entry/unscheduled_index"]
    before = stored.read_bytes()
    record = read_set(stored)
    assert record.set_key == SetKey(SET_INDEX, 1)
    assert {item.key.set_key for item in (*record.records, *record.missed)} == {record.set_key}
    assert stored.read_bytes() == before


def as_format_1_0(path):
    """Remove what format 1.0 did not have."""
    with h5py.File(path, "r+") as file:
        file.attrs["solimon_format_version"] = "1.0"
        entry = file["entry"]
        for name in ("missed", "environment", "trouble", "shots/outcome", "settings"):
            del entry[name]


def test_truth_and_settings_of_a_file_of_format_1_6_are_read(stored):
    with h5py.File(stored, "r+") as file:
        file.attrs["solimon_format_version"] = "1.6"
        entry = file["entry"]
        for kind in ("truth", "settings"):  # a group for each position
            for position, rows in (("A", slice(0, 1)), ("B", slice(1, 4)), ("C", slice(4, 5))):
                group = entry.create_group(f"{position}_{kind}")
                for name, values in entry[kind].items():
                    group[name] = values[rows]
                    if "known" in values.attrs:
                        group[name].attrs["known"] = values.attrs["known"][rows]
            del entry[kind]
    assert_same_set(read_set(stored), make_set())


def test_sets_whose_texts_differ_in_length_have_one_structure():
    structures = set()
    for due_h in (4.0, 4.5):
        with h5py.File.in_memory(build_set_image(replace(make_set(), due_h=due_h))) as file:
            structures.add(file["entry/title"].dtype.str)
    assert structures == {"|S16"}


def test_a_file_of_format_1_0_is_read(stored):
    as_format_1_0(stored)
    record = make_set()
    without_settings = [replace(shot, settings={}, truth=dict(shot.truth)) for shot in record.shots]
    echo = replace(record.echoes[0], settings={}, truth=dict(record.echoes[0].truth))
    before = replace(
        record, shots=without_settings, echoes=[echo], missed=[], outcomes={}, trouble="", environment={}
    )
    assert_same_set(read_set(stored), before)
    assert verify_set(stored) == []
    # Every record counted then; the last one was the shot.
    assert_same_waveform(read_waveform(stored, "B", 1), record.shots[2].waveform)


def test_records_that_differ_in_rate_length_or_calibration_stay_together_in_one_file(tmp_path):
    record = replace(
        make_set(),
        shots=[
            make_shot("B", 0, 1),
            make_shot("B", 1, 2, rate_hz=5e6),
            make_shot("B", 2, 3, n_samples=299),
            make_shot("B", 3, 4, calibration=CURVED),
            make_shot("B", 4, 5, dtype=np.int32),
            make_shot("B", 5, 6),
            make_shot("B", 6, 7, calibration=replace(LINEAR, coefficients_v=LINEAR.coefficients_v * 2)),
            make_shot("B", 7, 8, calibration=replace(LINEAR, range_v=5.0)),
            make_shot("B", 8, 9, calibration=replace(LINEAR, resolution_bits=14)),
            make_shot("B", 9, 10, calibration=replace(LINEAR, date="2025-01-15")),
        ],
        echoes=[],
        outcomes={},
    )
    stored = store(tmp_path, record)
    assert_same_set(read_set(stored), record)
    assert_same_waveform(read_waveform(stored, "B", 3), record.shots[3].waveform)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shots": [], "echoes": []}, "has no record"),
        ({"set_index": 8}, "is of set 7"),
        ({"shots": [make_shot("E", 0, 1)]}, "position"),
        ({"shots": [make_shot("B", 0, 40)]}, "a sequence twice"),
        (
            {"positions": [PositionRecord(position="A", method="pulse_echo", n_planned=1)] * 2},
            "position twice",
        ),
    ],
)
def test_an_inconsistent_set_is_rejected(change, message):
    with pytest.raises(ValueError, match=message):
        replace(make_set(), **change)


def test_counts_changed_with_valid_hdf5_checksums_fail_their_crc(stored):
    with h5py.File(stored, "r+") as file:
        file["entry/B_waveforms/waveform"][2, 150] += 1
    (damage,) = verify_set(stored)
    assert (damage.sequence, damage.position, damage.shot_index) == (43, "B", 1)
    assert "CRC-32" in damage.reason


def test_a_corrupt_group_costs_only_its_shots(stored):
    with h5py.File(stored, "r+") as file:
        del file["entry/C_waveforms/time"]
        del file["entry/C_waveforms/shot_id"]
    rest = read_set(stored, skip_damaged=True)
    assert [item.sequence for item in rest.records] == [40, 41, 42, 43]
    assert [item.sequence for item in verify_set(stored)] == [44]


@pytest.mark.parametrize("content", [b"", b"not HDF5 at all", b"\x89HDF\r\n\x1a\n" + bytes(100)])
def test_a_file_that_is_not_hdf5_is_corrupt(tmp_path, content):
    path = tmp_path / "set.h5"
    path.write_bytes(content)
    with pytest.raises(CorruptArchiveError, match=r"set\.h5"):
        read_set(path)


@pytest.mark.parametrize("version", ["", "2.0"])
def test_a_file_of_another_format_is_refused(stored, version):
    with h5py.File(stored, "r+") as file:
        file.attrs["solimon_format_version"] = version
    with pytest.raises(CorruptArchiveError, match=f"format {version or 'unknown'}"):
        read_set(stored)


def test_a_file_at_the_path_of_the_folder_is_a_storage_error(tmp_path):
    (tmp_path / "sets").write_bytes(b"")
    with pytest.raises(ArchiveWriteError, match="sets cannot be written"):
        FiledArchive(tmp_path)


def test_archive_errors_end_with_the_storage_exit_code():
    assert issubclass(CorruptArchiveError, StorageError)
    assert ArchiveWriteError("").exit_code == 4


def test_clipped_records_are_flagged_in_the_file(tmp_path):
    shot = make_shot("B", 0, 1)
    counts = shot.waveform.counts.copy()
    counts[7] = 32767
    clipped = replace(shot, waveform=replace(shot.waveform, counts=counts), truth={})
    stored = store(
        tmp_path,
        replace(make_set(), shots=[clipped, make_shot("B", 1, 2)], echoes=[make_echo(3)], outcomes={}),
    )
    with h5py.File(stored) as file:
        flags = file["entry/shots/flags"]
        assert flags[()].tolist() == [1, 0, 0]
        assert (flags.attrs["flag_masks"], flags.attrs["flag_meanings"]) == (1, "clipped")


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("drop_height_m", "m"),
        ("tilt_rad", "rad"),
        ("psw_area_v_s", "V s"),
        ("impact_speed_m_per_s", "m/s"),
        ("sensitivity_v_per_n", "V/N"),
        ("temperature_c", "degC"),
        ("force_n", "N"),
        ("depth_fraction", ""),
        ("gain_db", "dB"),
        ("n", ""),
        ("travel_time_us", "us"),
        ("rate_per_day", ""),
    ],
)
def test_the_unit_follows_from_the_name(name, unit):
    assert find_unit(name) == unit


def test_a_set_record_keeps_its_own_copy_of_the_lists():
    shots = [make_shot("B", 0, 1)]
    record = replace(make_set(), shots=shots, outcomes={})
    shots.clear()
    assert len(record.shots) == 1
