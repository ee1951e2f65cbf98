"""Watch of the volume of a data folder, and the reserve for an orderly stop."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from pathlib import Path

from daq_service.background.task import BackgroundTask
from daq_service.clock import MACHINE, MachineClock
from daq_service.processes.disk_policy import RESERVE_FILE, DiskSpace, Usage, disk_space, disk_usage, refusal
from daq_service.settings.tree import StorageSettings
from daq_service.shared_file import O_BINARY, remove_quietly, write_all

log = logging.getLogger(__name__)

LOOK_EVERY_S = 10.0
_CHUNK = bytes(2**20)


class DiskWatch(BackgroundTask):
    """Periodic check of the volume, and owner of the reserve file.

    Parameters
    ----------
    usage
        Free and total bytes; default: of the operating system.

    Attributes
    ----------
    space
        Newest measurement.
    on_change
        Called with the space when its level has changed.
    """

    def __init__(
        self,
        folder: Path,
        settings: StorageSettings,
        *,
        usage: Usage = disk_usage,
        machine: MachineClock = MACHINE,
    ) -> None:
        self._path, self._settings = folder / RESERVE_FILE, settings
        self._usage, self._machine = usage, machine
        self._next_s = -float("inf")
        self._reserve_bytes = settings.reserve_mb * 10**6
        self.space = DiskSpace(free_bytes=0, total_bytes=0, level="ample")
        self.on_change: Callable[[DiskSpace], None] = lambda space: None

    def run_for(self, seconds: float) -> None:
        """Measure the free space if it is due (`check`), and call `on_change` if its level has changed.

        It takes no noticeable time, so it may also run between shots; ``seconds`` is ignored.
        """
        if (space := self.check()) is not None:
            self.on_change(space)

    def close(self) -> None:
        """Remove the reserve file; an error of the disk is logged, not raised."""
        self.free_reserve()

    def check(self) -> DiskSpace | None:
        """Measure the free space, at most every `LOOK_EVERY_S`; return it if its level has changed.

        `space` is updated. The reserve file is allocated while more than twice its size is free (not at the
        level "stop"), and deleted below a quarter of it. Return None otherwise, also if the volume cannot be
        measured.
        """
        if self._machine.mono_s() < self._next_s:
            return None
        self._next_s, before = self._machine.mono_s() + LOOK_EVERY_S, self.space.level
        try:
            self.space = disk_space(self._path.parent, self._settings, before=before, usage=self._usage)
        except OSError as error:  # the folder is missing: writing there reports it
            log.debug("cannot ask how full %s is: %s", self._path.parent, error)
            return None
        if self.space.free_bytes < self._reserve_bytes // 4:
            self.free_reserve()
        elif self.space.level != "stop" and self.space.free_bytes > 2 * self._reserve_bytes:
            self._allocate_reserve()
        return None if self.space.level == before else self.space

    @property
    def refusal(self) -> str:
        """Return the reason why nothing can be stored, by the newest measurement; empty if there is room."""
        return refusal(self.space, self._settings)

    def free_reserve(self) -> None:
        """Delete the reserve file, if any, so that the data waiting in memory fit on the disk.

        An error of the disk is logged, not raised.
        """
        remove_quietly(self._path)

    def _allocate_reserve(self) -> None:
        """Allocate the reserve file with its full size, unless it exists with that size or the size is 0.

        An error of the disk is logged, not raised; a file that could not be allocated is removed.
        """
        try:
            if not self._reserve_bytes or self._path.stat().st_size == self._reserve_bytes:
                return
        except FileNotFoundError:
            pass
        except OSError as error:
            log.warning("the reserve %s cannot be read: %s", self._path, error)
            return
        try:
            descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | O_BINARY, 0o644)
            try:
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(descriptor, 0, self._reserve_bytes)
                else:
                    for first in range(0, self._reserve_bytes, len(_CHUNK)):
                        write_all(descriptor, [memoryview(_CHUNK)[: self._reserve_bytes - first]])
            finally:
                os.close(descriptor)
        except OSError as error:
            log.warning("no reserve of %d MB is kept: %s", self._reserve_bytes // 10**6, error)
            self.free_reserve()
