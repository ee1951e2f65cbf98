"""A catalogue without rows, migrated once a process: a migration takes longer than many a test."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from daq_service.catalogue import open_catalogue


@cache
def empty_catalogue() -> bytes:
    """Return the content of an empty catalogue file."""
    with tempfile.TemporaryDirectory() as place:
        with open_catalogue(Path(place), writer=True):
            pass
        return (Path(place) / "catalogue.sqlite").read_bytes()
