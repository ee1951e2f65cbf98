"""The computer that a recorder runs on: its clocks, its worker process, its volume."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass

from daq_service.clock import Before, WallClock
from daq_service.commands.execution import LISTEN_EVERY_S
from daq_service.processes.disk_policy import Usage, disk_usage
from daq_service.processes.worker import one_worker
from daq_service.recording.opening import WAITS_FOR_RIG_S
from hardware_drivers.instruments import Clock

LOOK_EVERY_S = 0.1
"""How often a recorder that can do nothing else looks for commands, and whether the disk takes what waits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Host:
    """What only tests replace.

    Attributes
    ----------
    mono_s
        Monotonic clock in seconds.
    wall_clock
        Makes the clock of a test in real time, from what is known of the time before.
    worker
        Makes the executor in which sets get their files.
    disk_usage
        Returns free and all bytes of the folder's volume.
    look_every_s
        Pause between two looks while everything else waits.
    listen_every_s
        Shortest time between two looks for commands.
    waits_for_rig_s
        Wait before each further try to open the rig of a test that was started before; the last one repeats.
    """

    mono_s: Callable[[], float] = time.monotonic
    wall_clock: Callable[[Before], Clock] = WallClock
    worker: Callable[[], Executor] = one_worker
    disk_usage: Usage = disk_usage
    look_every_s: float = LOOK_EVERY_S
    listen_every_s: float = LISTEN_EVERY_S
    waits_for_rig_s: tuple[float, ...] = tuple(WAITS_FOR_RIG_S)


THIS_COMPUTER = Host()
