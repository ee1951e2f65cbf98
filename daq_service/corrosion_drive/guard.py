"""The supervisor's part in the drive: the supply keeps a process that supervises it.

The drive's process switches an unwatched supply off. If it is killed or hangs and the recorder, which is gone
or hangs, does not replace it, the supervisor does so; and it looks from time to time whether an output that
was left off has come on.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from pathlib import Path

from daq_service.corrosion_drive.remote import RemoteDrive
from daq_service.corrosion_drive.supply_state import read_kept
from daq_service.processes.data_folder import DRIVE_LOCK, is_owned

log = logging.getLogger(__name__)

LOOK_EVERY_S = 5.0
"""Longer than a process takes to own the port."""


class DriveGuard:
    """Keeps a process of the drive where the output may be on, and starts one at intervals where it was off.

    Parameters
    ----------
    remote
        Does not watch: for the process no recorder is there.
    check_every_s
        Longest time without a look at an output that was read as off.
    """

    def __init__(
        self,
        folder: Path,
        remote: RemoteDrive,
        *,
        check_every_s: float,
        mono_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._folder, self._remote, self._mono_s = folder, remote, mono_s
        self._check_every_s = check_every_s
        self._next_s = self._checked_s = mono_s()

    def look(self) -> None:
        """Start, meet or replace the process, if that is due."""
        now_s = self._mono_s()
        if is_owned(self._folder, DRIVE_LOCK) is not False:
            self._checked_s = now_s
            self._remote.tick()
            return
        if now_s < self._next_s:
            return
        self._next_s, kept = now_s + LOOK_EVERY_S, read_kept(self._folder)
        may_be_on = kept is not None and (
            kept.state.command is not None or kept.state.must_switch_off or kept.output != "off"
        )
        if may_be_on or now_s - self._checked_s >= self._check_every_s:
            log.info("no process of the drive runs: one is started to look at the output")
            self._remote.tick()
