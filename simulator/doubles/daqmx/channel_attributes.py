"""Attributes of a task's channels."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from simulator.doubles.chassis.boards import list_terminals
from simulator.doubles.daqmx import tasks
from simulator.doubles.daqmx.analog_input import InputChannel
from simulator.doubles.daqmx.attribute_lookup import answer_attribute, require_settable
from simulator.doubles.daqmx.counter_output import LOW, TIMEBASE_HZ, PulseChannel
from simulator.doubles.daqmx.devices import Device
from simulator.doubles.daqmx.routing import short_name
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench, Task, TaskHandler
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import Status

DC_COUPLING = 10050
ANALOG_INPUT, COUNTER_OUTPUT = 10100, 10132

_INPUT_CHANNEL: Mapping[str, Callable[[InputChannel], object]] = {
    "ChanType": lambda channel: ANALOG_INPUT,
    "AI.Coupling": lambda channel: DC_COUPLING,
    "AI.Rng.High": lambda channel: channel.range_v,
    "AI.Rng.Low": lambda channel: -channel.range_v,
    "AI.Resolution": lambda channel: float(channel.device.kind.resolution_bits),
    "AI.RawSampSize": lambda channel: channel.device.kind.raw_sample_bits,
    "AI.DevScalingCoeff": lambda channel: channel.calibration.coefficients_v,
}

_PULSE_CHANNEL: Mapping[str, Callable[[PulseChannel], object]] = {
    "ChanType": lambda channel: COUNTER_OUTPUT,
    "CO.Pulse.IdleState": lambda channel: LOW,
    "CO.Pulse.Term": lambda channel: f"/{channel.device.name}/{channel.pin}",
    "CO.Pulse.HighTime": lambda channel: round(channel.high_s * TIMEBASE_HZ) / TIMEBASE_HZ,
}


def _require_channel(task: Task, name: str) -> InputChannel | PulseChannel:
    """Return the task's channel if ``name`` is its virtual or physical name, or empty.

    Raise Status for another name, or if the task has no channel. Case does not matter.
    """
    channel = task.channel
    if not isinstance(channel, InputChannel | PulseChannel):
        raise Status(statuses.ATTRIBUTE_NOT_IN_THIS_TASK, "The task has no channel.", task=task.name)
    known = ("", channel.name.casefold(), channel.physical_name.casefold())
    if name.strip().strip("/").casefold() not in known:
        raise Status(statuses.CHANNEL_NOT_IN_TASK, f"Channel Name: {name}", task=task.name)
    return channel


def _find_terminal(device: Device, name: str) -> str:
    """Find a terminal of a board by its name, with or without that of the board; empty if there is none.

    It is returned without the board. Case does not matter.
    """
    known = {short_name(end): end.split("/", 2)[2] for end in list_terminals(device.kind, device.name)}
    return known.get(short_name(name if "/" in name.strip("/") else f"{device.name}/{name}"), "")


def get_channel_attribute(bench: Bench, task: Task, arguments: Arguments) -> Answer:
    """Answer `DAQmxGetChanAttribute` with an attribute of the task's input or pulse channel.

    Raise Status for another channel, an attribute that it lacks, or a range that the board lacks.
    """
    channel = _require_channel(task, arguments["channel"])
    if isinstance(channel, InputChannel):
        return answer_attribute(_INPUT_CHANNEL, arguments, "Chan", channel)
    return answer_attribute(_PULSE_CHANNEL, arguments, "Chan", channel)


def set_channel_attribute(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxSetChanAttribute`: set an input's coupling (DC only) or a pulse's output terminal.

    Raise Status for other channels, attributes or values, or while the task runs.
    """
    name, value = require_settable(task, arguments, "Chan"), arguments["value"]
    channel = _require_channel(task, arguments["channel"])
    if (name == "AI.Coupling") != isinstance(channel, InputChannel):
        raise Status(statuses.ATTRIBUTE_NOT_IN_THIS_TASK, f"Property: {name}", task=task.name)
    if isinstance(channel, PulseChannel):
        terminal = _find_terminal(channel.device, value)
        taken = bool(terminal)
        channel.terminal = terminal or channel.terminal
    else:
        taken = value == DC_COUPLING
    if not taken:
        raise Status(statuses.INVALID_VALUE, f"Property: {name}\nRequested Value: {value}", task=task.name)
    tasks.mark_changed(task)


TASK_HANDLERS: Mapping[str, TaskHandler] = {
    "DAQmxGetChanAttribute": get_channel_attribute,
    "DAQmxSetChanAttribute": set_channel_attribute,
}
