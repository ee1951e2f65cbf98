"""Errors of the archive.

::

    StorageError
    └── ArchiveError
        ├── ArchiveWriteError      full or failing disk, read-only folder: the set is not stored
        ├── ArchiveReadError       no right, no free handle: nothing is known of the file
        ├── ConflictingSetError    another file of this set is there already
        ├── CorruptArchiveError    a file is damaged or no set of ours; names the shot
        └── SetNotFoundError       no such file or shot
"""

from __future__ import annotations

from daq_service.errors import StorageError, StorageUnavailableError

BACK = "bring it back from a backup: solimon repair --from BACKUP"
"""What helps a file that is damaged or gone."""


class ArchiveError(StorageError):
    """A set cannot be stored or read."""


class ArchiveWriteError(ArchiveError, StorageUnavailableError):
    """The operating system refused; the set is not acknowledged."""


class ArchiveReadError(ArchiveError, StorageUnavailableError):
    """The operating system does not let us read; the file may be sound."""


class ConflictingSetError(ArchiveError):
    """Another file with this set's name exists; stored data are never overwritten."""


class CorruptArchiveError(ArchiveError):
    """A file or a shot in it does not match its checksums."""


class SetNotFoundError(ArchiveError):
    """There is no such set or shot in the archive."""
