"""Store sets: image in memory, temporary name, fsync, rename, fsync of the folder, acknowledgement."""

from __future__ import annotations

import contextlib
import errno
import time
from pathlib import Path

from daq_service.archive.durable_file import remove_quietly, sync_folder, write_durably
from daq_service.archive.errors import ArchiveWriteError, ConflictingSetError
from daq_service.archive.layout import build_image
from daq_service.archive.records import (
    SETS_FOLDER,
    TEMPORARY_SUFFIX,
    SetRecord,
    StoredSet,
    StoreTimings,
    set_file_name,
    set_files,
    waveform_crc32,
)

_REMEDY = {
    errno.ENOSPC: "free some space",
    errno.EDQUOT: "free some space or raise the quota",
    errno.EROFS: "make the disk writable again",
    errno.EACCES: "give this user the right to write there",
    errno.EPERM: "give this user the right to write there",
}


class Archive:
    """The sets of one data folder; the recorder's, who alone writes there.

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
        self.folder = folder
        self._sets_folder = folder / SETS_FOLDER
        try:
            self._sets_folder.mkdir(parents=True, exist_ok=True)
            sync_folder(folder)
            with contextlib.suppress(PermissionError):
                # A new data folder's own name; the folder above may belong to others.
                sync_folder(folder.absolute().parent)
            unfinished = list(self._sets_folder.glob(f"*{TEMPORARY_SUFFIX}"))
        except OSError as error:
            raise _refused(self._sets_folder, error) from error
        for path in unfinished:
            remove_quietly(path)
        self._stored = set_files(folder)

    def store_set(self, record: SetRecord) -> StoredSet:
        """Make a set durable; only when this returns is it acknowledged.

        Raises
        ------
        ConflictingSetError
            A file of this set with other content exists.
        ArchiveWriteError
            The disk refused; the set may be stored again.
        """
        start = time.perf_counter()
        image = build_image(record)
        built = time.perf_counter()
        path = self._sets_folder / set_file_name(record.set_index, record.due_utc_ns)
        temporary = path.with_suffix(TEMPORARY_SUFFIX)
        try:
            self._check_free(path, record.set_index, image)
            write_s, fsync_s, directory_fsync_s = write_durably(path, image, temporary=temporary)
        except OSError as error:
            raise _refused(path, error) from error
        self._stored[record.set_index] = path
        return StoredSet(
            path=path,
            file=f"{SETS_FOLDER}/{path.name}",
            n_bytes=len(image),
            crc32={shot.sequence: waveform_crc32(shot.waveform) for shot in record.records},
            timings=StoreTimings(
                image_s=built - start, write_s=write_s, fsync_s=fsync_s, directory_fsync_s=directory_fsync_s
            ),
        )

    def _check_free(self, path: Path, set_index: int, image: bytes) -> None:
        """Nothing of this set is stored yet, or the very same bytes are."""
        stored = self._stored.get(set_index, path if path.exists() else None)
        if stored is not None and (stored != path or stored.read_bytes() != image):
            raise ConflictingSetError(
                f"set {set_index} is stored already in {stored} and differs; nothing stored is overwritten: "
                "take that file over with read_set, or move it out of the folder"
            )


def _refused(path: Path, error: OSError) -> ArchiveWriteError:
    remedy = _REMEDY.get(error.errno or 0, "check the disk and its connection")
    return ArchiveWriteError(
        f"{path} cannot be written: {error.strerror or error}; {remedy}, then start again"
    )
