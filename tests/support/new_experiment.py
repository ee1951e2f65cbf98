"""A data folder whose experiment has started: the catalogue as it is before the first set."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

from daq_service.catalogue import RecorderCatalogue, open_catalogue
from daq_service.catalogue.connection import FILE_NAME


@cache
def _file() -> bytes:
    """Return its file, made once: migrations take a fifth of a second."""
    with tempfile.TemporaryDirectory() as folder:
        with open_catalogue(Path(folder), writer=True) as catalogue:
            catalogue.create_experiment(
                name="test",
                configuration_hash="0",
                configuration={},
                epoch_utc_ns=0,
                clock="simulated",
                solimon_version="0",
            )
        return (Path(folder) / FILE_NAME).read_bytes()


def new_catalogue(folder: Path) -> RecorderCatalogue:
    """Open the recorder's catalogue of a new experiment; the caller closes it."""
    (folder / FILE_NAME).write_bytes(_file())
    return open_catalogue(folder, writer=True)


def add_events(catalogue: RecorderCatalogue, *kinds: str) -> None:
    """Add consecutive events of the recorder."""
    for kind in kinds:
        catalogue.add_service_event(utc_ns=0, kind=kind, payload={})
