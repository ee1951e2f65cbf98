"""The archive gives back what it was given, and says what it cannot."""

import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import h5py
import numpy as np
import pytest
from support.archived_sets import (
    CURVED,
    DUE_UTC_NS,
    LINEAR,
    SET_INDEX,
    assert_same_records,
    assert_same_set,
    assert_same_waveform,
    make_echo,
    make_set,
    make_shot,
    other_set,
)

from daq_service.archive import (
    Archive,
    ArchiveWriteError,
    ConflictingSetError,
    CorruptArchiveError,
    PositionRecord,
    SetNotFoundError,
    SetRecord,
    read_set,
    read_waveform,
    set_file_name,
    set_files,
    verify_set,
    waveform_crc32,
)
from daq_service.archive.layout import build_image
from daq_service.archive.nexus import image_file, image_of
from daq_service.archive.units import unit_of
from daq_service.errors import StorageError


@pytest.fixture
def stored(tmp_path):
    return Archive(tmp_path).store_set(make_set())


def test_a_set_comes_back_bit_for_bit(stored):
    assert_same_set(read_set(stored.path), make_set())


def test_a_sound_file_has_no_damage(stored):
    assert verify_set(stored.path) == []


def test_the_acknowledgement_names_file_size_and_checksums(tmp_path, stored):
    assert stored.file == "sets/set_000007_20240101T040000Z.h5"
    assert stored.path == tmp_path / stored.file
    assert stored.n_bytes == stored.path.stat().st_size
    assert stored.crc32 == {item.sequence: waveform_crc32(item.waveform) for item in make_set().records}


def test_the_parts_of_the_time_add_up(stored):
    timings = stored.timings
    assert timings.total_s == timings.image_s + timings.write_s + timings.fsync_s + timings.directory_fsync_s
    assert min(timings.image_s, timings.write_s, timings.fsync_s, timings.directory_fsync_s) > 0.0


def test_the_checksum_is_that_of_the_little_endian_counts():
    # CRC-32 of the ASCII digits 1 to 9 is the algorithm's published check value; with an "x": gzip's.
    counts = np.frombuffer(b"12345678", dtype="<i2").astype(np.int16)
    shot = make_shot("B", 0, 1)
    assert waveform_crc32(replace(shot.waveform, counts=counts, pretrigger_samples=0)) == 0x9AE0DAAF


def test_the_same_set_gives_the_same_bytes():
    assert build_image(make_set()) == build_image(make_set())


def test_images_may_be_built_at_the_same_time_and_leave_no_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    expected = build_image(make_set())
    with image_file() as one, image_file() as other:
        assert image_of(one) == image_of(other)
        assert build_image(make_set()) == expected
    with ThreadPoolExecutor(4) as pool:
        assert set(pool.map(lambda _: build_image(make_set()), range(12))) == {expected}
    assert list(tmp_path.iterdir()) == []


def test_no_object_remembers_when_it_was_written():
    # Object headers of version 2 say by bit 5 of their flags that times follow (HDF5 format, IV.A.1.b).
    flags = [match[1][0] for match in re.finditer(rb"OHDR\x02(.)", build_image(make_set()), re.DOTALL)]
    assert len(flags) > 50
    assert not any(flag & 0x20 for flag in flags)


def test_storing_the_same_set_again_changes_nothing(tmp_path, stored):
    before = stored.path.read_bytes()
    again = Archive(tmp_path).store_set(make_set())
    assert again.path == stored.path
    assert stored.path.read_bytes() == before


def test_a_different_set_never_replaces_a_stored_one(tmp_path, stored):
    before = stored.path.read_bytes()
    with pytest.raises(ConflictingSetError, match="set 7 is stored already"):
        Archive(tmp_path).store_set(replace(make_set(), due_h=4.5))
    assert stored.path.read_bytes() == before
    assert [path.name for path in stored.path.parent.iterdir()] == [stored.path.name]


def test_a_set_cannot_be_stored_under_a_second_due_time(tmp_path):
    archive = Archive(tmp_path)
    archive.store_set(make_set())
    with pytest.raises(ConflictingSetError, match="set 7"):
        archive.store_set(replace(make_set(), due_utc_ns=DUE_UTC_NS + 3_600_000_000_000))
    assert list(set_files(tmp_path)) == [SET_INDEX]


def test_opening_removes_what_a_crash_left(tmp_path):
    folder = tmp_path / "sets"
    folder.mkdir()
    (folder / "set_000007_20240101T040000Z.tmp").write_bytes(b"half a set")
    Archive(tmp_path)
    assert list(folder.iterdir()) == []


def test_sets_are_listed_in_their_order_and_strangers_left_out(tmp_path):
    archive = Archive(tmp_path)
    for index in (12, 7, 1_000_001, 999_999):
        archive.store_set(other_set(make_set(), index))
    (tmp_path / "sets" / "set_7.h5").write_bytes(b"")
    (tmp_path / "sets" / "set_000008_20240101T040000Z.h5.tmp").write_bytes(b"")
    assert list(set_files(tmp_path)) == [7, 12, 999_999, 1_000_001]
    assert read_set(set_files(tmp_path)[12]).set_index == 12


def test_a_folder_without_sets_lists_none(tmp_path):
    assert set_files(tmp_path) == {}


def test_the_name_says_when_the_set_was_due():
    assert set_file_name(123, 1_704_288_600_000_000_000) == "set_000123_20240103T133000Z.h5"


def test_one_record_can_be_read_alone(stored):
    shots = {item.sequence: item for item in make_set().records}
    assert_same_waveform(read_waveform(stored.path, "B", 0), shots[41].waveform)
    assert_same_waveform(read_waveform(stored.path, "C", 0), shots[44].waveform)
    assert_same_waveform(read_waveform(stored.path, "A", 0), shots[40].waveform)


@pytest.mark.parametrize(("superseded", "accepted"), [(42, 43), (43, 42)])
def test_of_several_attempts_the_accepted_one_is_the_shot(tmp_path, superseded, accepted):
    record = replace(make_set(), outcomes={superseded: "superseded"})
    stored = Archive(tmp_path).store_set(record)
    shots = {item.sequence: item for item in record.shots}
    assert_same_waveform(read_waveform(stored.path, "B", 1), shots[accepted].waveform)


def as_format_1_0(path):
    """Take out what format 1.0 did not have."""
    with h5py.File(path, "r+") as file:
        file.attrs["solimon_format_version"] = "1.0"
        entry = file["entry"]
        for name in ("missed", "environment", "trouble", "shots/outcome", "A_settings", "B_settings"):
            del entry[name]


def test_a_file_of_format_1_0_is_read(stored):
    as_format_1_0(stored.path)
    record = make_set()
    without_settings = [replace(shot, settings={}, truth=dict(shot.truth)) for shot in record.shots]
    echo = replace(record.echoes[0], settings={}, truth=dict(record.echoes[0].truth))
    before = replace(
        record,
        shots=without_settings,
        echoes=[echo],
        missed=[],
        outcomes={},
        trouble="",
        environment={},
    )
    assert_same_set(read_set(stored.path), before)
    assert verify_set(stored.path) == []
    # Every record counted then; the last one was the shot.
    assert_same_waveform(read_waveform(stored.path, "B", 1), record.shots[2].waveform)


@pytest.mark.parametrize(("position", "shot_index"), [("B", 2), ("D", 0), ("X", 0)])
def test_a_record_that_was_never_taken_is_not_found(stored, position, shot_index):
    with pytest.raises(SetNotFoundError, match=f"no shot {shot_index} of position '{position}'"):
        read_waveform(stored.path, position, shot_index)


def test_a_missing_file_is_not_found(tmp_path):
    with pytest.raises(SetNotFoundError, match=r"there is no file .*set\.h5"):
        read_set(tmp_path / "set.h5")


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
    stored = Archive(tmp_path).store_set(record)
    assert_same_set(read_set(stored.path), record)
    assert_same_waveform(read_waveform(stored.path, "B", 3), record.shots[3].waveform)


def test_a_set_of_pulse_echo_alone_is_a_set(tmp_path):
    record = replace(make_set(), shots=[], outcomes={})
    assert_same_set(read_set(Archive(tmp_path).store_set(record).path), record)


def test_a_truth_that_is_not_a_number_is_not_a_missing_truth(tmp_path):
    shots = [make_shot("B", 0, 1, truth={"depth_m": float("nan")}), make_shot("B", 1, 2)]
    stored = Archive(tmp_path).store_set(replace(make_set(), shots=shots))
    first, second = read_set(stored.path).shots
    assert np.isnan(first.truth["depth_m"])
    assert dict(second.truth) == {}


def test_provenance_that_json_cannot_hold_is_refused(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        Archive(tmp_path).store_set(replace(make_set(), provenance={"limit": float("inf")}))


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
def test_a_set_that_contradicts_itself_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(make_set(), **change)


def flip(path, offset):
    content = bytearray(path.read_bytes())
    content[offset] ^= 0x10
    path.write_bytes(content)


def chunk_offset(path, name, row):
    with h5py.File(path) as file:
        return file[name].id.get_chunk_info(row).byte_offset


def test_damage_costs_one_shot_and_names_it(stored):
    flip(stored.path, chunk_offset(stored.path, "entry/B_waveforms/waveform", 1) + 40)
    with pytest.raises(CorruptArchiveError, match=r"shot 1 of B \(sequence 42\)"):
        read_set(stored.path)
    rest = read_set(stored.path, skip_damaged=True)
    whole = make_set()
    assert_same_records(rest, replace(whole, shots=[shot for shot in whole.shots if shot.sequence != 42]))
    damages = verify_set(stored.path)
    assert [(item.position, item.shot_index, item.sequence) for item in damages] == [("B", 1, 42)]


def test_a_damaged_record_cannot_be_read_alone_but_its_neighbours_can(stored):
    flip(stored.path, chunk_offset(stored.path, "entry/B_waveforms/waveform", 0) + 40)
    with pytest.raises(CorruptArchiveError, match=r"shot 0 of B \(sequence 41\)"):
        read_waveform(stored.path, "B", 0)
    assert_same_waveform(read_waveform(stored.path, "B", 1), make_set().shots[2].waveform)


def test_counts_that_were_changed_with_valid_hdf5_checksums_are_found_by_their_crc(stored):
    with h5py.File(stored.path, "r+") as file:
        file["entry/B_waveforms/waveform"][2, 150] += 1
    (damage,) = verify_set(stored.path)
    assert (damage.sequence, damage.position, damage.shot_index) == (43, "B", 1)
    assert "CRC-32" in damage.reason


def test_damage_outside_the_shots_is_found(stored):
    with h5py.File(stored.path) as file:
        offset = file["entry/provenance/data"].id.get_chunk_info(0).byte_offset
    flip(stored.path, offset + 20)
    (damage,) = verify_set(stored.path)
    assert damage.position is None
    assert "provenance/data" in str(damage)


def test_a_damaged_group_costs_its_own_shots_only(stored):
    with h5py.File(stored.path, "r+") as file:
        del file["entry/C_waveforms/time"]
        del file["entry/C_waveforms/shot_id"]
    rest = read_set(stored.path, skip_damaged=True)
    assert [item.sequence for item in rest.records] == [40, 41, 42, 43]
    assert [item.sequence for item in verify_set(stored.path)] == [44]


def test_no_flipped_bit_anywhere_is_taken_for_data(tmp_path, stored):
    """Either an error names the damage, or all that can be read is what was stored."""
    whole = stored.path.read_bytes()
    intact = everything(stored.path)
    path = tmp_path / "flipped.h5"
    found = 0
    # A bit of every 1000 bytes on average: headers, indexes, chunks and gaps are all met.
    for offset in np.random.default_rng(3).integers(0, len(whole), len(whole) // 1000):
        path.write_bytes(whole)
        flip(path, int(offset))
        try:
            if verify_set(path):
                found += 1
                continue
        except CorruptArchiveError:
            found += 1
            continue
        assert everything(path) == intact, f"offset {offset}"
    assert found > 10


def everything(path):
    """Every dataset and attribute of a file as bytes."""
    found = {}

    def visit(name, item):
        found[name] = {key: np.asarray(value).tobytes() for key, value in item.attrs.items()}
        if isinstance(item, h5py.Dataset):
            found[name]["/"] = item[()].tobytes() if item.shape else np.asarray(item[()]).tobytes()

    with h5py.File(path) as file:
        file.visititems(visit)
    return found


@pytest.mark.parametrize("content", [b"", b"not HDF5 at all", b"\x89HDF\r\n\x1a\n" + bytes(100)])
def test_what_is_no_hdf5_file_is_damaged(tmp_path, content):
    path = tmp_path / "set.h5"
    path.write_bytes(content)
    with pytest.raises(CorruptArchiveError, match=r"set\.h5"):
        read_set(path)


def test_a_truncated_file_is_damaged(stored):
    stored.path.write_bytes(stored.path.read_bytes()[:-100])
    with pytest.raises(CorruptArchiveError, match="damaged"):
        read_set(stored.path)


@pytest.mark.parametrize("version", ["", "2.0"])
def test_a_file_of_another_format_is_refused(stored, version):
    with h5py.File(stored.path, "r+") as file:
        file.attrs["solimon_format_version"] = version
    with pytest.raises(CorruptArchiveError, match=f"format {version or 'unknown'}"):
        read_set(stored.path)


def test_a_file_in_the_way_of_the_folder_is_a_storage_error(tmp_path):
    (tmp_path / "sets").write_bytes(b"")
    with pytest.raises(ArchiveWriteError, match="sets cannot be written"):
        Archive(tmp_path)


def test_archive_errors_end_with_the_storage_exit_code():
    assert issubclass(CorruptArchiveError, StorageError)
    assert ArchiveWriteError("").exit_code == 4


def test_clipped_records_are_flagged_in_the_file(tmp_path):
    shot = make_shot("B", 0, 1)
    counts = shot.waveform.counts.copy()
    counts[7] = 32767
    clipped = replace(shot, waveform=replace(shot.waveform, counts=counts), truth={})
    stored = Archive(tmp_path).store_set(
        replace(make_set(), shots=[clipped, make_shot("B", 1, 2)], echoes=[make_echo(3)], outcomes={})
    )
    with h5py.File(stored.path) as file:
        flags = file["entry/shots/flags"]
        assert flags[()].tolist() == [1, 0, 0]
        assert (flags.attrs["flag_masks"], flags.attrs["flag_meanings"]) == (1, b"clipped")


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
    assert unit_of(name) == unit


def test_a_set_record_keeps_its_own_copy_of_the_lists():
    shots = [make_shot("B", 0, 1)]
    record = SetRecord(
        set_index=SET_INDEX,
        due_utc_ns=DUE_UTC_NS,
        due_h=1.0,
        started_utc_ns=DUE_UTC_NS,
        ended_utc_ns=DUE_UTC_NS,
        rig_kind="simulated",
        positions=[PositionRecord(position="B", method="solitary_wave", n_planned=1)],
        shots=shots,
    )
    shots.clear()
    assert len(record.shots) == 1
