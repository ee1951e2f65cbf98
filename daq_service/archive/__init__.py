"""The archive: every acknowledged shot, one NeXus HDF5 file a set; the only door to HDF5.

`Archive.store_set` returns when a set is durable, never before. A later journal will make single
shots durable in front of it and hand the same `SetRecord` to the same `layout.build_image`.
"""

from __future__ import annotations

from daq_service.archive.errors import (
    ArchiveError,
    ArchiveWriteError,
    ConflictingSetError,
    CorruptArchiveError,
    SetNotFoundError,
)
from daq_service.archive.reader import Damage, read_set, read_waveform, verify_set
from daq_service.archive.records import (
    MissedRecord,
    PositionRecord,
    SetRecord,
    StoredSet,
    StoreTimings,
    set_file_name,
    set_files,
    waveform_crc32,
)
from daq_service.archive.writer import Archive

__all__ = [
    "Archive",
    "ArchiveError",
    "ArchiveWriteError",
    "ConflictingSetError",
    "CorruptArchiveError",
    "Damage",
    "MissedRecord",
    "PositionRecord",
    "SetNotFoundError",
    "SetRecord",
    "StoreTimings",
    "StoredSet",
    "read_set",
    "read_waveform",
    "set_file_name",
    "set_files",
    "verify_set",
    "waveform_crc32",
]
