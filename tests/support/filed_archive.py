"""An archive whose sets have their files at once, for tests of what reads files."""

from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from daq_service.archive import FolderArchive, SetNotFoundError, SetRecord, StoredSet
from daq_service.archive.finalize_set import compact_set


class FiledArchive(FolderArchive):
    """Archive that writes each set to its file at once, and holds nothing open."""

    def store_set(self, record: SetRecord) -> StoredSet:
        stored = super().store_set(record)
        with suppress(SetNotFoundError):  # it has its file already
            compact_set(self.folder, record.set_key, results=record.results)
        self.settle(record.set_key)
        self.close()
        return replace(stored, n_bytes=(self.folder / stored.file).stat().st_size)


def append_set(archive: FolderArchive, record: SetRecord) -> None:
    """Append the records of a set to the journal; the set stays open."""
    archive.begin_set(
        record.set_key, due_utc_ns=record.due_utc_ns, started_utc_ns=record.started_utc_ns, retired={}
    )
    for item in record.records:
        archive.append(item, item.stamp.utc_ns)


@contextmanager
def journal_of(folder: Path, record: SetRecord) -> Iterator[FolderArchive]:
    """Open an archive whose journal has this set, which has no file yet."""
    with closing(FolderArchive(folder)) as archive:
        append_set(archive, record)
        archive.store_set(record)
        yield archive
