"""Corrupt files and segments are reported, or every value that is read equals the written one."""

import hashlib
import struct
from contextlib import closing
from dataclasses import replace

import h5py
import numpy as np
import pytest
from support.archived_sets import SET_INDEX, make_set, other_set
from support.damaging import PAGE, damaged, flip
from support.filed_archive import append_set
from support.memory_archive import bits

from daq_service.archive import FolderArchive
from daq_service.archive.finalize_set import finalize_set
from daq_service.archive.journal import frames as frame_format
from daq_service.archive.journal.checking import check_journal
from daq_service.archive.journal.reader import build_segment_path, read_journal
from daq_service.archive.layout import build_set_image
from daq_service.archive.verification import check_set_file
from hardware_drivers.measurement import SetKey

QUICK = [range(15)]
# A hundred corruptions on a busy machine.
LONG = (pytest.mark.slow, pytest.mark.timeout(1800))
SLOW = [pytest.param(range(start, start + 100), marks=LONG) for start in range(30, 1030, 100)]


@pytest.fixture(scope="module")
def image():
    return build_set_image(make_set())


@pytest.fixture
def path(tmp_path, image):
    (tmp_path / "set.h5").write_bytes(image)
    return tmp_path / "set.h5"


def test_a_file_as_it_was_written_is_clean(path, image):
    for sha256 in (None, hashlib.sha256(image).hexdigest()):
        found = check_set_file(path, sha256=sha256)
        assert (found.damages, found.touched, found.n_bytes) == ([], False, len(image))
        assert bits(found.record) == bits(make_set())
    assert check_set_file(path, sha256="ab" * 32).touched


@pytest.mark.parametrize("numbers", [*QUICK, *SLOW], ids=str)
def test_a_corrupt_file_is_reported_or_reads_unchanged(path, image, numbers):
    named = 0
    for number in numbers:
        content = damaged(image, number)
        path.write_bytes(content)
        found = check_set_file(path)
        named += bool(found.damages)
        assert found.damages or bits(found.record) == bits(make_set()), number
        if not found.damages:
            # With its SHA-256 a changed file is reported also if no value was changed.
            touched = check_set_file(path, sha256=hashlib.sha256(image).hexdigest()).touched
            assert touched == (content != image), number
    assert named > len(numbers) / 2


@pytest.mark.parametrize("length", [0, 1 << 40, (1 << 64) - 16], ids=["zeros", "far", "back"])
def test_a_string_heap_with_an_endless_loop_is_reported(path, image, length):
    at = image.index(b"GCOL")
    first, free = at + 16, struct.pack("<H6xQ", 0, length)
    path.write_bytes(image[:first] + free + image[first + len(free) :])
    (found,) = check_set_file(path).damages
    assert f"the object at byte {first} of a heap of strings has the length {length}" in found.reason


def test_an_inconsistent_file_is_reported_with_the_location(path):
    with h5py.File(path, "r+") as file:
        file["entry/B_waveforms/time"][3] = 1.0
        file["entry/B_waveforms"].attrs["signal"] = np.bytes_("waveform")
    found = check_set_file(path)
    assert "entry/B_waveforms/time does not match the rest of the file" in map(str, found.damages)


def test_a_different_compression_library_is_no_corruption(path, image):
    with h5py.File(path, "r+") as file:
        values = file["entry/B_waveforms/waveform"][()]
        file["entry/B_waveforms/waveform"][()] = values
    assert path.read_bytes() != image
    assert check_set_file(path).damages == []


# The journal ---------------------------------------------------------------------------------------


@pytest.fixture
def journal(tmp_path):
    """Return a folder with a complete and an open set."""
    with closing(FolderArchive(tmp_path)) as archive:
        append_set(archive, make_set())
        archive.store_set(make_set())
        append_set(archive, other_set(make_set(), SET_INDEX + 1))
        archive.sync()
    return tmp_path


def flip_frame(folder, sequence, *, in_header=False):
    """Flip a bit of the frame of a record; return the frame."""
    path = build_segment_path(folder, 1)
    frame = next(item for item in frame_format.parse_frames(path.read_bytes()) if item.sequence == sequence)
    flip(path, frame.start + 8 if in_header else frame.end - 1)
    return frame


def parse_line(folder):
    """Return everything that a start reads from the journal."""
    found = read_journal(folder)
    return {
        index: bits(item.record() if item.is_whole else item.opened()) if item.end or item.begin else None
        for index, item in found.items()
    }


def test_a_journal_as_it_was_written_is_clean(journal):
    found = check_journal(journal)
    assert (found.damages, sorted(found.sets)) == ([], [(SET_INDEX, 0), (SET_INDEX + 1, 0)])
    assert found.n_frames == 2 * (1 + 5) + 1


@pytest.mark.parametrize("numbers", [*QUICK, *SLOW], ids=str)
def test_a_corrupt_segment_is_reported_or_reads_unchanged(journal, numbers):
    path = build_segment_path(journal, 1)
    content, before = path.read_bytes(), parse_line(journal)
    used = len(content.rstrip(b"\0"))
    whole = [*(frame.end for frame in frame_format.parse_frames(content))]
    for number in numbers:
        broken = damaged(content, number, used=used)
        path.write_bytes(broken)
        found = check_journal(journal)
        end = min(len(broken), used)
        if not any(broken[end - end % PAGE :]):
            end -= end % PAGE
        if end < used:
            # It ends early, as after a crash: the rest is read, and no value differs.
            assert sum(frame.sound for frame in frame_format.parse_frames(broken)) == sum(
                e <= end for e in whole
            )
        else:
            assert found.damages or parse_line(journal) == before, number
        assert all(file == "journal/000001.journal" for file, _ in found.damages)


def test_a_corrupt_frame_is_reported_with_its_shot_and_the_others_are_read(journal):
    flip_frame(journal, 42)
    ((file, damage),) = check_journal(journal).damages
    assert (file, damage.sequence, damage.position) == ("journal/000001.journal", 42, "B")
    opened = 1000 + 42
    flip_frame(journal, opened)
    assert [damage.sequence for _, damage in check_journal(journal).damages] == [42, opened]


def test_a_corrupt_frame_header_is_reported_with_its_byte_range(journal):
    """In an open set no other entry names its records."""
    shot = flip_frame(journal, 1000 + 42, in_header=True)
    ((file, damage),) = check_journal(journal).damages
    assert (file, damage.sequence) == ("journal/000001.journal", None)
    assert str(damage).startswith(f"bytes {shot.start} to {shot.end} are no frame")


@pytest.mark.parametrize("cut", [1, 40, frame_format.HEADER.size, 200])
def test_an_incomplete_last_frame_is_no_corruption(journal, cut):
    """The segment is not preallocated; in a preallocated one, pages of zeros follow."""
    path = build_segment_path(journal, 1)
    content = path.read_bytes()
    last = [*frame_format.parse_frames(content)][-1]
    path.write_bytes(content[: last.start + cut])
    assert check_journal(journal).damages == []


def test_a_group_moved_to_a_new_segment_is_no_corruption(journal):
    first, second = build_segment_path(journal, 1), build_segment_path(journal, 2)
    content = first.read_bytes()
    last = [*frame_format.parse_frames(content)][-1]
    second.write_bytes(content[last.start : last.end])
    flip(first, last.end - 1)
    assert check_journal(journal).damages == []


def test_a_corrupt_frame_of_a_set_that_has_its_file_is_ignored(journal):
    finalize_set(journal, SetKey(SET_INDEX))
    flip_frame(journal, 42)
    assert check_journal(journal).damages == []


def test_records_of_format_1_0_are_verified_by_that_format(path, monkeypatch):
    older = replace(make_set(), outcomes={}, missed=[], trouble="", environment={})
    monkeypatch.setattr("daq_service.archive.layout.FORMAT_VERSION", "1.0")
    content = build_set_image(older)
    monkeypatch.undo()
    path.write_bytes(content)
    with h5py.File(path, "r+") as file:
        del file["entry/shots/outcome"]
    assert check_set_file(path).damages == []
    with h5py.File(path, "r+") as file:
        file["entry/preview/time"][2] = 9.0
    assert [str(damage) for damage in check_set_file(path).damages] == [
        "entry/preview/time does not match the rest of the file"
    ]
