"""While a test's recorder is gone for good: a supply that was left on keeps a process that owns it.

The drive's process switches an unwatched supply off. If it is killed beforehand and no recorder is there to
start another one, the supervisor that serves the test on does so.
"""

from __future__ import annotations

import logging
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

from daq_service.corrosion_drive.kept import look_at_drive

log = logging.getLogger(__name__)

LOOK_EVERY_S = 5.0
"""Longer than a process takes to own the port."""


class DriveGuard:
    """Starts the process of the drive again where the last one was killed and did not leave the output off.

    Parameters
    ----------
    start
        Starts a process that outlives this one.
    """

    def __init__(
        self,
        folder: Path,
        start: Callable[[], subprocess.Popen[bytes]],
        *,
        mono_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._folder, self._start, self._mono_s = folder, start, mono_s
        self._next_s = mono_s()
        self._process: subprocess.Popen[bytes] | None = None

    def look(self) -> None:
        """Look, at most every few seconds."""
        now_s = self._mono_s()
        if now_s < self._next_s or (self._process is not None and self._process.poll() is None):
            return
        self._next_s, self._process = now_s + LOOK_EVERY_S, None
        drive = look_at_drive(self._folder)
        if drive is None or drive.process is not False or drive.last == "off":
            return
        log.error("the process of the drive is gone, and the output was %s: another one starts", drive.last)
        self._process = self._start()
