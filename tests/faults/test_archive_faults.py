"""A set is complete or absent after any disk fault and any end of the process.

Every call to the operating system goes through the names of `os` in `shared_file`; the tests put
a `Disk` there that counts the calls, refuses one of them, or ends the process between two.
"""

import errno
import os
import sys
from contextlib import closing
from pathlib import Path

import pytest
from support.archived_sets import SET_INDEX, assert_same_set, make_set
from support.stored_files import read_set, set_files

from daq_service import shared_file
from daq_service.archive import ArchiveWriteError, FolderArchive
from daq_service.archive.finalize_set import finalize_set
from hardware_drivers.measurement import SetKey

CALLS_OF_A_SET = ["open", "write", "fsync", "close", "replace", "open", "fsync", "close"]


class Killed(BaseException):
    """End of the process: nothing after it runs."""


class Disk:
    """`os` as used by `shared_file`.

    Parameters
    ----------
    fail_at, error
        Number of the call that fails, and how: an errno, or `Killed` from there on.
    longest_write
        Bytes that one write takes; a failing write takes half of what it was given.
    """

    def __init__(self, *, fail_at=None, error=None, longest_write=None):
        self.fail_at, self.error, self.longest_write = fail_at, error, longest_write
        self.calls: list[str] = []
        self.killed = False
        self.refused: set[str] = set()
        self.held: set[int] = set()
        self.opened: list[Path] = []

    def __getattr__(self, name):
        real = getattr(os, name)
        if not callable(real):
            return real

        def call(*arguments):
            return self._call(name, real, *arguments)

        return call

    def _call(self, name, real, *arguments):
        if self.killed:
            raise Killed
        number = len(self.calls)
        self.calls.append(name)
        if number == self.fail_at or name in self.refused:
            if name == "write":
                descriptor, content = arguments
                real(descriptor, content[: len(content) // 2])
            if name == "close":
                real(*arguments)  # a descriptor is gone even when its close fails
                self.held.discard(arguments[0])
            if self.error is Killed:
                self.killed = True
                for descriptor in self.held:
                    os.close(descriptor)  # as the system does
                raise Killed
            raise OSError(self.error, os.strerror(self.error))
        if name == "write" and self.longest_write is not None:
            descriptor, content = arguments
            return real(descriptor, content[: self.longest_write])
        result = real(*arguments)
        if name == "open":
            self.held.add(result)
            self.opened.append(Path(arguments[0]))
        if name == "close":
            self.held.discard(arguments[0])
        return result


def journaled(folder):
    """Store a set; return a function that writes its file, as the worker of the recorder does."""
    with closing(FolderArchive(folder)) as archive:
        archive.store_set(make_set())
    return lambda: finalize_set(folder, SetKey(SET_INDEX))[0]


@pytest.fixture
def make_file(tmp_path):
    return journaled(tmp_path)


def put(monkeypatch, disk):
    monkeypatch.setattr(shared_file, "os", disk)
    return disk


def names(folder):
    return sorted(path.name for path in (folder / "sets").iterdir())


def test_file_and_folder_are_synced_in_this_order_so_that_a_power_cut_leaves_the_set_whole_or_absent(
    monkeypatch, tmp_path, make_file
):
    disk = put(monkeypatch, Disk())
    make_file()
    assert disk.calls == CALLS_OF_A_SET
    file, folder = disk.opened
    assert (file.parent, file.suffix, folder) == (tmp_path / "sets", ".tmp", tmp_path / "sets")


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO, errno.EROFS], ids=errno.errorcode.get)
@pytest.mark.parametrize("call", range(len(CALLS_OF_A_SET)))
def test_a_refused_call_leaves_nothing_and_the_set_can_be_stored_again(
    monkeypatch, tmp_path, make_file, call, code
):
    put(monkeypatch, Disk(fail_at=call, error=code))
    with pytest.raises(OSError, match=os.strerror(code)):
        make_file()
    assert names(tmp_path) == []
    disk = put(monkeypatch, Disk())
    file = make_file()
    # A fsync that failed is never tried again on its file: everything is written again.
    assert disk.calls == CALLS_OF_A_SET
    assert_same_set(read_set(tmp_path / file), make_set())


def test_a_disk_that_refuses_the_clean_up_too_is_cleaned_at_the_next_start(
    monkeypatch, tmp_path, make_file, caplog
):
    disk = put(monkeypatch, Disk(fail_at=1, error=errno.EIO))
    disk.refused = {"unlink"}
    with pytest.raises(OSError):  # noqa: PT011 - whichever call was refused
        make_file()
    (left,) = names(tmp_path)
    assert left.endswith(".tmp")
    assert "cannot remove the unfinished" in caplog.text
    put(monkeypatch, Disk())
    FolderArchive(tmp_path)
    assert names(tmp_path) == []


@pytest.mark.parametrize("call", range(len(CALLS_OF_A_SET) + 1))
def test_a_process_that_ends_between_two_calls_leaves_the_set_whole_or_absent(
    monkeypatch, tmp_path, make_file, call
):
    put(monkeypatch, Disk(fail_at=call, error=Killed))
    acknowledged = False
    try:
        make_file()
        acknowledged = True
    except Killed:
        pass
    put(monkeypatch, Disk())
    FolderArchive(tmp_path)
    found = list((tmp_path / "sets").iterdir())
    assert [path for path in found if path != set_files(tmp_path)[SET_INDEX]] == []
    for path in found:
        assert_same_set(read_set(path), make_set())
    assert acknowledged == (call == len(CALLS_OF_A_SET))
    assert bool(found) == (call > CALLS_OF_A_SET.index("replace"))


def test_opening_a_folder_that_cannot_be_synced_is_a_storage_error(monkeypatch, tmp_path):
    put(monkeypatch, Disk(fail_at=0, error=errno.EROFS))
    with pytest.raises(ArchiveWriteError, match="make the disk writable again"):
        FolderArchive(tmp_path)


def test_an_unreadable_parent_folder_is_accepted(monkeypatch, tmp_path):
    disk = put(monkeypatch, Disk(fail_at=3, error=errno.EACCES))
    FolderArchive(tmp_path)
    assert disk.calls == ["open", "fsync", "close", "open"]


def test_folders_are_not_synced_on_windows(monkeypatch, tmp_path):
    disk = put(monkeypatch, Disk())
    monkeypatch.setattr(sys, "platform", "win32")
    shared_file.sync_folder(tmp_path)
    assert disk.calls == []
