"""Store sets in the journal, record by record; `compact_set` gives each its own file later."""

from __future__ import annotations

import contextlib
import errno
import os
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from daq_service.archive.errors import ArchiveWriteError, ConflictingSetError
from daq_service.archive.journal.frames import Buffers, end_frame
from daq_service.archive.journal.writer import Journal
from daq_service.archive.layout import build_image
from daq_service.archive.reader import FolderSetReader
from daq_service.archive.records import (
    JOURNAL_FOLDER,
    QUARANTINE_FOLDER,
    SETS_FOLDER,
    TEMPORARY_SUFFIX,
    MissedRecord,
    OpenSet,
    Places,
    SetRecord,
    SetReference,
    StoredSet,
    StoreTimings,
    set_reference,
    waveform_crc32,
)
from daq_service.shared_file import patiently, remove_quietly, sync_folder
from hardware_drivers.measurement import PulseEchoRecord, Shot

_REMEDY = {
    errno.ENOSPC: "free some space",
    errno.EDQUOT: "free some space or raise the quota",
    errno.EROFS: "make the disk writable again",
    errno.EACCES: "give this user the right to write there",
    errno.EPERM: "give this user the right to write there",
}


class FolderArchive(FolderSetReader):
    """The sets of one data folder in the hands of the recorder, who alone writes there.

    Opening makes the folders and removes what a crash left unfinished.

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
        super().__init__(folder)
        self._sets_folder = folder / SETS_FOLDER
        try:
            self._sets_folder.mkdir(parents=True, exist_ok=True)
            (folder / JOURNAL_FOLDER).mkdir(exist_ok=True)
            sync_folder(folder)
            self._kept = Journal(folder)
            with contextlib.suppress(PermissionError):
                # A new data folder's own name; the folder above may belong to others.
                sync_folder(folder.absolute().parent, patience_s=0.0)
            unfinished = patiently(lambda: list(self._sets_folder.glob(f"*{TEMPORARY_SUFFIX}")))
            self._own = self._sets_folder.stat()
        except OSError as error:
            raise _refused(self._sets_folder, error) from error
        for path in unfinished:
            remove_quietly(path)
        self.journal_damage = self._kept.damage
        # Frames that share a segment with others outlive their set, whose first segments may be gone.
        for index in [index for index, item in self._kept.left.items() if not item.is_whole]:
            if index in self._files():
                self._kept.settle(index)
        self._begun: dict[int, set[int]] = {}
        self._ending: dict[int, Buffers] = {}
        # A set that was ended and is not whole was never acknowledged, or is damaged: it may be taken again.
        self._stored = {index: file for index, file in self.sets().items() if index not in self.open_sets()}

    def begin_set(
        self, set_index: int, *, due_utc_ns: int, started_utc_ns: int, retired: Mapping[str, str]
    ) -> None:
        """Note that a set is begun; durable with the first `sync` after it."""
        self._begun[set_index] = set()
        self._kept.begin(set_index, due_utc_ns=due_utc_ns, started_utc_ns=started_utc_ns, retired=retired)

    def append(self, taken: Shot | PulseEchoRecord | MissedRecord, utc_ns: int) -> None:
        """Take in what a begun set has come to; acknowledged by `sync`."""
        begun = self._begun.get(taken.key.set_index)
        if begun is None:
            return
        if isinstance(taken, MissedRecord):
            self._kept.append_missed(taken, utc_ns)
        else:
            self._kept.append(taken)
            begun.add(taken.sequence)

    def sync(self) -> list[int]:
        """Make everything durable that was taken in; return the shot ids that this acknowledges."""
        try:
            self._check_own_folder()
            return self._kept.sync()
        except OSError as error:
            raise _refused(self.folder / JOURNAL_FOLDER, error) from error

    def open_sets(self) -> dict[int, OpenSet]:
        """Return the sets that an earlier process began and nobody ended, by index."""
        found = {index: item.opened() for index, item in self._kept.left.items() if not item.is_whole}
        return {index: item for index, item in found.items() if item is not None}

    def to_compact(self) -> list[int]:
        """Whole sets that an earlier process left in the journal."""
        return [index for index, item in self._kept.left.items() if item.is_whole]

    def resume_set(self, opened: OpenSet) -> None:
        """Go on with an open set: what comes is added to what is durable."""
        self._begun[opened.set_index] = {record.sequence for record in opened.records}
        if not opened.is_dated:
            self._kept.begin(
                opened.set_index,
                due_utc_ns=opened.due_utc_ns,
                started_utc_ns=opened.started_utc_ns,
                retired=opened.retired,
            )

    def store_set(self, record: SetRecord) -> StoredSet:
        """Make a set durable; when this returns every record of it is acknowledged."""
        start = time.perf_counter()
        reference = set_reference(record.set_index, record.due_utc_ns)
        stored = self._stored.get(record.set_index)
        if stored is not None:
            # The same set once more, after an error that came when all was done.
            kept = replace(self.read_set(stored), results=record.results)
            if stored != reference or build_image(kept) != build_image(record):
                raise self._conflict(record.set_index, stored)
        else:
            self._end(record)
        built = time.perf_counter()
        self.sync()
        self._begun.pop(record.set_index, None)
        self._stored[record.set_index] = reference
        return StoredSet(
            file=reference,
            n_bytes=sum(item.waveform.counts.nbytes for item in record.records),
            crc32={item.sequence: waveform_crc32(item.waveform) for item in record.records},
            timings=StoreTimings(image_s=built - start, fsync_s=time.perf_counter() - built),
        )

    def _end(self, record: SetRecord) -> None:
        """Add what the journal lacks of a set, and its end, once."""
        ended = end_frame(record)
        if self._ending.get(record.set_index) == ended:
            return
        known = self._begun.setdefault(record.set_index, set())
        for item in record.records:
            if item.sequence not in known:
                self._kept.append(item)
                known.add(item.sequence)
        self._kept.end(record.set_index, ended)
        self._ending = {record.set_index: ended}

    def places(self, set_index: int) -> Places:
        """Where the journal has the durable frames of a set."""
        return self._kept.places(set_index)

    def settle(self, set_index: int) -> None:
        """Let the journal forget a set: it has its own file, or rows without a record."""
        self._begun.pop(set_index, None)
        self._kept.settle(set_index)

    def close(self) -> None:
        """Let go of the journal; nothing of it is lost."""
        self._kept.close()

    def set_aside(self, reference: SetReference) -> None:
        """Move a set that cannot be read out of the way, for a person to look at; nothing is deleted."""
        source = self.folder / reference
        try:
            if source.exists():
                move_aside(self.folder, reference)
            else:
                self._kept.set_aside(self._index_of(reference), source.name)
        except OSError as error:
            raise _refused(source, error) from error
        self._stored = self.sets()

    def _index_of(self, reference: SetReference) -> int:
        return next(index for index, file in self.sets().items() if file == reference)

    def quarantined(self) -> list[str]:
        """Name everything that was set aside and is still there."""
        names = sorted(path.name for path in (self.folder / QUARANTINE_FOLDER).glob("*"))
        return [f"{QUARANTINE_FOLDER}/{name}" for name in names]

    def _check_own_folder(self) -> None:
        """Where a disk was taken away or a folder moved, another one may stand in its place."""
        if not os.path.samestat(self._own, self._sets_folder.stat()):
            raise ArchiveWriteError(
                f"{self._sets_folder} is not the folder of this test any more; bring its own one back"
            )

    def _conflict(self, set_index: int, stored: SetReference) -> ConflictingSetError:
        return ConflictingSetError(
            f"set {set_index} is stored already in {self.folder / stored} and differs; nothing stored is "
            "overwritten: take that file over with read_set, or move it out of the folder"
        )


def move_aside(folder: Path, reference: SetReference) -> str:
    """Move a set's file to the quarantine, and return its name there; nothing is overwritten.

    Raises
    ------
    OSError
        It stays where it is.
    """
    source, quarantine = folder / reference, folder / QUARANTINE_FOLDER
    quarantine.mkdir(exist_ok=True)
    target = quarantine / source.name
    while target.exists():
        target = target.with_name(f"again_{target.name}")
    patiently(lambda: source.replace(target))
    for changed in (quarantine, source.parent, folder):
        sync_folder(changed)
    return f"{QUARANTINE_FOLDER}/{target.name}"


def _refused(path: Path, error: OSError) -> ArchiveWriteError:
    remedy = _REMEDY.get(error.errno or 0, "check the disk and its connection")
    return ArchiveWriteError(f"{path} cannot be written: {error.strerror or error}; {remedy}")
