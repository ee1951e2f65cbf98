"""Watchdog timer of X Series boards: lines go to a safe level when it is not reset in time.

The lines it was given, and no others: a counter's pulse at another pin runs to its end.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hardware_drivers.nanoseconds import NS_PER_S
from simulator.doubles.chassis.boards import find_line_terminal
from simulator.doubles.daqmx import tasks
from simulator.doubles.daqmx.counter_output import HIGH, LOW, disconnect_pin
from simulator.doubles.daqmx.devices import Device
from simulator.doubles.daqmx.reservations import format_resource
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench, Handler, Task, TaskHandler, TaskState
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import Status

RESET_TIMER = 0
CLEAR_EXPIRATION = 1
NO_CHANGE = 10160
TRISTATE = 10310
"""Of a line: no one drives it, its pull-down takes it low."""
LONGEST_TIMEOUT_S = (2**32 - 1) * 8e-9
"""X Series: 32 bits of 8 ns (X Series user manual, chapter 6, "Watchdog Timer")."""
NEVER = -1.0


@dataclass(slots=True, eq=False)
class WatchedBoard:
    """Board of a watchdog task, which has no channels."""

    name: str
    device: Device


@dataclass(slots=True, eq=False)
class Countdown:
    """Running watchdog."""

    begin_ns: int | None
    timeout_s: float
    expired_ns: int | None = None

    def settle(self, bench: Bench, task: Task, now_ns: int) -> None:
        """Expire the watchdog if its timeout has passed by ``now_ns``; its lines take their safe levels.

        The recorded time is that of the expiration, whenever this is called. A pulse on a watched line is
        cut.
        """
        if self.expired_ns is not None or self.begin_ns is None or self.timeout_s == NEVER:
            return
        deadline_ns = self.begin_ns + round(self.timeout_s * NS_PER_S)
        if deadline_ns > now_ns:
            return
        bench.lines.settle(deadline_ns)
        self.expired_ns = deadline_ns
        device, states = task.device, task.settings["expiration"]
        levels = {
            f"{device.serial_number}/{find_line_terminal(line)}": int(state == HIGH)
            for line, state in states.items()
            if state != NO_CHANGE
        }
        for other in tuple(bench.tasks.values()):
            if other.kind == "co" and other.run is not None and other.channel.line in levels:
                disconnect_pin(bench, other, levels[other.channel.line], deadline_ns, "watchdog")
        for line, level in levels.items():
            bench.lines.drive(line, level, deadline_ns, "watchdog")


class Watchdog:
    """Watchdog timer as a `tasks.TaskKind`."""

    def verify(self, bench: Bench, task: Task) -> None:
        """Do nothing: the timeout was checked when it was set."""

    def resources(self, bench: Bench, task: Task) -> tuple[str, ...]:
        """Return the resource that the task needs: the one watchdog timer of its board."""
        return (format_resource(task.device.serial_number, "watchdog"),)

    def commit(self, bench: Bench, task: Task) -> None:
        """Do nothing: no line is driven before the timer expires."""

    def start(self, bench: Bench, task: Task, now_ns: int) -> None:
        """Start the countdown now with the configured timeout in s."""
        task.n_starts += 1
        task.run = Countdown(begin_ns=now_ns, timeout_s=task.settings["Watchdog.Timeout"])

    def triggered(self, bench: Bench, task: Task, at_ns: int) -> None:
        """Do nothing: a watchdog waits for no trigger."""

    def stop(self, bench: Bench, task: Task, now_ns: int, cause: str) -> None:
        """End the countdown; an expired watchdog stays expired until it is cleared or started again."""
        if task.run is not None and task.run.expired_ns is None:
            task.run = None

    def done_ns(self, bench: Bench, task: Task) -> int | None:
        """Return None, because a watchdog is never done."""
        return None


def create_watchdog(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """Answer `DAQmxCreateWatchdogTimerTaskEx` with the handle of a new watchdog task.

    Raise Status for an unknown board, one without a watchdog, a timeout in s outside its limits (-1: never),
    or a name that the client's tasks have already.
    """
    device = bench.devices.find(arguments["device_name"])
    if not device.kind.watchdog:
        raise Status(statuses.WATCHDOG_NOT_SUPPORTED, f"Device: {device.name} ({device.kind.product})")
    timeout_s = arguments["timeout"]
    if timeout_s != NEVER and not 0.0 < timeout_s <= LONGEST_TIMEOUT_S:
        session, name = arguments["session_name"], "Watchdog.Timeout"
        code = statuses.WATCHDOG_TIMEOUT_OUT_OF_RANGE
        raise statuses.create_rejection(
            session, name, code=code, requested=timeout_s, maximum=LONGEST_TIMEOUT_S
        )
    task = tasks.create_task(bench, client, arguments["session_name"])
    task.set_channel("watchdog", WatchedBoard(name=device.name, device=device))
    task.settings |= {"Watchdog.Timeout": timeout_s, "expiration": {}}
    return {"task": task.handle}


def _require_watchdog(task: Task) -> None:
    """Raise Status if the task is no watchdog."""
    if task.kind != "watchdog":
        raise Status(statuses.NOT_A_WATCHDOG_TASK, task=task.name)


def configure_expiration(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxCfgWatchdogDOExpirStates`: set the level that each line takes on expiration.

    A counter is watched by the line of its terminal. Raise Status for another kind of task, unknown lines or
    states, lines of another board, another number of states, or while the watchdog runs.
    """
    _require_watchdog(task)
    tasks.mark_changed(task)
    lines = bench.devices.lines(arguments["channel_names"])
    states = [int(state) for state in arguments["expir_state_array"]]
    if len(states) != len(lines):
        raise Status(statuses.INVALID_VALUE, f"{len(states)} states for {len(lines)} lines.", task=task.name)
    wanted = dict(zip(lines, states, strict=True))
    for (device, _), state in wanted.items():
        if device is not task.device:
            raise Status(statuses.DEVICE_NOT_IN_TASK, f"Device: {device.name}", task=task.name)
        if state not in (LOW, HIGH, TRISTATE, NO_CHANGE):
            name, requested = "Watchdog.DO.ExpirState", f"{state} on {device.name}"
            raise statuses.create_rejection(task.name, name, requested=requested)
    task.settings["expiration"] |= {line: state for (_, line), state in wanted.items()}


def control_watchdog(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxControlWatchdogTask`: restart the countdown, or clear an expiration.

    Raise Status for another kind of task, if it was not started, for an unknown action, or for a restart
    after the expiration.
    """
    _require_watchdog(task)
    now_ns = bench.settle()
    run: Countdown | None = task.run
    if run is None:
        raise Status(statuses.NOT_RUNNING, task=task.name)
    action = arguments["action"]
    if action == RESET_TIMER:
        if run.expired_ns is not None:
            raise Status(statuses.EXPIRED_WATCHDOG_NEEDS_CLEARING, task=task.name)
        run.begin_ns = now_ns
    elif action == CLEAR_EXPIRATION:
        run.expired_ns = None
        run.begin_ns = now_ns if task.state is TaskState.RUNNING else None
    else:
        raise Status(statuses.INVALID_VALUE, f"Watchdog action {action}.", task=task.name)


HANDLERS: Mapping[str, Handler] = {"DAQmxCreateWatchdogTimerTaskEx": create_watchdog}
TASK_HANDLERS: Mapping[str, TaskHandler] = {
    "DAQmxCfgWatchdogDOExpirStates": configure_expiration,
    "DAQmxControlWatchdogTask": control_watchdog,
}
