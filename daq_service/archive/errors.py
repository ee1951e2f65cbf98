"""Errors of the archive.

::

    StorageError
    └── ArchiveError
        ├── ArchiveWriteError      full or failing disk, read-only folder: the set is not stored
        ├── ArchiveReadError       no permission, no free handle: the file may be sound
        ├── ConflictingSetError    another file of this set is there already
        ├── CorruptArchiveError    a file is corrupt or is not a set; names the shot
        └── SetNotFoundError       no such file or shot
"""

from __future__ import annotations

from daq_service.errors import StorageError, StorageUnavailableError

BACK = "bring it back from a backup: solimon repair --from BACKUP"
"""Remedy for a corrupt or missing file."""


class ArchiveError(StorageError):
    """A set cannot be stored or read."""


class ArchiveWriteError(ArchiveError, StorageUnavailableError):
    """The operating system rejected a write; the set is not acknowledged."""


class ArchiveReadError(ArchiveError, StorageUnavailableError):
    """The operating system rejected a read; the file may be sound."""


class ConflictingSetError(ArchiveError):
    """Another file with this set's name exists; stored data are never overwritten."""


class CorruptArchiveError(ArchiveError):
    """A file or a shot in it does not match its checksums."""


class SetNotFoundError(ArchiveError):
    """The archive has no such set or shot."""
