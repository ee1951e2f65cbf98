"""Counter pulses, and the coils and strikers they move."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import islice
from types import MappingProxyType

from simulator.doubles.daqmx import tasks
from simulator.doubles.daqmx.analog_input import forget_strike
from simulator.doubles.daqmx.devices import Device
from simulator.doubles.daqmx.lines import PulseTrain
from simulator.doubles.daqmx.reservations import resource
from simulator.doubles.daqmx.routing import fire, waits_for
from simulator.doubles.daqmx.strikes import Strike
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench, Task, TaskState
from simulator.doubles.vendor_api.statuses import (
    ATTRIBUTE_NOT_IN_THIS_TASK,
    CHANNEL_ALREADY_IN_TASK,
    DIFFERENT_CHANNEL_TYPES,
    INVALID_VALUE,
    NO_CHANNELS,
    WATCHDOG_EXPIRED,
    Status,
)

LOW = 10214
HIGH = 10192
FINITE = 10178
CONTINUOUS = 10123
IMPLICIT = 10451
SECONDS = 10364
TIMEBASE_HZ = 100e6
COUNTER_BITS = 32
STRIKES_OF_A_TRAIN = 64
"""Of a longer train only the first pulses strike; the line is recorded to the end."""


@dataclass(slots=True, eq=False)
class PulseChannel:
    """One counter that makes pulses."""

    name: str
    device: Device
    number: int
    idle_state: int
    initial_delay_s: float
    low_s: float
    high_s: float
    terminal: str = ""

    @property
    def physical_name(self) -> str:
        """Board and counter."""
        return f"{self.device.name}/ctr{self.number}"

    @property
    def pin(self) -> str:
        """Where the pulse leaves the board."""
        return self.terminal or self.device.kind.counter_terminals[self.number]

    @property
    def line(self) -> str:
        """Physical line in the record."""
        return f"{self.device.serial_number}/{self.pin}"

    @property
    def idle(self) -> int:
        """Level between pulses."""
        return int(self.idle_state == HIGH)


@dataclass(slots=True, eq=False)
class Generation:
    """What a started task generates: begin None while a start trigger is awaited."""

    begin_ns: int | None
    trains: list[PulseTrain] = field(default_factory=list)
    strikes: list[Strike] = field(default_factory=list)


class CounterOutput:
    """`tasks.TaskKind` of pulse generation."""

    def verify(self, bench: Bench, task: Task) -> None:
        """Check the times against the counter: at least two ticks, at most its width."""
        longest_s = (2**COUNTER_BITS - 1) / TIMEBASE_HZ
        for channel in task.channels:
            for name, time_s in (
                ("CO.Pulse.Time.InitialDelay", channel.initial_delay_s),
                ("CO.Pulse.LowTime", channel.low_s),
                ("CO.Pulse.HighTime", channel.high_s),
            ):
                shortest_s = 0.0 if name.endswith("Delay") else 2.0 / TIMEBASE_HZ
                if not shortest_s <= time_s <= longest_s:
                    raise Status(
                        INVALID_VALUE,
                        f"Property: {name}\nRequested Value: {time_s}\nMinimum Value: {shortest_s}\n"
                        f"Maximum Value: {longest_s}",
                        task=task.name,
                    )
        mode = task.settings.get("SampQuant.SampMode", FINITE)
        if mode not in (FINITE, CONTINUOUS):
            raise Status(
                INVALID_VALUE, f"Property: SampQuant.SampMode\nRequested Value: {mode}", task=task.name
            )

    def resources(self, bench: Bench, task: Task) -> tuple[str, ...]:
        """Each counter, and the pin it drives."""
        return tuple(
            resource(channel.device.serial_number, part)
            for channel in task.channels
            for part in (f"ctr{channel.number}", channel.pin)
        )

    def commit(self, bench: Bench, task: Task) -> None:
        """Drive the pin at the idle level from now on."""
        now_ns = bench.settle()
        for channel in task.channels:
            bench.lines.drive(channel.line, channel.idle, now_ns, "idle")

    def start(self, bench: Bench, task: Task, now_ns: int) -> None:
        """Count from now on, or from the start trigger on."""
        for watch in bench.tasks.values():
            if watch.kind == "watchdog" and watch.run is not None and watch.run.expired_ns is not None:
                expired = tasks.serials(watch) & tasks.serials(task)
                if expired:
                    raise Status(WATCHDOG_EXPIRED, task=task.name)
        task.begun += 1
        task.run = Generation(begin_ns=None if waits_for(task) else now_ns)
        if task.run.begin_ns is not None:
            self.triggered(bench, task, now_ns)

    def triggered(self, bench: Bench, task: Task, at_ns: int) -> None:
        """Plan the pulses and the strikes that they lead to."""
        run: Generation = task.run
        run.begin_ns = at_ns
        for channel in task.channels:
            train = PulseTrain(
                line=channel.line,
                begin_ns=at_ns,
                delay_ns=_ns(channel.initial_delay_s),
                high_ns=_ns(channel.high_s),
                low_ns=_ns(channel.low_s),
                pulses=pulse_count(task),
                idle=channel.idle,
            )
            run.trains.append(train)
            run.strikes += _strikes(bench, channel, train)
            bench.lines.start(train)
            fire(bench, f"/{channel.device.name}/{channel.pin}", train.start_ns(0))
            internal = f"/{channel.device.name}/Ctr{channel.number}InternalOutput"
            fire(bench, internal, train.start_ns(0))
        bench.changed.notify_all()

    def stop(self, bench: Bench, task: Task, now_ns: int, cause: str) -> None:
        """Take the line back to its idle level; strikers that hang there fall now."""
        if task.run is not None:
            cut(bench, task, now_ns, cause, level=None)

    def done_ns(self, bench: Bench, task: Task) -> int | None:
        """When the last pulse is over."""
        run: Generation = task.run
        ends = [train.end_ns for train in run.trains]
        known = [end for end in ends if end is not None]
        return max(known) if known and len(known) == len(ends) else None


def cut(bench: Bench, task: Task, now_ns: int, cause: str, *, level: int | None) -> None:
    """End a task's pulses at a time; the lines go to a level, or to their idle level."""
    run: Generation = task.run
    for channel in task.channels:
        bench.lines.cut(channel.line, channel.idle if level is None else level, now_ns, cause)
    _let_fall(bench, run.strikes, now_ns)
    run.strikes = []
    run.trains = [_ended(train, now_ns) for train in run.trains]
    bench.changed.notify_all()


def override(bench: Bench, task: Task, channel: PulseChannel, level: int, now_ns: int, cause: str) -> None:
    """Take a pin away from its counter, which counts on: its task is told nothing and is done when it was."""
    run: Generation = task.run
    bench.lines.cut(channel.line, level, now_ns, cause)
    wiring = bench.description.transducers
    moved = [
        strike
        for strike in run.strikes
        if (wiring[strike.key.position].counter_serial, wiring[strike.key.position].counter)
        == (channel.device.serial_number, channel.number)
    ]
    _let_fall(bench, moved, now_ns)
    run.strikes = [strike for strike in run.strikes if strike not in moved]
    bench.changed.notify_all()


def _let_fall(bench: Bench, strikes: Iterable[Strike], now_ns: int) -> None:
    """Drop strikers that still hang."""
    for strike in strikes:
        if strike.released_ns > now_ns:
            bench.strikes.cut(strike, now_ns)
            forget_strike(bench, strike, now_ns)


def _ended(train: PulseTrain, now_ns: int) -> PulseTrain:
    """Shorten a train that was cut: no pulse of it ends later than now."""
    if train.end_ns is not None and train.end_ns <= now_ns:
        return train
    return PulseTrain(
        line=train.line, begin_ns=now_ns, delay_ns=0, high_ns=0, low_ns=0, pulses=1, idle=train.idle
    )


def pulse_count(task: Task) -> int | None:
    """Pulses of one start; None for ever. Without implicit timing a counter makes one."""
    if task.settings.get("SampQuant.SampMode", FINITE) == CONTINUOUS:
        return None
    return int(task.settings.get("SampQuant.SampPerChan", 1))


def _ns(time_s: float) -> int:
    """Time in whole ticks of the counter's timebase."""
    return round(time_s * TIMEBASE_HZ) * round(1e9 / TIMEBASE_HZ)


def _strikes(bench: Bench, channel: PulseChannel, train: PulseTrain) -> list[Strike]:
    """Strikers that a train lifts and drops: the coil holds while its line is high."""
    if channel.pin != channel.device.kind.counter_terminals[channel.number]:
        # The coil hangs at the counter's own pin; a pulse sent elsewhere moves nothing.
        return []
    wanted = (channel.device.serial_number, channel.number)
    found = [
        position
        for position, wiring in bench.description.transducers.items()
        if (wiring.counter_serial, wiring.counter) == wanted
    ]
    strikes: list[Strike | None] = []
    for position in found:
        lifted_ns = bench.lines.since_ns(train.line) if train.idle else None
        for ns, level in islice(train.edges(), 2 * STRIKES_OF_A_TRAIN):
            if level:
                lifted_ns = ns
            elif lifted_ns is not None:
                strikes.append(bench.strikes.plan(position, lifted_ns, ns))
    return [strike for strike in strikes if strike is not None]


# Entry points


def create_pulse_channel(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxCreateCOPulseChanTime`."""
    task = tasks.find(bench, client, arguments["task"])
    task.require_not_running()
    if task.kind not in ("", "co"):
        raise Status(DIFFERENT_CHANNEL_TYPES, task=task.name)
    counters = bench.devices.channels(arguments["counter"], "ctr")
    if arguments["idle_state"] not in (LOW, HIGH):
        raise Status(
            INVALID_VALUE,
            f"Property: CO.Pulse.IdleState\nRequested Value: {arguments['idle_state']}",
            task=task.name,
        )
    given = arguments["name_to_assign_to_channel"]
    for index, (device, number) in enumerate(counters):
        name = f"{given}{index}" if given and len(counters) > 1 else given or f"{device.name}/ctr{number}"
        if name.casefold() in (channel.name.casefold() for channel in task.channels):
            raise Status(CHANNEL_ALREADY_IN_TASK, f"Channel Name: {name}", task=task.name)
        task.channels.append(
            PulseChannel(
                name=name,
                device=device,
                number=number,
                idle_state=arguments["idle_state"],
                initial_delay_s=arguments["initial_delay"],
                low_s=arguments["low_time"],
                high_s=arguments["high_time"],
            )
        )
    task.kind, task.state, task.verified = "co", TaskState.UNVERIFIED, False
    bench.last_channel[client] = ", ".join(channel.name for channel in task.channels[-len(counters) :])
    return {}


def configure_implicit_timing(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxCfgImplicitTiming`."""
    task = tasks.find(bench, client, arguments["task"])
    if task.kind != "co":
        raise Status(NO_CHANNELS if not task.kind else ATTRIBUTE_NOT_IN_THIS_TASK, task=task.name)
    tasks.changed(task)
    if arguments["sample_mode"] == FINITE and arguments["samps_per_chan"] < 1:
        raise Status(INVALID_VALUE, "Property: SampQuant.SampPerChan\nRequested Value: 0", task=task.name)
    task.settings |= {
        "SampTimingType": IMPLICIT,
        "SampQuant.SampMode": arguments["sample_mode"],
        "SampQuant.SampPerChan": arguments["samps_per_chan"],
    }
    return {}


HANDLERS: Mapping[str, Callable[[Bench, str, Arguments], Answer]] = MappingProxyType(
    {
        "DAQmxCreateCOPulseChanTime": create_pulse_channel,
        "DAQmxCfgImplicitTiming": configure_implicit_timing,
    }
)
