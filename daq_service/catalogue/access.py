"""Open the catalogue for reading on first use, for any thread."""

from __future__ import annotations

import threading
from pathlib import Path

from daq_service.catalogue.store import Catalogue, open_catalogue


class CatalogueAccess:
    """Opens the catalogue once it exists; all threads share it."""

    def __init__(self, folder: Path) -> None:
        """Store the data folder; open nothing yet."""
        self._folder = folder
        self._lock = threading.Lock()
        self._catalogue: Catalogue | None = None

    def get(self) -> Catalogue:
        """Return the catalogue that all threads share; open it on the first call.

        Raises
        ------
        NoDataYetError
            The recorder has not started the test yet.
        CatalogueError
            As `open_catalogue` for a reader; the next call tries again.
        """
        with self._lock:
            if self._catalogue is None:
                self._catalogue = open_catalogue(self._folder)
            return self._catalogue

    def close(self) -> None:
        """Close the catalogue, if it is open, for all threads; the next `get` opens it again."""
        with self._lock:
            if self._catalogue is not None:
                self._catalogue.close()
                self._catalogue = None
