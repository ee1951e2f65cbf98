"""Files of a data folder for tests: by path, through the archive's reader."""

from __future__ import annotations

from pathlib import Path

from daq_service.archive import Damage, FolderSetReader, SetRecord, SetReference
from hardware_drivers.measurement import Waveform


def set_files(folder: Path) -> dict[int, Path]:
    """Return the files of the scheduled sets by index."""
    files = FolderSetReader(folder).sets().items()
    return {key.set_index: folder / reference for key, reference in files if not key.unscheduled_index}


def read_set(path: Path, *, skip_damaged: bool = False) -> SetRecord:
    return FolderSetReader(path.parent).read_set(SetReference(path.name), skip_damaged=skip_damaged)


def read_waveform(path: Path, position: str, shot_index: int) -> Waveform:
    return FolderSetReader(path.parent).read_waveform(SetReference(path.name), position, shot_index)


def verify_set(path: Path) -> list[Damage]:
    return FolderSetReader(path.parent).verify_set(SetReference(path.name))
