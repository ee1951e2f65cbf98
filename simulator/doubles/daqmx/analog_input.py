"""Finite analog input: rates and ranges as boards coerce them, triggers in wall time, raw codes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from hardware_drivers.instruments import Acquired
from hardware_drivers.measurement import Calibration, Counts, ShotKey
from hardware_drivers.nanoseconds import NS_PER_S
from simulator.doubles.daqmx.devices import Device
from simulator.doubles.daqmx.lines import Pulse
from simulator.doubles.daqmx.reservations import format_resource
from simulator.doubles.daqmx.routing import (
    FALLING,
    fire_edge,
    get_start_trigger,
    require_start_route,
    short_name,
)
from simulator.doubles.daqmx.strikes import Strike
from simulator.doubles.daqmx.tasks import Bench, Task
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import Status
from simulator.electronics.sampling_kernel import find_rising_edge
from simulator.electronics.transduction import EARLY_TRIGGER_S, quantise_volts
from simulator.errors import SimulatorError
from simulator.numerics.arrays import FloatArray
from simulator.parameters.electronics import AdcParameters

RISING_SLOPE = 10280
FINITE = 10178
SAMPLE_CLOCK = 10388
ANALOG_EDGE = 10099
NO_TRIGGER = 10230
DEFAULT_CONFIGURATION = -1
SMALLEST_RECORD = 2
SECONDS = 10364
EARLY_NS = round(2.0 * EARLY_TRIGGER_S * NS_PER_S)
"""So long before a wave's trigger nothing else is looked for: what lies nearer has moved that trigger."""
SINE_SAMPLES, SINE_NOISE = 100, 0.03
LONGEST_TRAVEL_NS = NS_PER_S
"""No wave triggers later than this after the striker's contact: older strikes need no look."""


@dataclass(slots=True, eq=False)
class InputChannel:
    """Virtual input channel."""

    name: str
    device: Device
    number: int
    minimum_v: float
    maximum_v: float

    @property
    def physical_name(self) -> str:
        """Return board and input, such as ``Dev1/ai0``."""
        return f"{self.device.name}/ai{self.number}"

    @property
    def range_v(self) -> float:
        """Return the smallest range of the board (-r to +r) that includes the channel's limits, V.

        Raises
        ------
        Status
            No range of the board is wide enough.
        """
        reach_v = max(abs(self.minimum_v), abs(self.maximum_v))
        found = self.device.kind.coerced_range_v(reach_v)
        if found is None:
            limit_v = self.device.kind.ranges_v[-1]
            raise Status(
                statuses.INVALID_VALUE,
                f"Property: AI.Max, AI.Min\nRequested Value: {reach_v}\nMaximum Value: {limit_v}",
            )
        return found

    @property
    def calibration(self) -> Calibration:
        """Return the board's present polynomial from codes to V in this range; raise Status as `range_v`."""
        return self.device.calibration(self.range_v)


@dataclass(slots=True, eq=False)
class Acquisition:
    """Acquisition of a started task.

    Attributes
    ----------
    begin_ns
        When sampling began; None while a start trigger is awaited.
    done_ns
        When the record is complete; None until a strike is known that triggers it.
    codes
        Shape (samples,), once known.
    read_samples
        How many were handed out.
    strike
        What triggered.
    seen
        Strikes that were looked at and did not trigger.
    """

    begin_ns: int | None
    done_ns: int | None = None
    codes: Counts | None = None
    read_samples: int = 0
    ended: bool = False
    seen: set[Strike] = field(default_factory=set)
    strike: Strike | None = None


class AnalogInput:
    """Analog input as a `tasks.TaskKind`."""

    def verify(self, bench: Bench, task: Task) -> None:
        """Check range, rate, sample clock, record, triggers and start delay against the board.

        Raise Status if one of them does not fit.
        """
        _ = task.channel.range_v
        rate_hz(task)
        if task.settings.get("SampTimingType") != SAMPLE_CLOCK:
            detail = "The double samples with a sample clock only."
            raise statuses.create_rejection(task.name, "SampTimingType", detail)
        _verify_record(task)
        _verify_start(bench, task)

    def resources(self, bench: Bench, task: Task) -> tuple[str, ...]:
        """Return the name of the only resource that the task needs: the analog input of its board."""
        return (format_resource(task.device.serial_number, "ai"),)

    def commit(self, bench: Bench, task: Task) -> None:
        """Do nothing, because analog input drives no line."""

    def start(self, bench: Bench, task: Task, now_ns: int) -> None:
        """Start sampling now, or at the start trigger; a simulated board has a sine wave at once."""
        task.n_starts += 1
        if task.device.parameters.simulated:
            codes = quantise_volts(_simulate_sine_volts(task), task.channel.calibration)
            task.run = Acquisition(begin_ns=now_ns, done_ns=now_ns, codes=codes)
            return
        task.run = Acquisition(begin_ns=None if get_start_trigger(task) else now_ns)
        if task.run.begin_ns is not None:
            self.triggered(bench, task, now_ns)

    def triggered(self, bench: Bench, task: Task, at_ns: int) -> None:
        """Start sampling after the delay; start also the tasks that wait for this board's start trigger."""
        task.run.begin_ns = at_ns + round(start_delay_s(task) * NS_PER_S)
        fire_edge(bench, f"/{task.device.name}/ai/StartTrigger", at_ns)

    def stop(self, bench: Bench, task: Task, now_ns: int, cause: str) -> None:
        """End the acquisition, if there is one; its samples can no longer be read."""
        if task.run is not None:
            task.run.ended = True

    def done_ns(self, bench: Bench, task: Task) -> int | None:
        """Determine the monotonic time in ns when the record is complete, and store it in the acquisition.

        None while no strike or start trigger determines it. Raise Status if the twin cannot compute the
        record.
        """
        run: Acquisition = task.run
        if run.done_ns is None and run.begin_ns is not None:
            if _has_reference_trigger(task):
                _find_trigger(bench, task, run)
            else:
                length_s = record_samples(task) / rate_hz(task)
                run.done_ns = run.begin_ns + round(length_s * NS_PER_S)
        return run.done_ns


def _simulate_sine_volts(task: Task) -> FloatArray:
    """Simulate the full-scale sine wave with 3 % noise of a simulated device, V, shape (record samples,).

    NI does not state its frequency: 100 samples per period are an assumption. The phase is random, by channel
    and number of starts.
    """
    random = np.random.default_rng([task.channel.number, task.n_starts])
    samples = np.arange(record_samples(task))
    sine = np.sin(2.0 * np.pi * samples / SINE_SAMPLES + 2.0 * np.pi * random.random())
    noise = random.uniform(-SINE_NOISE, SINE_NOISE, samples.size)
    return np.asarray(task.channel.maximum_v * (sine + noise), dtype=np.float64)


def rate_hz(task: Task) -> float:
    """Return the sample rate that the board coerces the requested one (default 1000) to, in Hz.

    Raises
    ------
    Status
        Too fast for the board, or not positive.
    """
    kind = task.device.kind
    asked_hz = float(task.settings.get("SampClk.Rate", 1000.0))
    limit_hz = kind.max_rate_hz
    # The timebase divided by a whole number may exceed the limit by a rounding error.
    if not 0.0 < asked_hz <= limit_hz * (1.0 + 1e-9):
        raise statuses.create_rejection(task.name, "SampClk.Rate", requested=asked_hz, maximum=limit_hz)
    coerced_hz = kind.coerced_rate_hz(asked_hz)
    return coerced_hz if coerced_hz <= limit_hz * (1.0 + 1e-9) else asked_hz


def start_delay_s(task: Task) -> float:
    """Return the time from start trigger to first sample, s, in whole ticks of the timebase; default 0."""
    timebase_hz = task.device.kind.timebase_hz
    return round(float(task.settings.get("StartTrig.Delay", 0.0)) * timebase_hz) / timebase_hz


def record_samples(task: Task) -> int:
    """Return the configured length of the record in samples per channel; 1000 if it is not set."""
    return int(task.settings.get("SampQuant.SampPerChan", 1000))


def _has_reference_trigger(task: Task) -> bool:
    """Return whether the task records around an analog edge (reference trigger), not from its start."""
    return bool(task.settings.get("RefTrig.Type", NO_TRIGGER) == ANALOG_EDGE)


def _verify_start(bench: Bench, task: Task) -> None:
    """Raise Status if the start trigger cannot reach the board, or its delay is not in s or out of bounds."""
    if get_start_trigger(task):
        require_start_route(bench, task)
    if "StartTrig.Delay" not in task.settings:
        return
    if task.settings.get("StartTrig.DelayUnits") != SECONDS:
        raise statuses.create_rejection(
            task.name, "StartTrig.DelayUnits", "The double takes a delay in seconds only."
        )
    shortest, longest = task.device.kind.start_delay_ticks
    ticks = start_delay_s(task) * task.device.kind.timebase_hz
    if not shortest <= ticks <= longest:
        code = statuses.START_DELAY_TOO_SHORT if ticks < shortest else statuses.START_DELAY_TOO_LONG
        requested = f"{ticks} ticks of {shortest} to {longest}"
        raise statuses.create_rejection(task.name, "StartTrig.Delay", code=code, requested=requested)


def _verify_record(task: Task) -> None:
    """Raise Status if the record is not finite or too short, or its reference trigger is not supported.

    The double triggers on a rising edge of the task's own channel, between 0 V and the range, with at least 2
    samples before and after the trigger.
    """
    settings = task.settings
    if settings.get("SampQuant.SampMode", FINITE) != FINITE:
        raise statuses.create_rejection(
            task.name, "SampQuant.SampMode", "The double samples finite records only."
        )
    samples = record_samples(task)
    if samples < SMALLEST_RECORD:
        name = "SampQuant.SampPerChan"
        raise statuses.create_rejection(task.name, name, requested=samples, minimum=SMALLEST_RECORD)
    if not _has_reference_trigger(task):
        return
    pretrigger = int(settings["RefTrig.PretrigSamples"])
    if not 2 <= pretrigger <= samples - 2:
        name, code = "RefTrig.PretrigSamples", statuses.TOO_MANY_PRETRIGGER_SAMPLES
        most = samples - 2
        raise statuses.create_rejection(
            task.name, name, code=code, requested=pretrigger, minimum=2, maximum=most
        )
    channel: InputChannel = task.channel
    source = str(settings["AnlgEdge.RefTrig.Src"]).strip().strip("/").casefold()
    if source not in (channel.name.casefold(), channel.physical_name.casefold()):
        raise Status(statuses.INVALID_TRIGGER_SOURCE, f"Requested Value: {source}", task=task.name)
    level_v = float(settings["AnlgEdge.RefTrig.Lvl"])
    if not 0.0 < level_v < channel.range_v or settings["AnlgEdge.RefTrig.Slope"] != RISING_SLOPE:
        name, detail = "AnlgEdge.RefTrig.Lvl", "The double triggers on a rising edge above 0 V."
        raise statuses.create_rejection(task.name, name, detail, requested=level_v, maximum=channel.range_v)


def _build_adc(task: Task, pretrigger_samples: int, trigger_level_v: float) -> AdcParameters:
    """Build the converter parameters of the task's board, with its range, rate and record length.

    ``trigger_level_v`` is in V. Raise Status if range or rate is not possible, ValueError if the twin has no
    such converter.
    """
    record = AdcParameters(
        range_v=task.channel.range_v,
        sample_rate_hz=rate_hz(task),
        record_samples=record_samples(task),
        pretrigger_samples=pretrigger_samples,
        trigger_level_v=trigger_level_v,
    )
    return task.device.parameters.adc(record)


def _find_trigger(bench: Bench, task: Task, run: Acquisition) -> None:
    """Find the first trigger of a record (wave or crosstalk); store its codes, end and strike in ``run``.

    Edges before the pre-trigger samples are filled are ignored. Without a trigger nothing is stored. Raise
    Status if the twin cannot compute a wave.
    """
    assert run.begin_ns is not None
    filled_ns = run.begin_ns + round(_pretrigger_samples(task) / rate_hz(task) * NS_PER_S)
    found = _find_first_wave(bench, task, run, filled_ns)
    position = _find_position(bench, task.channel)
    wave_ns = None if found is None else found[2]
    if position is not None and _false_trigger(bench, task, run, position, wave_ns):
        return
    if found is not None:
        run.strike, acquired, trigger_ns = found
        run.codes = acquired.waveform.counts
        run.done_ns = trigger_ns + _post_trigger_ns(task)


def _pretrigger_samples(task: Task) -> int:
    """Return the set number of samples before the reference trigger; raise KeyError if it is not set."""
    return int(task.settings["RefTrig.PretrigSamples"])


def _post_trigger_ns(task: Task) -> int:
    """Return the time from trigger to end of the record, ns; raise Status if the rate is not possible."""
    return round((record_samples(task) - _pretrigger_samples(task)) / rate_hz(task) * NS_PER_S)


def _find_first_wave(
    bench: Bench, task: Task, run: Acquisition, filled_ns: int
) -> tuple[Strike, Acquired, int] | None:
    """Find the first strike whose wave crosses the level from ``filled_ns`` on; None if there is none.

    Return the strike, its record and the time of the crossing in ns. Strikes that do not trigger are added to
    ``run.seen``. Raise Status if the twin cannot compute the wave.
    """
    position = _find_position(bench, task.channel)
    for strike in bench.strikes.planned:
        if strike.key.position != position or strike in run.seen:
            continue
        if strike.contact_ns < filled_ns - LONGEST_TRAVEL_NS:
            continue
        adc = _build_adc(task, _pretrigger_samples(task), float(task.settings["AnlgEdge.RefTrig.Lvl"]))
        try:
            acquired = bench.strikes.record(strike, adc, task.channel.calibration)
        except (SimulatorError, ValueError) as error:
            raise Status(
                statuses.SOFTWARE_FAULT, f"The twin cannot compute this: {error}", task=task.name
            ) from error
        trigger_ns = strike.contact_ns
        if acquired is not None:
            trigger_ns += round(acquired.truth["trigger_time_s"] * NS_PER_S)
            if trigger_ns >= filled_ns:
                return strike, acquired, trigger_ns
        run.seen.add(strike)
    return None


def _false_trigger(bench: Bench, task: Task, run: Acquisition, position: str, wave_ns: int | None) -> bool:
    """Find a trigger by crosstalk or hum before the wave; store its record, and return whether there is one.

    The comparator sees the same noise as the record that follows.

    Parameters
    ----------
    wave_ns
        Time of the wave's trigger; None: there is no wave.
    """
    assert run.begin_ns is not None
    crosstalk, pulses = bench.strikes.crosstalk(position), bench.strikes.list_coil_pulses(position)
    rate, pretrigger = rate_hz(task), _pretrigger_samples(task)
    level_v = float(task.settings["AnlgEdge.RefTrig.Lvl"])
    filling_ns = round(pretrigger / rate * NS_PER_S)
    reach_ns = round(crosstalk.reach_s * NS_PER_S)
    edges = [ns for pulse in pulses for ns in pulse if ns + reach_ns > run.begin_ns + filling_ns]
    humming = crosstalk.hum_v >= 0.5 * level_v
    if crosstalk.silent or not (edges or humming):
        return False
    first_ns = run.begin_ns if humming else max(run.begin_ns, min(edges) - 2 * filling_ns)
    last_ns = max([edge + reach_ns for edge in edges], default=first_ns) + 2 * filling_ns
    if humming:
        last_ns += round(NS_PER_S / crosstalk.hum_hz)
    if wave_ns is not None:
        last_ns = min(last_ns, wave_ns - EARLY_NS)
    looked_at = round((last_ns - first_ns) / NS_PER_S * rate)
    if looked_at <= pretrigger:
        return False
    adc = replace(
        _build_adc(task, SMALLEST_RECORD, level_v),
        record_samples=looked_at + record_samples(task) - pretrigger,
    )
    key = ShotKey(position=position, set_index=0, shot_index=task.n_starts)
    volts = bench.strikes.simulate_free_volts(key, first_ns, adc, task.channel.calibration)
    at: int = find_rising_edge(volts, level_v, pretrigger, looked_at - pretrigger)
    if at < 0:
        return False
    run.codes = quantise_volts(volts[at - pretrigger :][: record_samples(task)], task.channel.calibration)
    run.done_ns = first_ns + round(at / rate * NS_PER_S) + _post_trigger_ns(task)
    run.strike = bench.strikes.planned[-1] if bench.strikes.planned else None
    return True


def get_recorded_codes(bench: Bench, task: Task) -> Counts | None:
    """Return the raw codes of a record, shape (samples,); None before its start or reference trigger.

    Without a reference trigger they are simulated at the first call, from the start of sampling, and stored.
    """
    run: Acquisition = task.run
    if run.codes is not None or run.begin_ns is None or _has_reference_trigger(task):
        return run.codes
    channel: InputChannel = task.channel
    place = _find_position(bench, channel) or channel.physical_name
    key = ShotKey(position=place, set_index=0, shot_index=task.n_starts)
    adc = _build_adc(task, SMALLEST_RECORD, 0.5 * channel.range_v)
    volts = bench.strikes.simulate_free_volts(key, run.begin_ns, adc, channel.calibration)
    run.codes = quantise_volts(volts, channel.calibration)
    return run.codes


def _find_position(bench: Bench, channel: InputChannel) -> str | None:
    """Return the position of the transducer whose sensor is wired to an input; None if there is none."""
    wanted = (channel.device.serial_number, channel.number)
    for position, wiring in bench.description.transducers.items():
        if (wiring.ai_serial, wiring.ai_channel) == wanted:
            return position
    return None


def discard_strike_records(bench: Bench, strike: Strike, now_ns: int) -> None:
    """Discard the records that a cut or cancelled strike has triggered, unless complete at ``now_ns``.

    The tasks of these records look for a trigger again, also by this strike.
    """
    for task in bench.tasks.values():
        run = task.run
        if isinstance(run, Acquisition):
            run.seen.discard(strike)
            if run.strike is strike and run.done_ns is not None and run.done_ns > now_ns:
                run.strike = run.codes = run.done_ns = None


def correct_started_tasks(bench: Bench, terminal: str, pulse: Pulse, now_ns: int) -> None:
    """Correct the start of tasks that an edge of a pulse has started, when the pulse ends early.

    Tasks started by ``terminal`` wait again if the pulse had not started by ``now_ns``; those on its falling
    edge start now. Their records are discarded.
    """
    for task in bench.tasks.values():
        run = task.run
        if not isinstance(run, Acquisition) or run.ended or get_start_trigger(task) != short_name(terminal):
            continue
        if pulse.start_ns > now_ns:
            run.begin_ns = None
        elif task.settings["DigEdge.StartTrig.Edge"] == FALLING:
            run.begin_ns = now_ns + round(start_delay_s(task) * NS_PER_S)
        else:
            continue
        run.seen.clear()
        run.strike = run.codes = run.done_ns = None
