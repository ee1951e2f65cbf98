"""Counter pulse, and the coil and striker it moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from hardware_drivers.nanoseconds import NS_PER_S
from simulator.doubles.daqmx.analog_input import correct_started_tasks, discard_strike_records
from simulator.doubles.daqmx.devices import Device
from simulator.doubles.daqmx.lines import Pulse
from simulator.doubles.daqmx.reservations import format_resource
from simulator.doubles.daqmx.routing import FALLING, RISING, fire_edge, get_start_trigger
from simulator.doubles.daqmx.strikes import Strike
from simulator.doubles.daqmx.tasks import Arguments, Bench, Task, TaskHandler
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import Status, create_rejection

LOW = 10214
HIGH = 10192
TIMEBASE_HZ = 100e6
COUNTER_BITS = 32


@dataclass(slots=True, eq=False)
class PulseChannel:
    """Counter that generates one pulse; between pulses its pin is low."""

    name: str
    device: Device
    number: int
    initial_delay_s: float
    high_s: float
    terminal: str = ""

    @property
    def physical_name(self) -> str:
        """Return board and counter, such as ``Dev1/ctr0``."""
        return f"{self.device.name}/ctr{self.number}"

    @property
    def pin(self) -> str:
        """Return the terminal where the pulse leaves the board: the chosen one, or else the counter's own."""
        return self.terminal or self.device.kind.counter_terminals[self.number]

    @property
    def internal_output(self) -> str:
        """Return the terminal inside the board that follows the counter, independent of the pin's route."""
        return f"Ctr{self.number}InternalOutput"

    @property
    def line(self) -> str:
        """Return the name of the driven line in the line record, ``<serial number>/<terminal>``."""
        return f"{self.device.serial_number}/{self.pin}"


@dataclass(slots=True, eq=False)
class Generation:
    """Pulse generation of a started task: start is None while a start trigger is awaited."""

    begin_ns: int | None
    pulse: Pulse | None = None
    strike: Strike | None = None


class CounterOutput:
    """Pulse generation as a `tasks.TaskKind`."""

    def verify(self, bench: Bench, task: Task) -> None:
        """Raise Status if delay or high time exceeds 32 bits at 100 MHz, or the latter is below two ticks."""
        longest_s = (2**COUNTER_BITS - 1) / TIMEBASE_HZ
        for name, time_s, shortest_s in (
            ("CO.Pulse.Time.InitialDelay", task.channel.initial_delay_s, 0.0),
            ("CO.Pulse.HighTime", task.channel.high_s, 2.0 / TIMEBASE_HZ),
        ):
            if not shortest_s <= time_s <= longest_s:
                raise create_rejection(
                    task.name, name, requested=time_s, minimum=shortest_s, maximum=longest_s
                )

    def resources(self, bench: Bench, task: Task) -> tuple[str, ...]:
        """Return the resources that the task needs: the counter and the pin that it drives."""
        channel: PulseChannel = task.channel
        parts = (f"ctr{channel.number}", channel.pin)
        return tuple(format_resource(channel.device.serial_number, part) for part in parts)

    def commit(self, bench: Bench, task: Task) -> None:
        """Drive the pin low from now on, after all edges that are due."""
        bench.lines.drive(task.channel.line, 0, bench.settle(), "idle")

    def start(self, bench: Bench, task: Task, now_ns: int) -> None:
        """Start the pulse's delay now, or wait for the start trigger.

        Raise Status if a watchdog of the board has expired.
        """
        for watch in bench.tasks.values():
            mine = watch.kind == "watchdog" and watch.is_on(task.device.serial_number)
            if mine and watch.run is not None and watch.run.expired_ns is not None:
                raise Status(statuses.WATCHDOG_EXPIRED, task=task.name)
        task.n_starts += 1
        task.run = Generation(begin_ns=None if get_start_trigger(task) else now_ns)
        if task.run.begin_ns is not None:
            self.triggered(bench, task, now_ns)

    def triggered(self, bench: Bench, task: Task, at_ns: int) -> None:
        """Schedule the pulse that follows a trigger, the strike that it causes, and the tasks that it starts.

        A simulated board is done at once, and no line moves.
        """
        run: Generation = task.run
        channel: PulseChannel = task.channel
        if channel.device.parameters.simulated:  # done at once, and no line moves
            run.begin_ns, run.pulse = at_ns, Pulse(line=channel.line, start_ns=at_ns, end_ns=at_ns)
            return
        start_ns = at_ns + _round_to_ns(channel.initial_delay_s)
        pulse = Pulse(line=channel.line, start_ns=start_ns, end_ns=start_ns + _round_to_ns(channel.high_s))
        run.begin_ns, run.pulse, run.strike = at_ns, pulse, _plan_strike(bench, channel, pulse)
        bench.lines.start(pulse)
        for terminal in (channel.pin, channel.internal_output):
            for edge, edge_ns in ((RISING, pulse.start_ns), (FALLING, pulse.end_ns)):
                fire_edge(bench, f"/{channel.device.name}/{terminal}", edge_ns, edge)
        bench.changed.notify_all()

    def stop(self, bench: Bench, task: Task, now_ns: int, cause: str) -> None:
        """Set the line low and end the pulse at ``now_ns``; a lifted striker falls.

        The start of tasks by its edges is corrected. Do nothing before the first start.
        """
        run: Generation | None = task.run
        if run is None:
            return
        disconnect_pin(bench, task, 0, now_ns, cause)
        if run.pulse is not None and run.pulse.end_ns > now_ns:
            for name in (task.channel.pin, task.channel.internal_output):
                correct_started_tasks(bench, f"/{task.channel.device.name}/{name}", run.pulse, now_ns)
            run.pulse = replace(run.pulse, end_ns=now_ns)

    def done_ns(self, bench: Bench, task: Task) -> int | None:
        """Return the monotonic time in ns when the pulse ends; None before its start trigger."""
        return None if task.run.pulse is None else int(task.run.pulse.end_ns)


def disconnect_pin(bench: Bench, task: Task, level: int, now_ns: int, cause: str) -> None:
    """Disconnect a pin from its counter, which continues to count, and drive it to a level (0 or 1).

    A striker that is still lifted at ``now_ns`` falls then, or its strike is cancelled; records of the strike
    are discarded.
    """
    run: Generation = task.run
    bench.lines.cut(task.channel.line, level, now_ns, cause)
    strike, run.strike = run.strike, None
    if strike is not None and strike.released_ns > now_ns:
        # It still hangs: now it falls.
        bench.strikes.cut(strike, now_ns)
        discard_strike_records(bench, strike, now_ns)
    bench.changed.notify_all()


def _round_to_ns(time_s: float) -> int:
    """Round a time in s to whole ticks of the counter's timebase, in ns."""
    return round(time_s * TIMEBASE_HZ) * round(NS_PER_S / TIMEBASE_HZ)


def _plan_strike(bench: Bench, channel: PulseChannel, pulse: Pulse) -> Strike | None:
    """Plan the strike of a coil's pulse; None if no coil is wired to the counter, or the pulse is too short.

    None also if the pulse leaves at another pin than the counter's own.
    """
    if channel.pin != channel.device.kind.counter_terminals[channel.number]:
        # The coil hangs at the counter's own pin; a pulse sent elsewhere moves nothing.
        return None
    for position, wiring in bench.description.transducers.items():
        if (wiring.counter_serial, wiring.counter) == (channel.device.serial_number, channel.number):
            return bench.strikes.plan(position, pulse.start_ns, pulse.end_ns)
    return None


def create_pulse_channel(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxCreateCOPulseChanTime`: give an empty task a pulse channel.

    Raise Status if it has a channel or runs, for an unknown board or counter, or a high idle state; the times
    are checked when the task is verified.
    """
    task.require_empty()
    device, number = bench.devices.channel(arguments["counter"], "ctr")
    if arguments["idle_state"] != LOW:
        detail = "The double's pins are low between pulses."
        raise create_rejection(task.name, "CO.Pulse.IdleState", detail, requested=arguments["idle_state"])
    task.set_channel(
        "co",
        PulseChannel(
            name=arguments["name_to_assign_to_channel"] or f"{device.name}/ctr{number}",
            device=device,
            number=number,
            initial_delay_s=arguments["initial_delay"],
            high_s=arguments["high_time"],
        ),
    )
    bench.last_channel[task.client] = task.channel.name


TASK_HANDLERS: Mapping[str, TaskHandler] = {"DAQmxCreateCOPulseChanTime": create_pulse_channel}
