"""Attributes of a task's channels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from simulator.doubles.chassis.boards import terminals
from simulator.doubles.daqmx import analog_input, tasks
from simulator.doubles.daqmx.analog_input import InputChannel
from simulator.doubles.daqmx.attribute_lookup import Values, attribute_of, look_up, settable
from simulator.doubles.daqmx.counter_output import HIGH, LOW, SECONDS, TIMEBASE_HZ, PulseChannel
from simulator.doubles.daqmx.device_attributes import PULSE_TIME
from simulator.doubles.daqmx.routing import short_name
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench, Task
from simulator.doubles.vendor_api.statuses import (
    ATTRIBUTE_NOT_IN_THIS_TASK,
    ATTRIBUTE_NOT_SUPPORTED,
    CHANNEL_NOT_IN_TASK,
    INVALID_VALUE,
    Status,
)

COUNTER_OUTPUT = 10132
DMA = 10054
RIGHT_JUSTIFIED = 10279


_INPUT_CHANNEL: Values = {
    "ChanType": lambda task, c: analog_input.ANALOG_INPUT,
    "PhysicalChanName": lambda task, c: c.physical_name,
    "ChanDescr": lambda task, c: "",
    "ChanIsGlobal": lambda task, c: 0,
    "AI.MeasType": lambda task, c: analog_input.VOLTAGE,
    "AI.Voltage.Units": lambda task, c: analog_input.VOLTS,
    "AI.TermCfg": lambda task, c: c.device.kind.terminal_configuration,
    "AI.Coupling": lambda task, c: 10050,
    "AI.DataXferMech": lambda task, c: DMA,
    "AI.Max": lambda task, c: c.range_v,
    "AI.Min": lambda task, c: -c.range_v,
    "AI.Rng.High": lambda task, c: c.range_v,
    "AI.Rng.Low": lambda task, c: -c.range_v,
    "AI.Gain": lambda task, c: 10.0 / c.range_v,
    "AI.Resolution": lambda task, c: float(c.device.kind.resolution_bits),
    "AI.ResolutionUnits": lambda task, c: analog_input.BITS,
    "AI.RawSampSize": lambda task, c: c.device.kind.raw_sample_bits,
    "AI.RawSampJustification": lambda task, c: RIGHT_JUSTIFIED,
    "AI.DevScalingCoeff": lambda task, c: c.calibration.coefficients_v,
}

_PULSE_CHANNEL: Values = {
    "ChanType": lambda task, c: COUNTER_OUTPUT,
    "PhysicalChanName": lambda task, c: c.physical_name,
    "ChanDescr": lambda task, c: "",
    "ChanIsGlobal": lambda task, c: 0,
    "CO.OutputType": lambda task, c: PULSE_TIME,
    "CO.Pulse.Time.Units": lambda task, c: SECONDS,
    "CO.Pulse.IdleState": lambda task, c: c.idle_state,
    "CO.Pulse.Term": lambda task, c: f"/{c.device.name}/{c.pin}",
    "CO.Pulse.HighTime": lambda task, c: _ticks_s(c.high_s),
    "CO.Pulse.LowTime": lambda task, c: _ticks_s(c.low_s),
    "CO.Pulse.Time.InitialDelay": lambda task, c: _ticks_s(c.initial_delay_s),
    "CO.CtrTimebaseSrc": lambda task, c: f"/{c.device.name}/100MHzTimebase",
    "CO.CtrTimebaseRate": lambda task, c: TIMEBASE_HZ,
}


def _ticks_s(time_s: float) -> float:
    return round(time_s * TIMEBASE_HZ) / TIMEBASE_HZ


def _named_channel(task: Task, name: str) -> Any:
    """Channel by name; no name means the first, as NI takes one value for all."""
    channels = [] if task.kind == "watchdog" else task.channels
    if not channels:
        raise Status(ATTRIBUTE_NOT_IN_THIS_TASK, "The task has no channels.", task=task.name)
    wanted = name.split(",")[0].strip().strip("/").casefold()
    for channel in channels:
        if wanted in ("", channel.name.casefold(), channel.physical_name.casefold()):
            return channel
    raise Status(CHANNEL_NOT_IN_TASK, f"Channel Name: {name}", task=task.name)


def get_channel(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetChanAttribute`."""
    task = tasks.find(bench, client, arguments["task"])
    attribute = attribute_of(arguments, "Chan")
    channel = _named_channel(task, arguments["channel"])
    if attribute.name in ("CO.OutputState", "CO.PulseDone", "CO.Count") and task.kind == "co":
        return {"value": _output_now(bench, task, channel, attribute.name)}
    return look_up(_INPUT_CHANNEL if task.kind == "ai" else _PULSE_CHANNEL, attribute, task, channel)


def _output_now(bench: Bench, task: Task, channel: PulseChannel, name: str) -> int:
    bench.settle()
    if name == "CO.OutputState":
        return HIGH if bench.lines.level(channel.line) else LOW
    return int(tasks.is_done(bench, task)) if name == "CO.PulseDone" else 0


def set_channel(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxSetChanAttribute`."""
    task = tasks.find(bench, client, arguments["task"])
    attribute = settable(task, arguments, "Chan")
    channel, value = _named_channel(task, arguments["channel"]), arguments["value"]
    if isinstance(channel, InputChannel):
        _set_input_channel(task, channel, attribute.name, value)
    else:
        _set_pulse_channel(bench, task, channel, attribute.name, value)
    tasks.changed(task)
    return {}


def _set_input_channel(task: Task, channel: InputChannel, name: str, value: Any) -> None:
    if name == "AI.Max":
        channel.maximum_v = value
    elif name == "AI.Min":
        channel.minimum_v = value
    elif name in ("AI.TermCfg", "AI.Coupling", "AI.DataXferMech"):
        if value != _INPUT_CHANNEL[name](task, channel):
            raise Status(INVALID_VALUE, f"Property: {name}\nRequested Value: {value}", task=task.name)
    else:
        raise Status(ATTRIBUTE_NOT_IN_THIS_TASK, f"Property: {name}", task=task.name)


def _set_pulse_channel(bench: Bench, task: Task, channel: PulseChannel, name: str, value: Any) -> None:
    if name == "CO.Pulse.Term":
        known = {short_name(t): t for t in terminals(channel.device.kind, channel.device.name)}
        full = short_name(value) if "/" in value.strip("/") else f"{channel.device.name}/{value}".casefold()
        if full not in known:
            raise Status(INVALID_VALUE, f"Property: {name}\nRequested Value: {value}", task=task.name)
        channel.terminal = known[full].split("/", 2)[2]
    elif name == "CO.Pulse.IdleState" and value in (LOW, HIGH):
        channel.idle_state = value
    elif name == "CO.Pulse.HighTime":
        channel.high_s = value
    elif name == "CO.Pulse.LowTime":
        channel.low_s = value
    elif name == "CO.Pulse.Time.InitialDelay":
        channel.initial_delay_s = value
    else:
        raise Status(INVALID_VALUE, f"Property: {name}\nRequested Value: {value}", task=task.name)


def reset_channel(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxResetChanAttribute`: the double keeps what a channel was made with."""
    task = tasks.find(bench, client, arguments["task"])
    attribute = settable(task, arguments, "Chan")
    raise Status(ATTRIBUTE_NOT_SUPPORTED, f"Property: {attribute.name} cannot be reset.", task=task.name)


HANDLERS: Mapping[str, Callable[[Bench, str, Arguments], Answer]] = MappingProxyType(
    {
        "DAQmxGetChanAttribute": get_channel,
        "DAQmxSetChanAttribute": set_channel,
        "DAQmxResetChanAttribute": reset_channel,
    }
)
