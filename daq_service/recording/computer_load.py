"""Load of the computer and of the recorder, stored with each set (decision 28): not computable later."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from daq_service.clock import WallClock
from daq_service.clock.machine import is_synchronised
from daq_service.processes.disk_policy import DiskSpace
from daq_service.processes.resource_use import open_handles, resident_bytes
from hardware_drivers.instruments import Clock
from hardware_drivers.nanoseconds import NS_PER_S

MACHINE_READ = "machine_read"
"""Event of topic ``machine`` whose payload is a `ComputerLoad`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ComputerLoad:
    """State of the recorder's process and its computer at the end of a set; None: not available here.

    Attributes
    ----------
    process, recorder_wall_utc_ns
        The recorder: its number, and when it started by the computer's clock. Together they name it.
    stage_s
        Wall time by stage of the line (`recorder.Cost`) since this recorder's reading before.
    resident_bytes, open_handles
        Of the recorder's process.
    free_bytes, total_bytes
        Of the volume of the data folder.
    clock_ahead_s
        The computer's UTC less the test's time; None on a simulated clock.
    clock_synchronised
        Whether the system reports its UTC as synchronized; None on a simulated clock.
    files_read
        Stored sets that this recorder has read again while nothing was due.
    """

    process: int
    recorder_wall_utc_ns: int
    stage_s: dict[str, float] = field(default_factory=dict)
    resident_bytes: int | None = None
    open_handles: int | None = None
    free_bytes: int | None = None
    total_bytes: int | None = None
    clock_ahead_s: float | None = None
    clock_synchronised: bool | None = None
    files_read: int | None = None


class ComputerLoadWatch:
    """Reads all of it at the end of each set: some calls of the system, well below a millisecond.

    Parameters
    ----------
    space
        The volume as it was found last.
    files_read
        How many stored sets were read again so far.
    """

    def __init__(
        self,
        clock: Clock,
        *,
        space: Callable[[], DiskSpace],
        files_read: Callable[[], int],
        system_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        """Take the present computer time (``system_ns``, ns of UTC) as the start of the recorder."""
        self._clock, self._space, self._files_read, self._system_ns = clock, space, files_read, system_ns
        self._started_ns = system_ns()
        self._last_seconds: dict[str, float] = {}

    def read(self, seconds: Mapping[str, float]) -> dict[str, Any]:
        """Read the load now and return the payload of its event, the columns of `ComputerLoad`.

        ``seconds`` is the wall time so far by stage; stored are the differences from the last call.
        """
        space, before = self._space(), self._last_seconds
        self._last_seconds = dict(seconds)
        real = isinstance(self._clock, WallClock)
        ahead_s = (self._system_ns() - self._clock.utc_ns()) / NS_PER_S if real else None
        reading = ComputerLoad(
            process=os.getpid(),
            recorder_wall_utc_ns=self._started_ns,
            stage_s={name: round(s - before.get(name, 0.0), 6) for name, s in seconds.items()},
            resident_bytes=resident_bytes(),
            open_handles=open_handles(),
            free_bytes=space.free_bytes if space.total_bytes else None,
            total_bytes=space.total_bytes or None,
            clock_ahead_s=ahead_s,
            clock_synchronised=is_synchronised() if real else None,
            files_read=self._files_read(),
        )
        return asdict(reading)
