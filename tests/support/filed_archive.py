"""An archive whose sets have their files at once, for tests of what reads files."""

from contextlib import suppress
from dataclasses import replace

from daq_service.archive import FolderArchive, SetNotFoundError, SetRecord, StoredSet
from daq_service.archive.finalize_set import finalize_set


class FiledArchive(FolderArchive):
    """Archive that writes each set to its file at once, and holds nothing open."""

    def store_set(self, record: SetRecord) -> StoredSet:
        stored = super().store_set(record)
        with suppress(SetNotFoundError):  # it has its file already
            finalize_set(self.folder, record.set_key, results=record.results)
        self.settle(record.set_key)
        self.close()
        return replace(stored, n_bytes=(self.folder / stored.file).stat().st_size)
