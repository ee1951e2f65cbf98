"""Guard of the supply process, run by the supervisor.

The supply process switches an unsupervised supply off. If it is killed or hangs and no recorder replaces it,
the supervisor does so. It also checks periodically whether an output that was off has come on.
"""

from __future__ import annotations

import logging
from pathlib import Path

from daq_service.clock import MACHINE, MachineClock
from daq_service.corrosion_drive.remote import RemoteDrive
from daq_service.corrosion_drive.supply_state import read_stored_state
from daq_service.processes.data_folder import DRIVE_LOCK, is_held

log = logging.getLogger(__name__)

CHECK_EVERY_S = 5.0
"""Longer than the start of a supply process."""


class DriveGuard:
    """Keeps a supply process running where the output may be on; where it was off, starts one at intervals.

    Parameters
    ----------
    remote
        Drive with ``watches=False``: the process must not count it as a recorder.
    check_every_s
        Longest time without a check of an output that was read as off.
    """

    def __init__(
        self,
        folder: Path,
        remote: RemoteDrive,
        *,
        check_every_s: float,
        machine: MachineClock = MACHINE,
    ) -> None:
        """Count the output as checked now; nothing is started here."""
        self._folder, self._remote, self._machine = folder, remote, machine
        self._check_every_s = check_every_s
        self._next_s = self._checked_s = machine.mono_s()

    def check(self) -> None:
        """Start, connect to or replace the supply process if that is due, without waiting.

        While a process holds the supply's lock, or the lock cannot be read, the remote drive handles it.
        Without one, a process is started every `CHECK_EVERY_S` while the output may be on, else every
        ``check_every_s``.
        """
        now_s = self._machine.mono_s()
        if is_held(self._folder, DRIVE_LOCK) is not False:
            self._checked_s = now_s
            self._remote.tick()
            return
        if now_s < self._next_s:
            return
        self._next_s, stored_state = now_s + CHECK_EVERY_S, read_stored_state(self._folder)
        may_be_on = stored_state is not None and (
            stored_state.state.command is not None
            or stored_state.state.must_switch_off
            or stored_state.output != "off"
        )
        if may_be_on or now_s - self._checked_s >= self._check_every_s:
            log.info("no process of the drive runs: one is started to look at the output")
            self._remote.tick()
