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

from pathlib import Path

from daq_service.errors import StorageError, StorageUnavailableError


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
