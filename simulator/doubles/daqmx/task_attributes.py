"""Attributes of a task as a whole: timing, triggers, reading, buffers, watchdog."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from simulator.doubles.daqmx import analog_calls, analog_input, tasks, watchdog
from simulator.doubles.daqmx.attribute_lookup import Values, attribute_of, listed, look_up, settable
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench, Task, TaskState
from simulator.doubles.vendor_api.statuses import (
    ATTRIBUTE_NOT_IN_THIS_TASK,
    INVALID_VALUE,
    PROPERTY_NEEDS_RESERVED_TASK,
    Status,
)

_TASK: Values = {
    "Task.Name": lambda bench, task: task.name,
    "Task.Channels": lambda bench, task: listed(c.name for c in channels_of(task)),
    "Task.NumChans": lambda bench, task: len(channels_of(task)),
    "Task.Devices": lambda bench, task: listed(_device_names(task)),
    "Task.NumDevices": lambda bench, task: len(_device_names(task)),
}


def channels_of(task: Task) -> list[Any]:
    """Virtual channels; a watchdog has none."""
    return [] if task.kind == "watchdog" else task.channels


def _device_names(task: Task) -> list[str]:
    return list(dict.fromkeys(channel.device.name for channel in task.channels))


def get_task(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetTaskAttribute`."""
    task = tasks.find(bench, client, arguments["task"])
    return look_up(_TASK, attribute_of(arguments, "Task"), bench, task)


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
    task, attribute = _task_with_channels(bench, client, arguments), attribute_of(arguments, "Timing")
    if task.kind == "co" and attribute.name.startswith("SampClk"):
        raise Status(ATTRIBUTE_NOT_IN_THIS_TASK, f"Property: {attribute.name}", task=task.name)
    return look_up(_TIMING, attribute, task)


def set_timing(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxSetTimingAttribute`."""
    task = _task_with_channels(bench, client, arguments)
    attribute, value = settable(task, arguments, "Timing"), arguments["value"]
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
    return look_up(_TRIGGER, attribute_of(arguments, "Trig"), task)


def set_trigger(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxSetTrigAttribute`."""
    task = _task_with_channels(bench, client, arguments)
    attribute = settable(task, arguments, "Trig")
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
    "Read.AvailSampPerChan": analog_calls.available_samples,
    "Read.NumChans": lambda bench, task: len(task.channels),
    "Read.RawDataWidth": lambda bench, task: task.channels[0].device.kind.raw_sample_bits // 8,
    # All there will be: nidaqmx asks for this when a caller reads "all available".
    "Read.DefaultNumSamps": lambda bench, task: analog_input.record_samples(task),
    "Read.OverloadedChansExist": lambda bench, task: int(bool(_overloaded(bench, task))),
    "Read.OverloadedChans": lambda bench, task: listed(_overloaded(bench, task)),
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
    return look_up(_READ, attribute_of(arguments, "Read"), bench, _input_task(bench, client, arguments))


def set_reading(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxSetReadAttribute`."""
    task = _input_task(bench, client, arguments)
    attribute = settable(task, arguments, "Read")
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
    return look_up(_BUFFER, attribute_of(arguments, "Buffer"), _input_task(bench, client, arguments))


def set_buffer(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxSetBufferAttribute`."""
    task = _input_task(bench, client, arguments)
    attribute = settable(task, arguments, "Buffer")
    tasks.changed(task)
    task.settings[attribute.name] = arguments["value"]
    return {}


def get_watchdog(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxGetWatchdogAttribute`."""
    task, attribute = tasks.find(bench, client, arguments["task"]), attribute_of(arguments, "Watchdog")
    if task.kind != "watchdog":
        raise Status(ATTRIBUTE_NOT_IN_THIS_TASK, f"Property: {attribute.name}", task=task.name)
    bench.settle()
    if attribute.name == "Watchdog.HasExpired":
        if task.state < TaskState.RESERVED:
            raise Status(PROPERTY_NEEDS_RESERVED_TASK, f"Property: {attribute.name}", task=task.name)
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
    attribute, value = settable(task, arguments, "Watchdog"), arguments["value"]
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
        attribute = settable(task, arguments, family)
        if family not in ("Read", "Watchdog"):
            tasks.changed(task)
        if attribute.name == "Watchdog.Timeout":
            task.settings["Watchdog.Timeout"] = 10.0
        elif attribute.name == "Watchdog.CO.ExpirState":
            task.settings["expiration"].clear()
        else:
            task.settings.pop(attribute.name, None)
        return {}

    return reset


HANDLERS: Mapping[str, Callable[[Bench, str, Arguments], Answer]] = MappingProxyType(
    {
        "DAQmxGetTaskAttribute": get_task,
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
        "DAQmxResetTimingAttribute": _resetter("Timing"),
        "DAQmxResetTrigAttribute": _resetter("Trig"),
        "DAQmxResetReadAttribute": _resetter("Read"),
        "DAQmxResetBufferAttribute": _resetter("Buffer"),
        "DAQmxResetWatchdogAttribute": _resetter("Watchdog"),
    }
)
