"""Errors of the catalogue.

::

    StorageError
    └── CatalogueError
        ├── NoDataYetError           nothing is recorded here yet: wait for the recorder
        ├── NetworkFolderError       the folder is on a network file system
        ├── OtherExperimentError     the folder belongs to another configuration
        ├── SchemaVersionError       made by another version of solimon
        ├── CatalogueBusyError       another process writes for longer than the deadline
        ├── CatalogueDamagedError    the file is no whole SQLite database
        ├── CatalogueWriteError      full or failing disk, read-only folder
        └── CatalogueConflictError   such a row exists, or lacks what it belongs to
"""

from __future__ import annotations

import sqlite3
from pathlib import Path

from daq_service.errors import StorageError, StorageUnavailableError

REMEDY = "`solimon rebuild` makes a new one from sets, journal and history, and keeps this one"
BUSY_TIMEOUT_S = 5.0
"""Wait of a writer for another one; a set's commit takes milliseconds."""


class CatalogueError(StorageError):
    """The catalogue cannot be opened, read or written."""


class NoDataYetError(CatalogueError):
    """Nothing has been recorded in this folder yet.

    Attributes
    ----------
    folder
        Of the test, where its catalogue may be lost instead; None: nothing of a test is there.
    """

    def __init__(self, message: str, folder: Path | None = None) -> None:
        """Store the message, and the folder whose catalogue may be lost."""
        super().__init__(message)
        self.folder = folder


class NetworkFolderError(CatalogueError):
    """SQLite's locks and shared memory do not work over a network."""


class OtherExperimentError(CatalogueError):
    """The folder belongs to another configuration."""


class SchemaVersionError(CatalogueError):
    """The catalogue was made by another version of solimon."""


class CatalogueBusyError(CatalogueError, StorageUnavailableError):
    """Another writer held the catalogue for longer than the deadline."""


class CatalogueDamagedError(CatalogueError):
    """The file is not a whole SQLite database."""


class CatalogueWriteError(CatalogueError, StorageUnavailableError):
    """The disk refused a change; nothing of it was stored."""


class CatalogueConflictError(CatalogueError):
    """A change contradicts what is stored; nothing of it was stored."""


def translate_driver_error(path: Path, action: str, error: BaseException | None) -> CatalogueError:
    """Return the catalogue's error for an error of the SQLite driver; it is not raised here.

    The error code selects the class; an error without a code counts as a damaged file.
    """
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    message = f"{path}: {action} failed: {error}"
    if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return CatalogueBusyError(f"{message} for {BUSY_TIMEOUT_S:g} s; end the program that holds it")
    # The queries never change: they fail for a missing or invalid value in a corrupt file only.
    if code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR, 0):
        return CatalogueDamagedError(f"{message}; {REMEDY}")
    if code in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
        return CatalogueWriteError(f"{message}; nothing of it was stored: free disk space or repair the disk")
    if code in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM):
        return CatalogueWriteError(f"{message}; give this user the right to write the folder")
    if code == sqlite3.SQLITE_CONSTRAINT:
        return CatalogueConflictError(
            f"{message}; nothing was stored: such a row exists, or lacks what it belongs to"
        )
    return CatalogueError(message)
