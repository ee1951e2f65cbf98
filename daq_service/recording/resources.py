"""What a recorder works with: its test, its data folder, its instruments and its computer."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import cached_property

from daq_service.acquisition.schedule import plan_sets
from daq_service.alarms.states import Moment
from daq_service.archive import Archive
from daq_service.background.disk_watch import DiskWatch
from daq_service.background.finalize_sets import SetFinalizer
from daq_service.background.live_figure import LiveFigure
from daq_service.background.task import BackgroundTask
from daq_service.background.verification import IdleVerification
from daq_service.catalogue import RecorderCatalogue
from daq_service.clock import MACHINE, Before, MachineClock, WallClock
from daq_service.corrosion_drive.remote import RemoteDrive
from daq_service.processes.disk_policy import Usage, disk_usage
from daq_service.processes.heartbeat import Heartbeat, WebWatch
from daq_service.processes.worker import start_one_worker
from daq_service.recording.computer_load import ComputerLoadWatch
from daq_service.recording.opening import WAITS_FOR_RIG_S
from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Clock, Rig
from hardware_drivers.measurement import DueSet
from hardware_drivers.nanoseconds import NS_PER_H

LISTEN_EVERY_S = 0.2
"""A person does not notice a fifth of a second; SQLite does not notice five queries a second."""
Reporter = Callable[..., None]
"""Called with the name of an event and its values: ``beat``, ``begun`` (first set is due or awaited),
``due`` (time of the first set, in real time), ``progress``, ``alarm``, ``gap``, ``finished``, ``waits`` (for
the rig, whose alarm is active)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Host:
    """The computer: its clocks, its worker process and its volume; only tests replace them.

    Attributes
    ----------
    machine
        Times of the computer.
    wall_clock
        Makes the clock of a test in real time, from what is known of the time before.
    worker
        Makes the executor in which sets get their files.
    disk_usage
        Returns free and all bytes of the folder's volume.
    look_every_s
        Pause between two looks while a recorder can only wait.
    listen_every_s
        Shortest time between two looks at commands and web service.
    waits_for_rig_s
        Wait before each further try to open the rig of a test that was started before; the last one repeats.
    """

    machine: MachineClock = MACHINE
    wall_clock: Callable[[Before], Clock] = WallClock
    worker: Callable[[], Executor] = start_one_worker
    disk_usage: Usage = disk_usage
    look_every_s: float = 0.1
    listen_every_s: float = LISTEN_EVERY_S
    waits_for_rig_s: Sequence[float] = WAITS_FOR_RIG_S


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOptions:
    """How a recorder is started.

    Attributes
    ----------
    restart_reason
        What ended the recorder before, as far as the supervisor knows.
    linger
        Stay after the last set and execute commands (acknowledgements) until ``stop``.
    unsupervised
        Set where ``stop`` is, because the supervisor is gone.
    acknowledged
        Called with the id of each shot (`Shot.sequence`) once it is durable.
    remote_drive
        The supply in a process of its own; None: the rig's supply, where it has one, is driven here.
    """

    restart_reason: str = ""
    linger: bool = False
    unsupervised: threading.Event = field(default_factory=threading.Event)
    acknowledged: Callable[[int], None] = lambda shot_id: None
    remote_drive: RemoteDrive | None = None


THIS_COMPUTER, PLAIN = Host(), SessionOptions()


@dataclass(frozen=True, kw_only=True)
class Resources:
    """What the parts of a recorder share.

    Attributes
    ----------
    finalizer, verification, disk, further_tasks
        Work between sets, in this order.
    computer_load
        Reads with each set what the test costs its computer.
    web
        Watches the web service of the folder.
    """

    settings: Settings
    archive: Archive
    catalogue: RecorderCatalogue
    rig: Rig
    heartbeat: Heartbeat
    live: LiveFigure
    stop: threading.Event
    report: Reporter
    options: SessionOptions = PLAIN
    host: Host = THIS_COMPUTER
    finalizer: SetFinalizer | None = None
    verification: IdleVerification | None = None
    disk: DiskWatch | None = None
    further_tasks: Sequence[BackgroundTask] = ()
    computer_load: ComputerLoadWatch | None = None
    web: WebWatch | None = None

    @property
    def tasks(self) -> list[BackgroundTask]:
        """Return the background tasks between sets that this recorder has, in their order."""
        tasks = (self.finalizer, self.verification, self.disk, *self.further_tasks)
        return [task for task in tasks if task is not None]

    @cached_property
    def epoch_ns(self) -> int:
        """Return hour 0 of the test in ns of UTC; read once, NoDataYetError before the test starts."""
        return self.catalogue.read_experiment().epoch_utc_ns

    @cached_property
    def plan(self) -> Sequence[DueSet]:
        """Return every scheduled set in order; the set of index k is the k-th. Computed once."""
        schedule = self.settings.schedule
        return plan_sets(schedule.phases, self.epoch_ns, end_h=schedule.end_h)

    @property
    def in_real_time(self) -> bool:
        """Return whether the test runs by the wall clock, which advances while the recorder waits."""
        return self.settings.clock.kind == "wall"

    def moment(self) -> Moment:
        """Return the present moment of the test: UTC in ns and hour, without a set."""
        return build_present_moment(self.rig.clock, self.epoch_ns)


def build_present_moment(clock: Clock, epoch_ns: int) -> Moment:
    """Return the present moment of a test whose hour 0 is ``epoch_ns`` (ns of UTC), without a set."""
    now_ns = clock.utc_ns()
    return Moment(utc_ns=now_ns, due_h=(now_ns - epoch_ns) / NS_PER_H, set_index=None)
