"""Journal segments on a failing disk: only synced data are acknowledged, and no data are lost."""

import errno
import os
import re
from contextlib import closing
from dataclasses import replace

import h5py
import pytest
from support.archived_sets import DUE_UTC_NS, SET_INDEX, counts_of, make_set, other_set
from support.damaging import flip
from support.filed_archive import append_set
from support.memory_archive import bits
from support.refused_calls import refuse

from daq_service.archive import (
    ArchiveWriteError,
    CorruptArchiveError,
    FolderArchive,
    SetNotFoundError,
    reader,
)
from daq_service.archive.errors import ArchiveReadError
from daq_service.archive.finalize_set import finalize_set
from daq_service.archive.journal import frames, writer
from daq_service.archive.journal.checking import check_journal
from daq_service.archive.journal.reader import list_segments, read_journal, read_segments
from daq_service.archive.journal.writer import Journal
from daq_service.archive.layout import build_set_image
from hardware_drivers.measurement import SetKey

RECORDS = make_set().records


@pytest.fixture
def archive(tmp_path):
    with closing(FolderArchive(tmp_path)) as archive:
        yield archive


def test_positions_that_an_earlier_version_left_out_are_restored(archive, tmp_path, monkeypatch):
    def earlier_frame(set_key, *, due_utc_ns, started_utc_ns, disabled):
        facts = {"due_utc_ns": due_utc_ns, "retired": disabled}
        return frames._build_frame(frames.Kind.BEGIN, set_key, facts, utc_ns=started_utc_ns)

    monkeypatch.setattr("daq_service.archive.writer.build_begin_frame", earlier_frame)
    archive.begin_set(SetKey(7), due_utc_ns=5, started_utc_ns=1, disabled={"C": "worn"})
    archive.sync()
    with closing(FolderArchive(tmp_path)) as reopened:
        (opened,) = reopened.open_sets().values()
    assert (opened.due_utc_ns, opened.disabled) == (5, {"C": "worn"})


def fail(monkeypatch, name, times, number=errno.ENOSPC):
    """Let the next calls of the writer fail."""
    refuse(monkeypatch, writer, name, OSError(number, os.strerror(number)), times=times)


@pytest.mark.parametrize("name", ["write_all", "synchronise"])
def test_after_a_write_error_data_go_to_a_new_segment(archive, tmp_path, monkeypatch, name):
    append_set(archive, make_set())
    fail(monkeypatch, name, 1)
    assert archive.sync() == [item.sequence for item in RECORDS]
    assert list(list_segments(tmp_path)) == [2]
    (opened,) = FolderArchive(tmp_path).open_sets().values()
    assert bits(list(opened.records)) == bits(RECORDS)


def test_a_failed_sync_is_not_repeated_on_its_segment(archive, monkeypatch):
    """The second sync may succeed although the data are lost."""
    append_set(archive, make_set())
    opened, real = [], os.open

    def noting(path, *arguments):
        opened.append(str(path))
        return real(path, *arguments)

    monkeypatch.setattr(writer.os, "open", noting)
    fail(monkeypatch, "synchronise", 2, errno.EIO)
    with pytest.raises(ArchiveWriteError, match="Input/output error"):
        archive.sync()
    assert archive.sync() == [item.sequence for item in RECORDS]
    assert len([path for path in opened if path.endswith(".journal")]) == 3


@pytest.mark.parametrize("name", ["write_all", "synchronise"])
def test_a_disk_that_fails_for_hours_is_not_filled_with_segments(archive, tmp_path, monkeypatch, name):
    first, *others = RECORDS
    archive.begin_set(SetKey(SET_INDEX), due_utc_ns=1, started_utc_ns=1, disabled={})
    archive.append(first, 1)
    assert archive.sync() == [first.sequence]
    fail(monkeypatch, name, 20, errno.EIO)
    for item in others:
        archive.append(item, 2)
        with pytest.raises(ArchiveWriteError):
            archive.sync()
    assert list(list_segments(tmp_path)) == [1], "what is acknowledged stays, nothing else"
    (opened,) = FolderArchive(tmp_path).open_sets().values()
    assert first.sequence in {item.sequence for item in opened.records}


def test_rejected_writes_are_kept_and_acknowledged_later(archive, tmp_path, monkeypatch):
    append_set(archive, make_set())
    with monkeypatch.context() as patch:
        fail(patch, "write_all", 99)
        for _ in range(2):
            with pytest.raises(ArchiveWriteError, match="free some space"):
                archive.sync()
    assert FolderArchive(tmp_path).open_sets() == {}
    stored = archive.store_set(make_set())
    assert bits(FolderArchive(tmp_path).read_set(stored.file)) == bits(make_set())


def test_a_nearly_full_disk_is_used_completely(archive, monkeypatch):
    """A record is written even if a whole segment does not fit."""
    monkeypatch.setattr(writer.os, "posix_fallocate", no_file(errno.ENOSPC), raising=False)
    append_set(archive, make_set())
    assert archive.sync() == [item.sequence for item in RECORDS]


def test_a_segment_is_removed_with_its_last_set(tmp_path):
    """Sets have several segments, and segments have several sets."""
    small = 3 * RECORDS[0].waveform.counts.nbytes
    sets = [other_set(make_set(), index) for index in range(SET_INDEX, SET_INDEX + 3)]
    with closing(FolderArchive(tmp_path)) as archive:
        archive._journal_writer = Journal(tmp_path, segment_bytes=small)
        for record in sets:
            append_set(archive, record)
            archive.store_set(record)
        for number, record in enumerate(sets, 1):
            finalize_set(tmp_path, record.set_key)
            archive.settle(record.set_key)
            left = FolderArchive(tmp_path)
            assert left.open_sets() == {}
            assert [bits(left.read_set(file)) for file in left.sets().values()] == [
                bits(item) for item in sets
            ]
            assert len(list(tmp_path.glob("sets/*.h5"))) == number
    assert list(list_segments(tmp_path)) == []


def test_the_byte_ranges_of_a_set_hold_all_its_frames_and_little_more(tmp_path):
    """A set extends over syncs, segments and a restart; no other set is read with it."""
    first, second, third = (other_set(make_set(), index) for index in range(SET_INDEX, SET_INDEX + 3))
    small = 4 * RECORDS[0].waveform.counts.nbytes
    with closing(FolderArchive(tmp_path)) as archive:
        archive._journal_writer = Journal(tmp_path, segment_bytes=small)
        archive.store_set(first)
        archive.begin_set(second.set_key, due_utc_ns=second.due_utc_ns, started_utc_ns=1, disabled={})
        for item in second.records[:-1]:
            archive.append(item, item.stamp.utc_ns)
            archive.sync()
    with closing(FolderArchive(tmp_path)) as archive:
        archive.resume_set(archive.open_sets()[second.set_key])
        archive.append(second.records[-1], 1)
        archive.sync()
        archive.store_set(second)
        archive.store_set(third)
        assert len(archive.places(second.set_key)) >= 3
        for record in (first, second, third):
            index, places = record.set_key, archive.places(record.set_key)
            (found,) = read_journal(tmp_path, of_set=index, places=places).values()
            assert set(read_journal(tmp_path, of_set=index)) == {index}
            assert (found.is_whole, bits(found.record())) == (True, bits(record))
        # A set that this process wrote alone has no more bytes than its frames.
        places = archive.places(third.set_key)
        ((number, (start, end)),) = places.items()
        (whole,) = (content for other, content in read_segments(tmp_path) if other == number)
        assert sum(len(content) for _, content in read_segments(tmp_path, places)) == end - start
        assert set(read_journal(tmp_path, places={number: (start, end)})) == {third.set_key}
        assert whole[start:end].strip(b"\0") == whole[start:end]
        file, *_ = finalize_set(tmp_path, second.set_key, archive.places(second.set_key))
        assert (tmp_path / file).read_bytes() == build_set_image(second)


def test_a_finalized_set_is_compared_with_its_file(archive, tmp_path):
    stored = archive.store_set(make_set())
    finalize_set(tmp_path, SetKey(SET_INDEX))
    file = tmp_path / stored.file
    content = file.read_bytes()
    finalize_set(
        tmp_path, SetKey(SET_INDEX)
    )  # by a recorder that was killed before the first acknowledgement
    assert file.read_bytes() == content
    changed = bytearray(content)
    with h5py.File(file) as opened:
        chunk = opened["entry/B_waveforms/waveform"].id.get_chunk_info(0)
    changed[chunk.byte_offset + 30] ^= 0xFF
    file.write_bytes(changed)
    with pytest.raises(CorruptArchiveError, match="backup: solimon repair --from BACKUP") as caught:
        finalize_set(tmp_path, SetKey(SET_INDEX))
    assert "skip_damaged" not in str(caught.value)
    assert "skip_damaged=True" in caught.value.__notes__[0]  # for who reads it in Python
    whole = make_set()
    other = replace(whole.shots[0], waveform=replace(whole.shots[0].waveform, counts=counts_of(99, 300)))
    file.write_bytes(build_set_image(replace(whole, shots=[other, *whole.shots[1:]])))
    with pytest.raises(CorruptArchiveError, match="is not what the journal holds"):
        finalize_set(tmp_path, SetKey(SET_INDEX))
    file.unlink()
    finalize_set(tmp_path, SetKey(SET_INDEX))
    assert file.read_bytes() == content


def no_file(number):
    def refuse(*arguments, **options):
        raise OSError(number, os.strerror(number))

    return refuse


@pytest.mark.parametrize("number", [errno.EIO, errno.EMFILE, errno.ENOENT], ids=errno.errorcode.get)
def test_a_temporary_read_error_is_no_corruption(archive, tmp_path, monkeypatch, number):
    """Corruption is not retried, and a set that is reported absent from the journal would be lost."""
    archive.store_set(make_set())

    with monkeypatch.context() as patch:
        patch.setattr("daq_service.archive.finalize_set.read_shared", no_file(number))
        with pytest.raises(OSError, match=re.escape(os.strerror(number))):
            finalize_set(tmp_path, SetKey(SET_INDEX))
    finalize_set(tmp_path, SetKey(SET_INDEX))


def test_a_file_that_cannot_be_opened_for_lack_of_handles_is_no_corruption(archive, tmp_path, monkeypatch):
    """A start quarantines corrupt files without rows and must not quarantine this one."""
    stored = archive.store_set(make_set())
    finalize_set(tmp_path, SetKey(SET_INDEX))
    monkeypatch.setattr(reader.h5py, "File", no_file(errno.EMFILE))
    with pytest.raises(ArchiveReadError, match=r"cannot be read now: .*Too many open files"):
        archive.read_set(stored.file)


def test_a_segment_that_cannot_be_removed_is_removed_with_the_next_set(archive, tmp_path, monkeypatch):
    for index in (SET_INDEX, SET_INDEX + 1):
        archive.store_set(other_set(make_set(), index))
        archive._journal_writer._close_segment()
    with monkeypatch.context() as patch:
        patch.setattr(writer, "remove_quietly", lambda path: None)
        archive.settle(SetKey(SET_INDEX))
    assert list(list_segments(tmp_path)) == [1, 2]
    archive.settle(SetKey(SET_INDEX + 1))
    assert list(list_segments(tmp_path)) == []


def test_an_incomplete_set_is_not_finalized(archive, tmp_path):
    with pytest.raises(SetNotFoundError, match="no set 7"):
        finalize_set(tmp_path, SetKey(SET_INDEX))
    append_set(archive, make_set())
    archive.sync()
    with pytest.raises(CorruptArchiveError, match="set 7 in the journal has no end"):
        finalize_set(tmp_path, SetKey(SET_INDEX))


def test_a_group_torn_by_a_power_cut_leaves_its_set_open(archive, tmp_path):
    """The end is stored and a record is missing: the set was not acknowledged and is taken again."""
    append_set(archive, make_set())
    archive.store_set(make_set())
    (path,) = list_segments(tmp_path).values()
    flip(path, path.read_bytes().find(RECORDS[1].waveform.counts.tobytes()) + 8)
    with closing(FolderArchive(tmp_path)) as again:
        (opened,) = again.open_sets().values()
        assert [item.sequence for item in opened.records] == [
            item.sequence for item in RECORDS if item is not RECORDS[1]
        ]
        again.resume_set(opened)
        stored = again.store_set(make_set())
    assert bits(FolderArchive(tmp_path).read_set(stored.file)) == bits(make_set())
    assert opened.due_utc_ns == DUE_UTC_NS


def test_a_last_frame_without_its_last_sector_is_truncated_and_a_changed_one_corrupt(archive, tmp_path):
    append_set(archive, make_set())
    archive.sync()
    (path,) = list_segments(tmp_path).values()
    content = path.read_bytes()
    start = (len(content.rstrip(b"\0")) - 1) // 512 * 512
    path.write_bytes(content[:start] + bytes(len(content) - start))
    assert check_journal(tmp_path).unsound == []
    path.write_bytes(content)
    flip(path, start)
    assert len(check_journal(tmp_path).unsound) == 1
