"""Reading and setting attributes: one function a family, values as boards report them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from simulator.doubles import analog_input, tasks, watchdog
from simulator.doubles.analog_input import InputChannel
from simulator.doubles.attributes import ATTRIBUTES, Attribute
from simulator.doubles.boards import terminals
from simulator.doubles.counter_output import COUNTER_BITS, HIGH, LOW, SECONDS, TIMEBASE_HZ, PulseChannel
from simulator.doubles.devices import Device
from simulator.doubles.routing import short_name
from simulator.doubles.statuses import (
    ATTRIBUTE_NOT_IN_THIS_TASK,
    ATTRIBUTE_NOT_SETTABLE,
    ATTRIBUTE_NOT_SUPPORTED,
    INVALID_VALUE,
    NO_SUCH_ATTRIBUTE,
    PROPERTY_WHILE_RUNNING,
    Status,
)
from simulator.doubles.tasks import Answer, Arguments, Bench, Task, TaskState

Values = Mapping[str, Callable[..., Any]]

COUNTER_OUTPUT = 10132
PULSE_TIME = 10269
DMA = 10054
DC_COUPLING = 1
REFERENCE_AND_START = 8 + 4


def _attribute(arguments: Arguments, family: str) -> Attribute:
    found = ATTRIBUTES.get(arguments["attribute"])
    if found is None or found.family != family:
        raise Status(NO_SUCH_ATTRIBUTE, f"{family} attribute {arguments['attribute']:#x}")
    return found


def _look_up(values: Values, attribute: Attribute, *subject: Any) -> Answer:
    if attribute.name not in values:
        raise Status(ATTRIBUTE_NOT_SUPPORTED, f"Property: {attribute.name}")
    return {"value": values[attribute.name](*subject)}


def _names(items: Any) -> str:
    return ", ".join(items)


def _counters(device: Device) -> str:
    return _names(f"{device.name}/ctr{n}" for n in range(len(device.kind.counter_terminals)))


def _ports(device: Device) -> str:
    ports = dict.fromkeys(line.partition("/")[0] for line in device.kind.digital_lines)
    return _names(f"{device.name}/{port}" for port in ports)


# System and boards

_SYSTEM: Values = {
    "Sys.NIDAQMajorVersion": lambda bench: bench.description.driver_version[0],
    "Sys.NIDAQMinorVersion": lambda bench: bench.description.driver_version[1],
    "Sys.NIDAQUpdateVersion": lambda bench: bench.description.driver_version[2],
    "Sys.DevNames": lambda bench: _names(device.name for device in bench.devices.present()),
    "Sys.Tasks": lambda bench: "",
    "Sys.GlobalChans": lambda bench: "",
    "Sys.Scales": lambda bench: "",
}

_DEVICE: Values = {
    "Dev.ProductType": lambda d: d.kind.product,
    "Dev.ProductNum": lambda d: d.kind.number,
    "Dev.ProductCategory": lambda d: d.kind.category,
    "Dev.BusType": lambda d: d.kind.bus,
    "Dev.SerialNum": lambda d: d.serial_number,
    # A double passes for hardware: `doctor` and drivers shall take the real path.
    "Dev.IsSimulated": lambda d: 0,
    "Dev.PXI.ChassisNum": lambda d: d.parameters.chassis,
    "Dev.PXI.SlotNum": lambda d: d.parameters.slot,
    "Dev.PCI.BusNum": lambda d: d.parameters.slot,
    "Dev.PCI.DevNum": lambda d: 0,
    "Dev.NumDMAChans": lambda d: 8,
    "Dev.Terminals": lambda d: _names(terminals(d.kind, d.name)),
    "Dev.Accessory.ProductTypes": lambda d: "",
    "Dev.AI.PhysicalChans": lambda d: _names(f"{d.name}/ai{n}" for n in range(d.kind.analog_inputs)),
    "Dev.AO.PhysicalChans": lambda d: "",
    "Dev.CI.PhysicalChans": _counters,
    "Dev.CO.PhysicalChans": lambda d: _names([_counters(d), f"{d.name}/freqout"]),
    "Dev.DI.Lines": lambda d: _names(f"{d.name}/{line}" for line in d.kind.digital_lines),
    "Dev.DO.Lines": lambda d: _names(f"{d.name}/{line}" for line in d.kind.digital_lines),
    "Dev.DI.Ports": _ports,
    "Dev.DO.Ports": _ports,
    "Dev.AI.SimultaneousSamplingSupported": lambda d: int(d.kind.simultaneous),
    "Dev.AI.MaxSingleChanRate": lambda d: d.kind.max_rate_hz,
    "Dev.AI.MaxMultiChanRate": lambda d: d.kind.max_rate_hz,
    "Dev.AI.MinRate": lambda d: d.kind.timebase_hz / 2**COUNTER_BITS,
    "Dev.AI.NumSampTimingEngines": lambda d: 1,
    "Dev.AI.VoltageRngs": lambda d: [end for r in d.kind.ranges_v for end in (-r, r)],
    "Dev.AI.SupportedMeasTypes": lambda d: [analog_input.VOLTAGE],
    "Dev.AI.SampModes": lambda d: [analog_input.FINITE],
    "Dev.AI.TrigUsage": lambda d: REFERENCE_AND_START,
    "Dev.AI.Couplings": lambda d: DC_COUPLING,
    "Dev.AnlgTrigSupported": lambda d: int(d.kind.simultaneous),
    "Dev.DigTrigSupported": lambda d: 1,
    "Dev.CO.MaxSize": lambda d: COUNTER_BITS,
    "Dev.CO.MaxTimebase": lambda d: TIMEBASE_HZ,
    "Dev.CO.SampClkSupported": lambda d: 0,
    "Dev.CO.SupportedOutputTypes": lambda d: [PULSE_TIME],
    "Dev.CO.SampModes": lambda d: [10178, 10123],
    "Dev.CO.TrigUsage": lambda d: 8,
}

_CALIBRATION: Values = {
    "SelfCal.Supported": lambda d: 1,
    "SelfCal.LastTemp": lambda d: d.calibration_temperature_c,
    "ExtCal.LastTemp": lambda d: d.parameters.temperature_c,
    "Cal.DevTemp": lambda d: d.parameters.temperature_c,
    "Cal.UserDefinedInfo": lambda d: "",
}


def get_system(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetSystemInfoAttribute`."""
    return _look_up(_SYSTEM, _attribute(arguments, "SystemInfo"), bench)


def get_device(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetDeviceAttribute`."""
    device = bench.devices.find(arguments["device_name"])
    return _look_up(_DEVICE, _attribute(arguments, "Device"), device)


def get_calibration(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetCalInfoAttribute`."""
    device = bench.devices.find(arguments["device_name"])
    return _look_up(_CALIBRATION, _attribute(arguments, "CalInfo"), device)


def get_physical_channel(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetPhysicalChanAttribute`."""
    attribute, name = _attribute(arguments, "PhysicalChan"), arguments["physical_channel"]
    if attribute.name == "PhysicalChan.CO.SupportedOutputTypes":
        bench.devices.channels(name, "ctr")
        return {"value": [PULSE_TIME]}
    ((device, _),) = bench.devices.channels(name, "ai")[:1]
    if attribute.name == "PhysicalChan.AI.SupportedMeasTypes":
        return {"value": [analog_input.VOLTAGE]}
    pseudo = device.kind.terminal_configuration != 10106
    # Bits: 1 RSE, 2 NRSE, 4 differential, 8 pseudodifferential.
    return {"value": 8 if pseudo else 4}


# Tasks

_TASK: Values = {
    "Task.Name": lambda bench, task: task.name,
    "Task.Channels": lambda bench, task: _names(c.name for c in _channels(task)),
    "Task.NumChans": lambda bench, task: len(_channels(task)),
    "Task.Devices": lambda bench, task: _names(_device_names(task)),
    "Task.NumDevices": lambda bench, task: len(_device_names(task)),
}


def _channels(task: Task) -> list[Any]:
    return [] if task.kind == "watchdog" else task.channels


def _device_names(task: Task) -> list[str]:
    return list(dict.fromkeys(channel.device.name for channel in task.channels))


def get_task(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetTaskAttribute`."""
    task = tasks.find(bench, client, arguments["task"])
    return _look_up(_TASK, _attribute(arguments, "Task"), bench, task)


# Channels

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
    "AI.RawSampJustification": lambda task, c: 10209,
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
    channels = _channels(task)
    if not channels:
        raise Status(ATTRIBUTE_NOT_IN_THIS_TASK, "The task has no channels.", task=task.name)
    wanted = name.split(",")[0].strip().strip("/").casefold()
    for channel in channels:
        if wanted in ("", channel.name.casefold(), channel.physical_name.casefold()):
            return channel
    raise Status(INVALID_VALUE, f"Channel Name: {name} is not in the task.", task=task.name)


def get_channel(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetChanAttribute`."""
    task = tasks.find(bench, client, arguments["task"])
    attribute = _attribute(arguments, "Chan")
    channel = _named_channel(task, arguments["channel"])
    if attribute.name in ("CO.OutputState", "CO.PulseDone", "CO.Count") and task.kind == "co":
        return {"value": _output_now(bench, task, channel, attribute.name)}
    return _look_up(_INPUT_CHANNEL if task.kind == "ai" else _PULSE_CHANNEL, attribute, task, channel)


def _output_now(bench: Bench, task: Task, channel: PulseChannel, name: str) -> int:
    bench.settle()
    if name == "CO.OutputState":
        return HIGH if bench.lines.level(channel.line) else LOW
    return int(tasks.is_done(bench, task)) if name == "CO.PulseDone" else 0


def set_channel(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxSetChanAttribute`."""
    task = tasks.find(bench, client, arguments["task"])
    attribute = _settable(task, arguments, "Chan")
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


def _settable(task: Task, arguments: Arguments, family: str) -> Attribute:
    attribute = _attribute(arguments, family)
    if not attribute.settable:
        raise Status(ATTRIBUTE_NOT_SETTABLE, f"Property: {attribute.name}", task=task.name)
    if task.state is TaskState.RUNNING and family not in ("Read", "Watchdog"):
        raise Status(PROPERTY_WHILE_RUNNING, f"Property: {attribute.name}", task=task.name)
    return attribute


# Timing, triggers, reading: settings of the task, coerced where boards coerce

_TIMING: Values = {
    "SampClk.Rate": analog_input.rate_hz,
    "SampClk.MaxRate": lambda task: task.channels[0].device.kind.rate_limit_hz(len(task.channels)),
    "SampClk.Timebase.Rate": lambda task: task.channels[0].device.kind.timebase_hz,
    "SampClk.TimebaseDiv": lambda task: round(
        task.channels[0].device.kind.timebase_hz / analog_input.rate_hz(task)
    ),
    "SampClk.Timebase.Src": lambda task: f"/{task.channels[0].device.name}/100MHzTimebase",
    "SampClk.Src": lambda task: f"/{task.channels[0].device.name}/ai/SampleClockTimebase",
    "SampClk.Term": lambda task: f"/{task.channels[0].device.name}/ai/SampleClock",
    "RefClk.Rate": lambda task: task.settings.get("RefClk.Rate", 10e6),
    "RefClk.Src": lambda task: task.settings.get("RefClk.Src", ""),
    "SampTimingEngine": lambda task: task.settings.get("SampTimingEngine", 0),
    "SampTimingType": lambda task: task.settings.get("SampTimingType", 10390),
    "SampClk.ActiveEdge": lambda task: task.settings.get("SampClk.ActiveEdge", 10280),
    "SampQuant.SampMode": lambda task: task.settings.get("SampQuant.SampMode", 10178),
    "SampQuant.SampPerChan": lambda task: int(
        task.settings.get("SampQuant.SampPerChan", 1 if task.kind == "co" else 1000)
    ),
}

_TRIGGER: Values = {
    "RefTrig.Type": lambda task: task.settings.get("RefTrig.Type", analog_input.NO_TRIGGER),
    "AnlgEdge.RefTrig.Slope": lambda task: task.settings.get("AnlgEdge.RefTrig.Slope", 10280),
    "AnlgEdge.RefTrig.Src": lambda task: task.settings.get("AnlgEdge.RefTrig.Src", ""),
    "AnlgEdge.RefTrig.Lvl": lambda task: task.settings.get("AnlgEdge.RefTrig.Lvl", 0.0),
    "AnlgEdge.RefTrig.Hyst": lambda task: task.settings.get("AnlgEdge.RefTrig.Hyst", 0.0),
    "RefTrig.PretrigSamples": lambda task: task.settings.get("RefTrig.PretrigSamples", 2),
    "RefTrig.Term": lambda task: f"/{task.channels[0].device.name}/ai/ReferenceTrigger",
    "StartTrig.Type": lambda task: task.settings.get("StartTrig.Type", analog_input.NO_TRIGGER),
    "StartTrig.Term": lambda task: f"/{task.channels[0].device.name}/ai/StartTrigger",
    "StartTrig.Retriggerable": lambda task: 0,
    "DigEdge.StartTrig.Src": lambda task: task.settings.get("DigEdge.StartTrig.Src", ""),
    "DigEdge.StartTrig.Edge": lambda task: task.settings.get("DigEdge.StartTrig.Edge", 10280),
}


def get_timing(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetTimingAttribute`."""
    task, attribute = _task_with_channels(bench, client, arguments), _attribute(arguments, "Timing")
    if task.kind == "co" and attribute.name.startswith("SampClk"):
        raise Status(ATTRIBUTE_NOT_IN_THIS_TASK, f"Property: {attribute.name}", task=task.name)
    return _look_up(_TIMING, attribute, task)


def set_timing(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxSetTimingAttribute`."""
    task = _task_with_channels(bench, client, arguments)
    attribute, value = _settable(task, arguments, "Timing"), arguments["value"]
    if attribute.name == "SampTimingEngine" and value != 0:
        raise Status(
            INVALID_VALUE,
            f"Property: {attribute.name}\nRequested Value: {value}\nMaximum Value: 0",
            task=task.name,
        )
    tasks.changed(task)
    task.settings[attribute.name] = value
    return {}


def get_trigger(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetTrigAttribute`."""
    task = _task_with_channels(bench, client, arguments)
    return _look_up(_TRIGGER, _attribute(arguments, "Trig"), task)


def set_trigger(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxSetTrigAttribute`."""
    task = _task_with_channels(bench, client, arguments)
    attribute = _settable(task, arguments, "Trig")
    if attribute.name == "StartTrig.Retriggerable" and arguments["value"]:
        raise Status(
            INVALID_VALUE, f"Property: {attribute.name}\nThe double does not retrigger.", task=task.name
        )
    tasks.changed(task)
    task.settings[attribute.name] = arguments["value"]
    return {}


def _task_with_channels(bench: Bench, client: str, arguments: Arguments) -> Task:
    task = tasks.find(bench, client, arguments["task"])
    if task.kind not in ("ai", "co"):
        raise Status(ATTRIBUTE_NOT_IN_THIS_TASK, "The task has no channels.", task=task.name)
    return task


_READ: Values = {
    "Read.AvailSampPerChan": analog_input.available_samples,
    "Read.NumChans": lambda bench, task: len(task.channels),
    "Read.RawDataWidth": lambda bench, task: task.channels[0].device.kind.raw_sample_bits // 8,
    # All there will be: nidaqmx asks for this when a caller reads "all available".
    "Read.DefaultNumSamps": lambda bench, task: analog_input.record_samples(task),
    "Read.OverloadedChansExist": lambda bench, task: int(bool(_overloaded(bench, task))),
    "Read.OverloadedChans": lambda bench, task: _names(_overloaded(bench, task)),
    "Read.AutoStart": lambda bench, task: task.settings.get("Read.AutoStart", 1),
    "Read.ReadAllAvailSamp": lambda bench, task: task.settings.get("Read.ReadAllAvailSamp", 0),
    "Read.TotalSampPerChanAcquired": lambda bench, task: (
        analog_input.record_samples(task) if tasks.is_done(bench, task) and task.run is not None else 0
    ),
    "Read.CurrReadPos": lambda bench, task: 0 if task.run is None else task.run.read_samples,
}


def _overloaded(bench: Bench, task: Task) -> list[str]:
    if task.run is None or task.run.codes is None or not tasks.is_done(bench, task):
        return []
    overloaded = []
    for channel, codes in zip(task.channels, task.run.codes, strict=True):
        low, high = channel.calibration.full_scale_counts
        if np.any((codes <= low) | (codes >= high)):
            overloaded.append(channel.name)
    return overloaded


def get_reading(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetReadAttribute`."""
    return _look_up(_READ, _attribute(arguments, "Read"), bench, _input_task(bench, client, arguments))


def set_reading(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxSetReadAttribute`."""
    task = _input_task(bench, client, arguments)
    attribute = _settable(task, arguments, "Read")
    task.settings[attribute.name] = arguments["value"]
    return {}


def _input_task(bench: Bench, client: str, arguments: Arguments) -> Task:
    task = tasks.find(bench, client, arguments["task"])
    if task.kind != "ai":
        raise Status(ATTRIBUTE_NOT_IN_THIS_TASK, "The task has no input channels.", task=task.name)
    return task


_BUFFER: Values = {
    "Buf.Input.BufSize": lambda task: task.settings.get(
        "Buf.Input.BufSize", analog_input.record_samples(task)
    ),
    "Buf.Input.OnbrdBufSize": lambda task: 4095,
}


def get_buffer(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetBufferAttribute`."""
    return _look_up(_BUFFER, _attribute(arguments, "Buffer"), _input_task(bench, client, arguments))


def set_buffer(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxSetBufferAttribute`."""
    task = _input_task(bench, client, arguments)
    attribute = _settable(task, arguments, "Buffer")
    tasks.changed(task)
    task.settings[attribute.name] = arguments["value"]
    return {}


def get_watchdog(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetWatchdogAttribute`."""
    task, attribute = tasks.find(bench, client, arguments["task"]), _attribute(arguments, "Watchdog")
    if task.kind != "watchdog":
        raise Status(ATTRIBUTE_NOT_IN_THIS_TASK, f"Property: {attribute.name}", task=task.name)
    bench.settle()
    if attribute.name == "Watchdog.HasExpired":
        return {"value": int(task.run is not None and task.run.expired_ns is not None)}
    if attribute.name == "Watchdog.CO.ExpirState":
        ((_, number),) = bench.devices.channels(arguments["lines"], "ctr")
        return {"value": task.settings["expiration"].get(number, watchdog.NO_CHANGE)}
    return {"value": task.settings["Watchdog.Timeout"]}


def set_watchdog(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxSetWatchdogAttribute`."""
    task = tasks.find(bench, client, arguments["task"])
    if task.kind != "watchdog":
        raise Status(ATTRIBUTE_NOT_IN_THIS_TASK, task=task.name)
    attribute, value = _settable(task, arguments, "Watchdog"), arguments["value"]
    if attribute.name == "Watchdog.CO.ExpirState":
        for device, number in bench.devices.channels(arguments["lines"], "ctr"):
            watchdog.set_expiration_state(task, device, number, value)
        return {}
    task.settings["Watchdog.Timeout"] = watchdog.checked_timeout_s(value, task.name)
    if task.run is not None:
        task.run.timeout_s = value
    return {}


def _resetter(family: str) -> Callable[[Bench, str, Arguments], Answer]:
    def reset(bench: Bench, client: str, arguments: Arguments) -> Answer:
        """Forget what was set, so the default holds again."""
        task = tasks.find(bench, client, arguments["task"])
        attribute = _settable(task, arguments, family)
        if family not in ("Read", "Watchdog"):
            tasks.changed(task)
        if attribute.name == "Watchdog.Timeout":
            task.settings["Watchdog.Timeout"] = 10.0
        elif attribute.name == "Watchdog.CO.ExpirState":
            task.settings["expiration"].clear()
        elif family == "Chan":
            raise Status(
                ATTRIBUTE_NOT_SUPPORTED, f"Property: {attribute.name} cannot be reset.", task=task.name
            )
        else:
            task.settings.pop(attribute.name, None)
        return {}

    return reset


HANDLERS: Mapping[str, Callable[[Bench, str, Arguments], Answer]] = MappingProxyType(
    {
        "DAQmxGetSystemInfoAttribute": get_system,
        "DAQmxGetDeviceAttribute": get_device,
        "DAQmxGetCalInfoAttribute": get_calibration,
        "DAQmxGetPhysicalChanAttribute": get_physical_channel,
        "DAQmxGetTaskAttribute": get_task,
        "DAQmxGetChanAttribute": get_channel,
        "DAQmxSetChanAttribute": set_channel,
        "DAQmxGetTimingAttribute": get_timing,
        "DAQmxSetTimingAttribute": set_timing,
        "DAQmxGetTrigAttribute": get_trigger,
        "DAQmxSetTrigAttribute": set_trigger,
        "DAQmxGetReadAttribute": get_reading,
        "DAQmxSetReadAttribute": set_reading,
        "DAQmxGetBufferAttribute": get_buffer,
        "DAQmxSetBufferAttribute": set_buffer,
        "DAQmxGetWatchdogAttribute": get_watchdog,
        "DAQmxSetWatchdogAttribute": set_watchdog,
        **{
            f"DAQmxReset{family}Attribute": _resetter(family)
            for family in ("Chan", "Timing", "Trig", "Read", "Buffer", "Watchdog")
        },
    }
)
