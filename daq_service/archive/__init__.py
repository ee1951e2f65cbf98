"""The archive: every acknowledged shot, one NeXus HDF5 file a set; the only package that uses HDF5.

`Archive.store_set` returns when a set is durable, never before. `protocol` defines an archive, `writer`
and `reader` keep it in a folder; readers use a `SetReader` and a set's reference.
"""

from __future__ import annotations

from daq_service.archive.errors import (
    ArchiveError,
    ArchiveWriteError,
    ConflictingSetError,
    CorruptArchiveError,
    SetNotFoundError,
)
from daq_service.archive.protocol import Archive, SetReader
from daq_service.archive.reader import FolderSetReader
from daq_service.archive.records import (
    Damage,
    OpenSet,
    Places,
    SetReference,
    SetTables,
    StoredSet,
    StoreTimings,
    parse_due_utc_ns,
)
from daq_service.archive.writer import FolderArchive
from hardware_drivers.measurement import PositionRecord, Results, SetRecord, compute_crc32

__all__ = [
    "Archive",
    "ArchiveError",
    "ArchiveWriteError",
    "ConflictingSetError",
    "CorruptArchiveError",
    "Damage",
    "FolderArchive",
    "FolderSetReader",
    "OpenSet",
    "Places",
    "PositionRecord",
    "Results",
    "SetNotFoundError",
    "SetReader",
    "SetRecord",
    "SetReference",
    "SetTables",
    "StoreTimings",
    "StoredSet",
    "compute_crc32",
    "parse_due_utc_ns",
]
