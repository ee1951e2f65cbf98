"""Store sets: image in memory, temporary name, fsync, rename, fsync of the folder, acknowledgement."""

from __future__ import annotations

import contextlib
import errno
import os
import time
from pathlib import Path

from daq_service.archive.errors import ArchiveWriteError, ConflictingSetError
from daq_service.archive.layout import build_image
from daq_service.archive.reader import FolderSetReader
from daq_service.archive.records import (
    QUARANTINE_FOLDER,
    SETS_FOLDER,
    TEMPORARY_SUFFIX,
    SetRecord,
    SetReference,
    StoredSet,
    StoreTimings,
    set_reference,
    waveform_crc32,
)
from daq_service.shared_file import patiently, read_shared, remove_quietly, sync_folder, write_durably

_REMEDY = {
    errno.ENOSPC: "free some space",
    errno.EDQUOT: "free some space or raise the quota",
    errno.EROFS: "make the disk writable again",
    errno.EACCES: "give this user the right to write there",
    errno.EPERM: "give this user the right to write there",
}


class FolderArchive(FolderSetReader):
    """The sets of one data folder in the hands of the recorder, who alone writes there.

    Opening makes the folder and removes what a crash left unfinished.

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
            sync_folder(folder)
            with contextlib.suppress(PermissionError):
                # A new data folder's own name; the folder above may belong to others.
                sync_folder(folder.absolute().parent, patience_s=0.0)
            unfinished = patiently(lambda: list(self._sets_folder.glob(f"*{TEMPORARY_SUFFIX}")))
            self._own = self._sets_folder.stat()
        except OSError as error:
            raise _refused(self._sets_folder, error) from error
        for path in unfinished:
            remove_quietly(path)
        self._stored = self.sets()

    def store_set(self, record: SetRecord) -> StoredSet:
        """Make a set durable; only when this returns is it acknowledged."""
        start = time.perf_counter()
        image = build_image(record)
        built = time.perf_counter()
        reference = set_reference(record.set_index, record.due_utc_ns)
        path = self.folder / reference
        temporary = path.with_suffix(TEMPORARY_SUFFIX)
        try:
            self._check_own_folder()
            self._check_free(reference, record.set_index, image)
            write_s, fsync_s, directory_fsync_s = write_durably(path, image, temporary=temporary)
        except OSError as error:
            raise _refused(path, error) from error
        self._stored[record.set_index] = reference
        return StoredSet(
            file=reference,
            n_bytes=len(image),
            crc32={shot.sequence: waveform_crc32(shot.waveform) for shot in record.records},
            timings=StoreTimings(
                image_s=built - start, write_s=write_s, fsync_s=fsync_s, directory_fsync_s=directory_fsync_s
            ),
        )

    def set_aside(self, reference: SetReference) -> None:
        """Move a set that cannot be read out of the way, for a person to look at; nothing is deleted."""
        source, folder = self.folder / reference, self.folder / QUARANTINE_FOLDER
        try:
            folder.mkdir(exist_ok=True)
            target = folder / source.name
            while target.exists():  # a second one of this name: nothing is overwritten
                target = target.with_name(f"again_{target.name}")
            patiently(lambda: source.replace(target))
            for changed in (folder, source.parent, self.folder):
                sync_folder(changed)
        except OSError as error:
            raise _refused(source, error) from error
        self._stored = self.sets()

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

    def _check_free(self, reference: SetReference, set_index: int, image: bytes) -> None:
        """Nothing of this set is stored yet, or the very same bytes are."""
        path = self.folder / reference
        stored = self._stored.get(set_index, reference if path.exists() else None)
        if stored is not None and (stored != reference or read_shared(path) != image):
            raise ConflictingSetError(
                f"set {set_index} is stored already in {self.folder / stored} and differs; "
                "nothing stored is overwritten: take that file over with read_set, or move it out of "
                "the folder"
            )


def _refused(path: Path, error: OSError) -> ArchiveWriteError:
    remedy = _REMEDY.get(error.errno or 0, "check the disk and its connection")
    return ArchiveWriteError(
        f"{path} cannot be written: {error.strerror or error}; {remedy}, then start again"
    )
