"""Store sets in the journal, record by record; `finalize_set` writes each to its own file later."""

from __future__ import annotations

import contextlib
import errno
import os
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from daq_service.archive.errors import ArchiveWriteError, ConflictingSetError
from daq_service.archive.journal.frames import Buffers, build_begin_frame, build_end_frame, build_missed_frame
from daq_service.archive.journal.writer import Journal
from daq_service.archive.layout import build_set_image
from daq_service.archive.reader import FolderSetReader
from daq_service.archive.records import (
    JOURNAL_FOLDER,
    QUARANTINE_FOLDER,
    SETS_FOLDER,
    TEMPORARY_SUFFIX,
    OpenSet,
    Places,
    SetReference,
    StoredSet,
    StoreTimings,
    build_reference,
)
from daq_service.shared_file import remove_quietly, retry, sync_folder
from hardware_drivers.measurement import MissedShot, PulseEchoRecord, SetKey, SetRecord, Shot, compute_crc32

_REMEDY = {
    errno.ENOSPC: "free some space",
    errno.EDQUOT: "free some space or raise the quota",
    errno.EROFS: "make the disk writable again",
    errno.EACCES: "give this user the right to write there",
    errno.EPERM: "give this user the right to write there",
}


class FolderArchive(FolderSetReader):
    """The recorder's archive in a data folder; only the recorder writes there.

    Opening creates the folders and removes unfinished files of a crash.

    Parameters
    ----------
    folder
        The data folder; files go to ``sets/`` in it.

    Raises
    ------
    ArchiveWriteError
        The folder cannot be made or written.
    """

    def __init__(self, folder: Path) -> None:
        """Create the folders, open the journal and delete unfinished files; see the class."""
        super().__init__(folder)
        self._sets_folder = folder / SETS_FOLDER
        try:
            self._sets_folder.mkdir(parents=True, exist_ok=True)
            (folder / JOURNAL_FOLDER).mkdir(exist_ok=True)
            sync_folder(folder)
            self._journal_writer = Journal(folder)
            with contextlib.suppress(PermissionError):
                # The name of a new data folder; the parent folder may belong to another user.
                sync_folder(folder.absolute().parent, patience_s=0.0)
            unfinished = retry(lambda: list(self._sets_folder.glob(f"*{TEMPORARY_SUFFIX}")))
            self._folder_stat = self._sets_folder.stat()
        except OSError as error:
            raise _create_write_error(self._sets_folder, error) from error
        for path in unfinished:
            remove_quietly(path)
        self.journal_damage = self._journal_writer.damage
        # Frames of a finalized set remain in shared segments; its earlier segments may be removed.
        for index in [index for index, item in self._journal_writer.left.items() if not item.is_whole]:
            if index in self._list_files():
                self._journal_writer.settle(index)
        self._sequences_of: dict[SetKey, set[int]] = {}
        self._end_frames: dict[SetKey, Buffers] = {}
        # An ended set that is incomplete was not acknowledged, or is corrupt: it may be measured again.
        self._stored = {index: file for index, file in self.sets().items() if index not in self.open_sets()}

    def begin_set(
        self, set_key: SetKey, *, due_utc_ns: int, started_utc_ns: int, disabled: Mapping[str, str]
    ) -> None:
        """Add the start of a set to the journal; the next `sync` makes it durable. Times are ns of UTC.

        ``disabled`` has the reason of each position that is left out.
        """
        self._sequences_of[set_key] = set()
        frame = build_begin_frame(
            set_key, due_utc_ns=due_utc_ns, started_utc_ns=started_utc_ns, disabled=disabled
        )
        self._journal_writer.add(set_key, frame)

    def append(self, item: Shot | PulseEchoRecord | MissedShot, utc_ns: int) -> None:
        """Add a record or a missed record to a started set; the next `sync` acknowledges it.

        It is ignored if the set was not started: `store_set` then adds all records at once. ``utc_ns`` is the
        time of a missed record.
        """
        sequences = self._sequences_of.get(item.key.set_key)
        if sequences is None:
            return
        if isinstance(item, MissedShot):
            self._journal_writer.add(item.key.set_key, build_missed_frame(item, utc_ns))
        else:
            self._journal_writer.append(item)
            sequences.add(item.sequence)

    def sync(self) -> list[int]:
        """Make all additions durable and return the ids of the acknowledged shots.

        Raises `ArchiveWriteError`, with nothing acknowledged, if the disk refuses or the folder was replaced.
        """
        try:
            self._raise_if_folder_replaced()
            return self._journal_writer.sync()
        except OSError as error:
            raise _create_write_error(self.folder / JOURNAL_FOLDER, error) from error

    def open_sets(self) -> dict[SetKey, OpenSet]:
        """Return the unfinished sets that an earlier process left in the journal, by key.

        A set with a corrupt or missing record counts as unfinished.
        """
        opened = {
            index: item.opened() for index, item in self._journal_writer.left.items() if not item.is_whole
        }
        return {index: item for index, item in opened.items() if item is not None}

    def list_sets_to_finalize(self) -> list[SetKey]:
        """List the keys of the complete sets that an earlier process left in the journal, sorted."""
        return [index for index, item in self._journal_writer.left.items() if item.is_whole]

    def resume_set(self, opened: OpenSet) -> None:
        """Continue an open set: later records are added to the durable ones.

        A corrupt start frame is added again, with the next `sync`.
        """
        self._sequences_of[opened.set_key] = {record.sequence for record in opened.records}
        if not opened.is_dated:
            frame = build_begin_frame(
                opened.set_key,
                due_utc_ns=opened.due_utc_ns,
                started_utc_ns=opened.started_utc_ns,
                disabled=opened.disabled,
            )
            self._journal_writer.add(opened.set_key, frame)

    def store_set(self, record: SetRecord) -> StoredSet:
        """Make a set durable; on return every record of it is acknowledged.

        An equal set that is stored already is left as it is. Raises ConflictingSetError if it differs,
        ArchiveWriteError if nothing was stored, ValueError if JSON cannot hold the provenance.
        """
        start = time.perf_counter()
        reference = build_reference(record.set_key, record.due_utc_ns)
        stored = self._stored.get(record.set_key)
        if stored is not None:
            # The same set again, after an error that occurred when it was already stored.
            stored_record = replace(self.read_set(stored), results=record.results)
            if stored != reference or build_set_image(stored_record) != build_set_image(record):
                raise self._create_conflict_error(record.set_key, stored)
        else:
            self._add_end_frame(record)
        added = time.perf_counter()
        self.sync()
        self._sequences_of.pop(record.set_key, None)
        self._stored[record.set_key] = reference
        return StoredSet(
            file=reference,
            n_bytes=sum(item.waveform.counts.nbytes for item in record.records),
            crc32={item.sequence: compute_crc32(item.waveform) for item in record.records},
            timings=StoreTimings(image_s=added - start, fsync_s=time.perf_counter() - added),
        )

    def _add_end_frame(self, record: SetRecord) -> None:
        """Add the records of a set that the journal lacks, and its end frame unless it was added before.

        Nothing is synced. Raises ValueError if JSON cannot hold the provenance.
        """
        frame = build_end_frame(record)
        if self._end_frames.get(record.set_key) == frame:
            return
        sequences = self._sequences_of.setdefault(record.set_key, set())
        for item in record.records:
            if item.sequence not in sequences:
                self._journal_writer.append(item)
                sequences.add(item.sequence)
        self._journal_writer.add(record.set_key, frame)
        self._end_frames = {record.set_key: frame}

    def places(self, set_key: SetKey) -> Places:
        """Return first and last byte of a set's durable frames in the journal by number of the segment."""
        return self._journal_writer.places(set_key)

    def settle(self, set_key: SetKey) -> None:
        """Remove a set from the journal, because it has its own file, or rows without a record.

        Deletes segments without other sets; one that cannot be deleted is tried again later.
        """
        self._sequences_of.pop(set_key, None)
        self._journal_writer.settle(set_key)

    def close(self) -> None:
        """Close the journal without syncing; all acknowledged records stay."""
        self._journal_writer.close()

    def set_aside(self, reference: SetReference) -> None:
        """Move an unreadable set to the quarantine, a journaled one as a copy; nothing is deleted.

        Raises ArchiveWriteError; the set then stays where it is. Raises StopIteration for an unknown set.
        """
        source = self.folder / reference
        try:
            if source.exists():
                move_to_quarantine(self.folder, reference)
            else:
                self._journal_writer.set_aside(self._find_set_key(reference), source.name)
        except OSError as error:
            raise _create_write_error(source, error) from error
        self._stored = self.sets()

    def _find_set_key(self, reference: SetReference) -> SetKey:
        """Find the key of a stored set by its reference; raise StopIteration if there is none."""
        return next(key for key, file in self.sets().items() if file == reference)

    def list_quarantined(self) -> list[str]:
        """List the files in the quarantine by path relative to the data folder, sorted; empty without any."""
        names = sorted(path.name for path in (self.folder / QUARANTINE_FOLDER).glob("*"))
        return [f"{QUARANTINE_FOLDER}/{name}" for name in names]

    def _raise_if_folder_replaced(self) -> None:
        """Raise `ArchiveWriteError` if the folder of sets was replaced, as when a disk is unmounted.

        Raises OSError if it is gone.
        """
        if not os.path.samestat(self._folder_stat, self._sets_folder.stat()):
            raise ArchiveWriteError(
                f"{self._sets_folder} is not the folder of this test any more; bring its own one back"
            )

    def _create_conflict_error(self, set_key: SetKey, stored: SetReference) -> ConflictingSetError:
        """Create, but do not raise, the error for a set that ``stored`` has with different content."""
        return ConflictingSetError(
            f"set {set_key} is stored already in {self.folder / stored} and differs; nothing stored is "
            "overwritten: take that file over with read_set, or move it out of the folder"
        )


def move_to_quarantine(folder: Path, reference: SetReference) -> str:
    """Move a set's file durably to the quarantine and return its path relative to the data folder.

    Another file of that name stays: the moved one gets the prefix ``again_``.

    Raises
    ------
    OSError
        The move failed, or may not be durable.
    """
    source, quarantine = folder / reference, folder / QUARANTINE_FOLDER
    quarantine.mkdir(exist_ok=True)
    target = quarantine / source.name
    while target.exists():
        target = target.with_name(f"again_{target.name}")
    retry(lambda: source.replace(target))
    for parent in (quarantine, source.parent, folder):
        sync_folder(parent)
    return f"{QUARANTINE_FOLDER}/{target.name}"


def _create_write_error(path: Path, error: OSError) -> ArchiveWriteError:
    """Create, but do not raise, the error for a failed write to ``path``, with the remedy for its cause."""
    remedy = _REMEDY.get(error.errno or 0, "check the disk and its connection")
    return ArchiveWriteError(f"{path} cannot be written: {error.strerror or error}; {remedy}")
