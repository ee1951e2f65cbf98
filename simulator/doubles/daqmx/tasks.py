"""Tasks and their states: unverified, verified, reserved, committed, running.

Starting goes through the states that are missing, stopping goes back to the state before the start.
What verifying, committing and running mean depends on the kind of task; each kind is a `TaskKind`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Protocol

from hardware_drivers.nanoseconds import NS_PER_S
from simulator.doubles.chassis.description import Description
from simulator.doubles.daqmx.devices import Device, Devices
from simulator.doubles.daqmx.lines import LineRecord
from simulator.doubles.daqmx.reservations import Holder, Reservations
from simulator.doubles.daqmx.strikes import Strikes
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import Status


class TaskState(IntEnum):
    """State of a task, in the order in which a task goes through them."""

    UNVERIFIED = 0
    VERIFIED = 1
    RESERVED = 2
    COMMITTED = 3
    RUNNING = 4


class Action(IntEnum):
    """Action of `DAQmxTaskControl`."""

    START = 0
    STOP = 1
    VERIFY = 2
    COMMIT = 3
    RESERVE = 4
    UNRESERVE = 5
    ABORT = 6


class Clock(Protocol):
    """Wall clock of the boards; tests replace it."""

    def now_ns(self) -> int:
        """Return the monotonic time in ns."""
        ...

    def wait(self, changed: threading.Condition, until_ns: int | None) -> None:
        """Wait on a condition that the caller holds, at most until a monotonic time in ns; None: no limit."""
        ...


class WallClock:
    """Clock with the machine's monotonic time."""

    def now_ns(self) -> int:
        """Return the system's monotonic time in ns."""
        return time.monotonic_ns()

    def wait(self, changed: threading.Condition, until_ns: int | None) -> None:
        """Wait on a condition that the caller holds, at most until a monotonic time in ns; None: no limit."""
        changed.wait(None if until_ns is None else max(until_ns - self.now_ns(), 0) / NS_PER_S)


@dataclass(slots=True, eq=False)
class Task:
    """Task of one client.

    Attributes
    ----------
    channel
        An `analog_input.InputChannel`, a `counter_output.PulseChannel` or a `watchdog.WatchedBoard`.
    settings
        What the client asked for, by attribute name.
    run
        What a running task is doing; kept after it ended until the task starts again.
    resume
        State that stopping goes back to.
    lost
        Status that every call answers since the board was reset or removed, 0 while all is well.
    n_starts
        How often it was started.
    verified
        The present settings have passed; a task can be reserved and yet have new ones.
    """

    handle: int
    name: str
    client: str
    kind: str = ""
    channel: Any = None
    settings: dict[str, Any] = field(default_factory=dict)
    state: TaskState = TaskState.UNVERIFIED
    resume: TaskState = TaskState.VERIFIED
    run: Any = None
    lost: int = 0
    n_starts: int = 0
    verified: bool = False

    @property
    def holder(self) -> Holder:
        """Return the holder in whose name the task reserves resources."""
        return Holder(client=self.client, task=self.name)

    @property
    def device(self) -> Device:
        """Return the board of the task's channel; raise AttributeError if it has no channel."""
        device: Device = self.channel.device
        return device

    def is_on(self, serial_number: int) -> bool:
        """Return whether the task uses the board with this serial number; False without a channel."""
        return self.channel is not None and self.device.serial_number == serial_number

    def require_empty(self) -> None:
        """Raise Status if the task runs or has a channel already; a task of the double has one channel."""
        self.require_not_running()
        if self.channel is not None:
            raise Status(
                statuses.INVALID_VALUE,
                f"The task has the channel {self.channel.name}; a task of the double has one.",
                task=self.name,
            )

    def set_channel(self, kind: str, channel: Any) -> None:
        """Set kind (``ai``, ``co``, ``watchdog``) and channel of the task, which becomes unverified."""
        self.kind, self.channel, self.state, self.verified = kind, channel, TaskState.UNVERIFIED, False

    def require_not_running(self) -> None:
        """Raise Status -200479 if the task runs."""
        if self.state is TaskState.RUNNING:
            raise Status(statuses.RUNNING, task=self.name)


class TaskKind(Protocol):
    """Behaviour of one kind of task in each state."""

    def verify(self, bench: Bench, task: Task) -> None:
        """Check the task's settings against the board; raise Status if they do not fit."""
        ...

    def resources(self, bench: Bench, task: Task) -> tuple[str, ...]:
        """Return the names of the parts of boards that the task must reserve."""
        ...

    def commit(self, bench: Bench, task: Task) -> None:
        """Program the board with the task's settings; called once its resources are reserved."""
        ...

    def start(self, bench: Bench, task: Task, now_ns: int) -> None:
        """Start the hardware of the task at a monotonic time in ns, without waiting for its end."""
        ...

    def triggered(self, bench: Bench, task: Task, at_ns: int) -> None:
        """Continue a started task at its start trigger, at a monotonic time in ns."""
        ...

    def stop(self, bench: Bench, task: Task, now_ns: int, cause: str) -> None:
        """Stop the task's hardware at a time in ns; ``cause`` is recorded with its level changes."""
        ...

    def done_ns(self, bench: Bench, task: Task) -> int | None:
        """Return the monotonic time in ns when the running task will be done; None while that is unknown."""
        ...


@dataclass(slots=True, eq=False)
class Bench:
    """Test bench with everything that changes; one lock guards it (`changed`)."""

    description: Description
    clock: Clock
    devices: Devices
    strikes: Strikes
    lines: LineRecord
    reservations: Reservations
    changed: threading.Condition
    kinds: dict[str, TaskKind]
    tasks: dict[int, Task] = field(default_factory=dict)
    routes: dict[str, str] = field(default_factory=dict)
    last_channel: dict[str, str] = field(default_factory=dict)
    next_handle: int = 0x10001

    def settle(self) -> int:
        """Process every watchdog and edge that is due, and return the present monotonic time in ns."""
        now_ns = self.clock.now_ns()
        for task in tuple(self.tasks.values()):
            if task.kind == "watchdog" and task.state is TaskState.RUNNING:
                task.run.settle(self, task, now_ns)
        self.lines.settle(now_ns)
        return now_ns


Arguments = Mapping[str, Any]
"""In parameters by name."""
Answer = Mapping[str, Any] | None
"""Out parameters by name; None where there are none to tell."""
Handler = Callable[[Bench, str, Arguments], Answer]
"""Answers an entry point for a client."""
TaskHandler = Callable[[Bench, Task, Arguments], Answer]
"""Answers an entry point that is about one task."""


def create_task(bench: Bench, client: str, name: str) -> Task:
    """Create a task of a client without a channel; an empty name is replaced by a generated one.

    Raise Status if the client has a task of that name.
    """
    taken = {task.name for task in bench.tasks.values() if task.client == client}
    if name in taken:
        raise Status(statuses.DUPLICATE_TASK, task=name)
    number = bench.next_handle
    bench.next_handle += 1
    task = Task(handle=number, name=name or f"_unnamedTask<{number - 0x10001:X}>", client=client)
    bench.tasks[number] = task
    return task


def find_task(bench: Bench, client: str, handle: int) -> Task:
    """Return a client's task by its handle.

    Raises
    ------
    Status
        No such task of this client (-200088), or its board was reset or removed (the cause at first, then
        -88709).
    """
    task = bench.tasks.get(handle)
    if task is None or task.client != client:
        raise Status(statuses.INVALID_TASK, f"Task handle: {handle:#x}")
    if task.lost:
        raise_lost_status(task)
    return task


def raise_lost_status(task: Task) -> None:
    """Raise the Status of a task that lost its board: the first time with the cause, from then on -88709."""
    code = task.lost
    task.lost = -88709
    raise Status(code, task=task.name)


def lose_board(bench: Bench, task: Task, code: int, cause: str) -> None:
    """Stop a task whose board is gone, release its resources, and let its next call fail with ``code``.

    Parameters
    ----------
    cause
        Cause that is recorded with the level changes.
    """
    if task.kind:
        bench.kinds[task.kind].stop(bench, task, bench.settle(), cause)
    bench.reservations.release(task.holder)
    task.state = task.resume = TaskState.UNVERIFIED
    task.lost = code
    bench.changed.notify_all()


def advance_task(bench: Bench, task: Task, target: TaskState) -> None:
    """Move a task forward to a state below running: verify, reserve and commit as needed.

    Raise Status if it has no channel or one of the steps fails; steps before it remain done.
    """
    if task.channel is None:
        raise Status(statuses.NO_CHANNELS, task=task.name)
    kind = bench.kinds[task.kind]
    if target >= TaskState.VERIFIED and not task.verified:
        kind.verify(bench, task)
        task.verified = True
        task.state = max(task.state, TaskState.VERIFIED)
    if task.state < TaskState.RESERVED <= target:
        bench.reservations.take(kind.resources(bench, task), task.holder)
        task.state = TaskState.RESERVED
    if task.state < TaskState.COMMITTED <= target:
        kind.commit(bench, task)
        task.state = TaskState.COMMITTED


def mark_changed(task: Task) -> None:
    """Mark a task as changed, so that its next start verifies and programs it again.

    A committed task becomes reserved. Raise Status -200479 if it runs.
    """
    task.require_not_running()
    if task.state is TaskState.COMMITTED:
        task.state = TaskState.RESERVED
    task.verified = False


def start_task(bench: Bench, task: Task) -> None:
    """Start a task, through the states that are missing, and wake up the calls that wait.

    Raise Status if it runs already or a step fails; then resources reserved only for this start are released.
    """
    task.require_not_running()
    task.resume = max(task.state, TaskState.VERIFIED)
    before = task.state
    try:
        advance_task(bench, task, TaskState.COMMITTED)
        bench.kinds[task.kind].start(bench, task, bench.settle())
    except Status:
        # What was only reserved for this start is given back.
        if before < TaskState.RESERVED <= task.state:
            _release_resources(bench, task)
        raise
    task.state = TaskState.RUNNING
    bench.changed.notify_all()


def is_task_done(bench: Bench, task: Task) -> bool:
    """Return whether a task is not running, or its record or pulse is complete.

    Raise Status if the twin cannot compute its record.
    """
    if task.state is not TaskState.RUNNING:
        return True
    now_ns = bench.settle()
    done_ns = bench.kinds[task.kind].done_ns(bench, task)
    return done_ns is not None and done_ns <= now_ns


def stop_task(bench: Bench, task: Task) -> None:
    """Stop a task and restore its state before the start; do nothing if it is not running.

    Raises
    ------
    Status
        The warning 200010, after the stop, if it was not done; never for a watchdog.
    """
    if task.state is not TaskState.RUNNING:
        return
    try:
        done = is_task_done(bench, task)
    except Status:
        # A record that the twin cannot compute must not keep its task from stopping.
        done = False
    _stop_hardware(bench, task)
    if not done and task.kind != "watchdog":
        raise Status(statuses.STOPPED_BEFORE_DONE, task=task.name)


def _stop_hardware(bench: Bench, task: Task) -> None:
    """Stop the hardware of a task and restore its state before the start, with its reservations."""
    bench.kinds[task.kind].stop(bench, task, bench.settle(), "stop")
    task.state = task.resume
    if task.state < TaskState.RESERVED:
        bench.reservations.release(task.holder)
    bench.changed.notify_all()


def control_task(bench: Bench, task: Task, action: int) -> None:
    """Execute an action of `DAQmxTaskControl` on a task.

    To verify, reserve or commit a running task does nothing; to abort stops it without a warning. Raise
    Status for an unknown action, if the step fails, or if a running task is to be unreserved.
    """
    match action:
        case Action.START:
            start_task(bench, task)
        case Action.STOP:
            stop_task(bench, task)
        case Action.VERIFY | Action.COMMIT | Action.RESERVE:
            if task.state is TaskState.RUNNING:
                return
            targets = {
                Action.VERIFY: TaskState.VERIFIED,
                Action.RESERVE: TaskState.RESERVED,
                Action.COMMIT: TaskState.COMMITTED,
            }
            advance_task(bench, task, targets[Action(action)])
        case Action.UNRESERVE:
            task.require_not_running()
            _release_resources(bench, task)
        case Action.ABORT:
            if task.state is TaskState.RUNNING:
                _stop_hardware(bench, task)
            _release_resources(bench, task)
        case _:
            raise Status(statuses.INVALID_VALUE, f"Task action {action}.", task=task.name)


def _release_resources(bench: Bench, task: Task) -> None:
    """Release the resources of a task and set it to verified; do nothing if it has reserved none."""
    if task.state >= TaskState.RESERVED:
        bench.reservations.release(task.holder)
        task.state = TaskState.VERIFIED
        bench.changed.notify_all()


def clear_task(bench: Bench, task: Task) -> None:
    """Stop a task without a warning, release its resources, remove it, and wake up waiting calls."""
    if task.state is TaskState.RUNNING:
        _stop_hardware(bench, task)
    _release_resources(bench, task)
    del bench.tasks[task.handle]
    bench.changed.notify_all()


def wait_until_done(bench: Bench, task: Task, timeout_s: float, expired: Status) -> None:
    """Block until a task is done or stopped, at most ``timeout_s``; a negative timeout has no limit.

    The caller holds the bench's lock, which is released while waiting.

    Raises
    ------
    Status
        ``expired`` at the deadline; the task's own if it loses its board, is cleared, or is started again.
    """
    deadline_ns = None if timeout_s < 0.0 else bench.clock.now_ns() + round(timeout_s * NS_PER_S)
    n_starts = task.n_starts
    while not is_task_done(bench, task):
        now_ns = bench.clock.now_ns()
        if deadline_ns is not None and now_ns >= deadline_ns:
            raise expired
        done_ns = bench.kinds[task.kind].done_ns(bench, task)
        moments = [moment for moment in (deadline_ns, done_ns) if moment is not None]
        bench.clock.wait(bench.changed, min(moments) if moments else None)
        if task.lost:
            raise_lost_status(task)
        if task.handle not in bench.tasks or task.n_starts != n_starts:
            raise Status(statuses.DEVICE_REMOVED, "The task was cleared meanwhile.", task=task.name)
