"""Free space of the volume of a data folder: levels and forecast."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from daq_service.acquisition.schedule import list_due_hours
from daq_service.archive.waterfall.tiles import estimate_tile_bytes, list_tile_cells
from daq_service.catalogue import Catalogue
from daq_service.catalogue.connection import FILE_NAME
from daq_service.settings.tree import ScheduleSettings, StorageSettings

RESERVE_FILE = "reserve"
LEAVES_AT = 1.1
"""Hysteresis: a level ends a tenth above its limit."""
Level = Literal["ample", "warn", "alarm", "stop"]
LEVELS: tuple[Level, ...] = ("ample", "warn", "alarm", "stop")

Usage = Callable[[Path], tuple[int, int]]
"""Returns the free and the total bytes of the volume of a folder."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DiskSpace:
    """Free and total bytes of the volume at a moment, and the free bytes below which recording stops."""

    free_bytes: int
    total_bytes: int
    level: Level
    stop_bytes: float = 0.0

    @property
    def description(self) -> str:
        """Return the free space as a phrase: GB (10^9 bytes) and share of the volume."""
        share = self.free_bytes / self.total_bytes if self.total_bytes else 0.0
        return f"{self.free_bytes / 1e9:.2f} GB ({share:.1%}) of the volume are free"


def disk_usage(folder: Path) -> tuple[int, int]:
    """Return the free and the total bytes of the volume of a folder, or of its nearest existing parent.

    Raises OSError if the system does not report them.
    """
    usage = shutil.disk_usage(next(path for path in (folder, *folder.parents) if path.exists()))
    return usage.free, usage.total


def disk_space(
    folder: Path, settings: StorageSettings, *, before: Level = "ample", usage: Usage = disk_usage
) -> DiskSpace:
    """Measure the free space of a folder's volume and determine its level (`LEVELS`).

    ``before`` is the level of the measurement before: it ends only above 1.1 times its limit (`LEAVES_AT`).
    Fractions refer to the volume, or to ``volume_gb`` if that is smaller. Raises the OSError of ``usage``.
    """
    free, total = usage(folder)
    limited_bytes = min(total, settings.volume_gb * 1e9)
    limits: dict[Level, float] = {
        "stop": settings.stop_free_fraction,
        "alarm": settings.alarm_free_fraction,
        "warn": settings.warn_free_fraction,
    }
    level: Level = "ample"
    for name, fraction in limits.items():
        limit = fraction * limited_bytes
        if free < limit * (LEAVES_AT if LEVELS.index(before) >= LEVELS.index(name) else 1.0):
            level = name
            break
    return DiskSpace(
        free_bytes=free, total_bytes=total, level=level, stop_bytes=limits["stop"] * limited_bytes
    )


def refusal(space: DiskSpace, settings: StorageSettings) -> str:
    """Return the reason why nothing is stored now, with the remedy; empty unless the level is ``stop``."""
    if space.level != "stop":
        return ""
    return (
        f"{space.description}, and below {settings.stop_free_fraction:.0%} (storage.stop_free_fraction) "
        "nothing is stored: free disk space; the test then continues"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Outlook(DiskSpace):
    """Forecast of the disk space until the end of the test.

    Attributes
    ----------
    needed_bytes
        Demand of the remaining schedule, from the newest set file, the rows of the catalogue and the tiles;
        None before the first file.
    full_at_h
        Hour of the test at which recording stops; None: the remaining sets fit, or it is unknown.
    """

    needed_bytes: int | None = None
    full_at_h: float | None = None


def forecast_disk(
    folder: Path,
    storage: StorageSettings,
    schedule: ScheduleSettings,
    catalogue: Catalogue,
    usage: Usage = disk_usage,
) -> Outlook:
    """Forecast from the size of the newest set whether the remaining sets of the test fit on the disk.

    Without a set file (no set yet, or still in the journal) ``needed_bytes`` and ``full_at_h`` are None.
    Raises the OSError of ``usage`` and of a file that vanishes, and CatalogueError if the catalogue cannot be
    read.
    """
    space, newest = disk_space(folder, storage, usage=usage), catalogue.read_newest_recorded()
    forecast = Outlook(**asdict(space))
    path = folder / ((newest and newest.file) or "")
    if not path.is_file():  # the set is still in the journal
        return forecast
    counts = catalogue.counts()
    n_done = counts["sets"] + counts["missed_sets"]
    planned_h = list_due_hours(schedule.phases, end_h=schedule.end_h)
    remaining_h = planned_h[n_done:]
    tiles = sum(estimate_tile_bytes(n_cells, len(planned_h)) for n_cells in list_tile_cells(folder)) / max(
        1, len(planned_h)
    )
    bytes_per_set = path.stat().st_size + tiles + (folder / FILE_NAME).stat().st_size / max(1, n_done)
    n_fitting = int(max(0.0, space.free_bytes - space.stop_bytes) / bytes_per_set)
    return replace(
        forecast,
        needed_bytes=round(len(remaining_h) * bytes_per_set),
        full_at_h=remaining_h[n_fitting] if n_fitting < len(remaining_h) else None,
    )
