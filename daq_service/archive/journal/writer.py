"""Append to the journal: collect frames in memory, then acknowledge them with one write and one fdatasync."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from daq_service.archive.journal.checking import CheckedJournal, check_journal
from daq_service.archive.journal.frames import Buffers, build_discard_frame, build_record_frame
from daq_service.archive.journal.reader import (
    JournaledSet,
    build_segment_path,
    list_misnamed,
    list_segments,
    parse_segment_number,
    read_journal,
)
from daq_service.archive.records import JOURNAL_FOLDER, QUARANTINE_FOLDER, JournalDamage, Places
from daq_service.shared_file import (
    O_BINARY,
    read_shared,
    remove_quietly,
    retry,
    sync_folder,
    write_all,
    write_durably,
)
from hardware_drivers.measurement import PulseEchoRecord, SetKey, Shot

log = logging.getLogger(__name__)

SEGMENT_BYTES = 16 * 2**20
"""Allocated at once, so that a sync stores no file size; about twenty sets."""
_NO_ALLOCATION = {errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
synchronise = getattr(os, "fdatasync", os.fsync)
"""Sync data and file size; not the file times, where the system distinguishes them."""


class Journal:
    """The recorder's segments of one data folder.

    Opening reads earlier segments and copies corrupt ones to the quarantine. New frames go to a new segment,
    because the state of an older one's tail on the disk is unknown.

    Attributes
    ----------
    left, damage
        Sets found when the journal was opened, by key, and their corruption.

    Raises
    ------
    OSError
        A segment cannot be read, or a damaged one not copied.
    """

    def __init__(self, folder: Path, *, segment_bytes: int = SEGMENT_BYTES) -> None:
        """Open the journal of a folder: rename misnamed segments, check all, copy the corrupt ones.

        Raises OSError; blocks until all segments are read.
        """
        self._folder, self._segment_bytes = folder, segment_bytes
        renamed = self._rename_misnamed_segments()
        checked = check_journal(folder)
        self.left: dict[SetKey, JournaledSet] = checked.sets
        self.damage = self._copy_corrupt_segments(checked, renamed)
        self._sets_in: dict[int, dict[SetKey, tuple[int, int | None]]] = {
            number: {} for number in list_segments(folder)
        }
        for item in self.left.values():
            for number in item.segments:
                self._sets_in.setdefault(number, {})[item.set_key] = 0, None
        self._number = max(self._sets_in, default=0)
        self._descriptor: int | None = None
        self._room = self._end = 0
        self._pending: list[Buffers] = []
        self._unacknowledged: list[int] = []
        self._pending_sets: set[SetKey] = set()

    def _rename_misnamed_segments(self) -> dict[str, str]:
        """Rename files that hold frames under other names to the next segment numbers.

        Returns the former name by new path. Raises OSError.
        """
        former_names = {}
        for path in list_misnamed(self._folder):
            new = build_segment_path(self._folder, max(list_segments(self._folder), default=0) + 1)
            retry(partial(os.rename, path, new))
            former_names[f"{JOURNAL_FOLDER}/{new.name}"] = path.name
        return former_names

    def _copy_corrupt_segments(self, checked: CheckedJournal, renamed: Mapping[str, str]) -> JournalDamage:
        """Copy corrupt segments to the quarantine before any of their frames can be dropped.

        Logs an error for each. ``renamed`` has the former name of a renamed segment by its path. Raises
        OSError.
        """
        reasons_of = {file: [f"its name was {name}"] for file, name in renamed.items()}
        for file, damage in checked.damages:
            reasons_of.setdefault(file, []).append(str(damage))
        copies = {
            file: self._copy_to_quarantine(parse_segment_number(file), Path(file).name) for file in reasons_of
        }
        for file, reasons in reasons_of.items():
            log.error("%s is damaged: %s; a copy is %s", file, "; ".join(reasons), copies[file])
        return JournalDamage(
            files={
                copies[file]: f"copy of {file}: {'; '.join(reasons)}" for file, reasons in reasons_of.items()
            },
            sets=frozenset(checked.suspects),
            next_sequence=checked.last_sequence + 1,
            n_lost=checked.n_lost,
        )

    def _copy_to_quarantine(self, number: int, name: str) -> str:
        """Copy a segment, without zeros at its end, to the quarantine, unless the same content is there.

        Returns the copy's path relative to the data folder; another file of that name stays. Raises OSError.
        """
        content = read_shared(build_segment_path(self._folder, number)).rstrip(b"\0")
        copy = self._folder / QUARANTINE_FOLDER / name
        copy.parent.mkdir(exist_ok=True)
        sync_folder(self._folder)
        while copy.exists() and read_shared(copy) != content:
            copy = copy.with_name(f"again_{copy.name}")
        if not copy.exists():
            write_durably(copy, content, temporary=copy.with_suffix(".tmp"))
        return f"{QUARANTINE_FOLDER}/{copy.name}"

    def append(self, record: Shot | PulseEchoRecord) -> None:
        """Add a record in memory, without copying its counts; the next `sync` writes and acknowledges it."""
        self.add(record.key.set_key, build_record_frame(record))
        self._unacknowledged.append(record.sequence)

    def add(self, set_key: SetKey, frame: Buffers) -> None:
        """Add an encoded frame (`frames`) of a set in memory; the next `sync` makes it durable."""
        self._pending.append(frame)
        self._pending_sets.add(set_key)

    def set_aside(self, set_key: SetKey, name: str) -> None:
        """Copy the segments of a set to the quarantine under its name; the set may then start again.

        Its frames are discarded by a frame that is synced at once, together with all added ones.

        Raises
        ------
        OSError
            It stays as it is.
        KeyError
            The journal has no frame of it.
        """
        item = read_journal(self._folder, of_set=set_key)[set_key]
        for number in item.segments:
            self._copy_to_quarantine(number, f"{name}.{number:06d}.journal")
        self.add(set_key, build_discard_frame(set_key))
        self.sync()
        self.settle(set_key)

    def sync(self) -> list[int]:
        """Write and sync all added frames; return the ids of the shots that are durable now.

        A failed sync is never repeated on its segment, since the second one may succeed although the data are
        lost: the frames are written again from memory to a new segment, with a warning in the log.

        Raises
        ------
        OSError
            That failed, too: nothing was acknowledged; all frames stay for the next call.
        """
        if not self._pending:
            return []
        content = [buffer for frame in self._pending for buffer in frame if len(buffer)]
        try:
            self._write_buffers(content)
        except OSError as error:
            log.warning("segment %06d of the journal is not written any further: %s", self._number, error)
            self._close_segment()
            try:
                self._write_buffers(content)
            except OSError:
                self._close_segment()
                raise
        acknowledged, self._unacknowledged = self._unacknowledged, []
        self._pending, self._pending_sets = [], set()
        return acknowledged

    def _write_buffers(self, content: list[bytes | memoryview]) -> None:
        """Write buffers to the present segment, or to a new one if they do not fit, and sync it.

        Blocks until they are durable. Raises OSError; the byte ranges of the sets are updated only after the
        sync.
        """
        n_bytes = sum(map(len, content))
        if self._descriptor is None or self._room < n_bytes:
            self._close_segment()
            self._open_segment(n_bytes)
        assert self._descriptor is not None, "just opened"
        write_all(self._descriptor, content)
        synchronise(self._descriptor)
        first, self._end = self._end, self._end + n_bytes
        places = self._sets_in[self._number]
        for set_key in self._pending_sets:
            places[set_key] = places.get(set_key, (first, None))[0], self._end
        self._room -= n_bytes

    def _open_segment(self, n_bytes: int) -> None:
        """Create the next segment and allocate its space: 16 MiB, or ``n_bytes`` if that is more.

        A disk that cannot allocate is written without allocation; other errors raise OSError.
        """
        self._number += 1
        path = build_segment_path(self._folder, self._number)
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | O_BINARY
        self._descriptor = retry(lambda: os.open(path, flags, 0o644))
        self._sets_in[self._number] = {}
        self._room, self._end = max(self._segment_bytes, n_bytes), 0
        if hasattr(os, "posix_fallocate"):
            try:
                os.posix_fallocate(self._descriptor, 0, self._room)
            except OSError as error:
                # A nearly full disk, or one that cannot allocate: write without allocation.
                if error.errno not in _NO_ALLOCATION:
                    raise
        sync_folder(path.parent)

    def _close_segment(self) -> None:
        """Close the present segment, if any; delete its file if it holds no set. Errors are not raised."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is None:
            return
        with contextlib.suppress(OSError):  # its last sync decided whether its frames are durable
            os.close(descriptor)
        if not self._sets_in[self._number]:  # else a failing disk would be filled with empty segments
            self._remove_segment(self._number)

    def places(self, set_key: SetKey) -> Places:
        """Return first and last byte of a set's durable frames by segment number; empty if there are none.

        The last byte is None for a segment of an earlier process: the set is anywhere in it.
        """
        return {number: sets[set_key] for number, sets in self._sets_in.items() if set_key in sets}

    def settle(self, set_key: SetKey) -> None:
        """Remove a set that is stored elsewhere or not needed from the journal; delete segments without sets.

        An unknown set changes nothing. A segment that cannot be deleted is kept for the next call.
        """
        self.left.pop(set_key, None)
        for number, indices in list(self._sets_in.items()):
            indices.pop(set_key, None)
            if not indices and (number != self._number or self._descriptor is None):
                self._remove_segment(number)

    def _remove_segment(self, number: int) -> None:
        """Delete a segment's file; if the disk refuses, keep the segment for a later call."""
        path = build_segment_path(self._folder, number)
        remove_quietly(path)
        if not path.exists():  # else the next call of `settle` tries again
            del self._sets_in[number]

    def close(self) -> None:
        """Close the present segment and delete segments without sets; frames that are not synced are lost."""
        self._close_segment()
        for number, indices in list(self._sets_in.items()):
            if not indices:
                self._remove_segment(number)
