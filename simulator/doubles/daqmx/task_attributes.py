"""Attributes of a task: its name, timing, triggers, and the expiry of its watchdog."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from simulator.doubles.daqmx import analog_input, tasks
from simulator.doubles.daqmx.attribute_lookup import look_up, settable
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench, Task, TaskHandler, TaskState
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import Status

SAMPLE_PERIODS = 10286

Values = Mapping[str, Callable[[Task], object]]
"""By attribute name: how its value is found."""


def _setting(name: str, default: float | str) -> Callable[[Task], object]:
    """Create a function that returns a task's setting, or ``default`` if it was not set."""
    return lambda task: task.settings.get(name, default)


def _terminal(name: str) -> Callable[[Task], object]:
    """Create a function that returns a task's input terminal with its board, ``/Dev1/ai/<name>``."""
    return lambda task: f"/{task.device.name}/ai/{name}"


_TASK: Values = {
    "Task.Name": lambda task: task.name,
    "Task.Channels": lambda task: task.channel.name if task.kind in ("ai", "co") else "",
}
_READING: Values = {"Read.NumChans": lambda task: 1}

_TIMING: Values = {
    "SampClk.Rate": analog_input.rate_hz,
    "RefClk.Rate": _setting("RefClk.Rate", 10e6),
    "RefClk.Src": _setting("RefClk.Src", ""),
}

_TRIGGER: Values = {
    "RefTrig.Type": _setting("RefTrig.Type", analog_input.NO_TRIGGER),
    "AnlgEdge.RefTrig.Slope": _setting("AnlgEdge.RefTrig.Slope", analog_input.RISING_SLOPE),
    "AnlgEdge.RefTrig.Src": _setting("AnlgEdge.RefTrig.Src", ""),
    "AnlgEdge.RefTrig.Lvl": _setting("AnlgEdge.RefTrig.Lvl", 0.0),
    "RefTrig.PretrigSamples": _setting("RefTrig.PretrigSamples", 2),
    "RefTrig.Term": _terminal("ReferenceTrigger"),
    "StartTrig.Type": _setting("StartTrig.Type", analog_input.NO_TRIGGER),
    "StartTrig.Term": _terminal("StartTrigger"),
    "DigEdge.StartTrig.Src": _setting("DigEdge.StartTrig.Src", ""),
    "StartTrig.Delay": analog_input.start_delay_s,
    "StartTrig.DelayUnits": _setting("StartTrig.DelayUnits", SAMPLE_PERIODS),
    "DigEdge.StartTrig.Edge": _setting("DigEdge.StartTrig.Edge", analog_input.RISING_SLOPE),
}


def _get(family: str, values: Values, bench: Bench, task: Task, arguments: Arguments) -> Answer:
    """Answer `DAQmxGet<family>Attribute`; raise Status if the task has no channel or no such attribute."""
    if family != "Task":
        _require_channels(task)
    if family == "Timing" and task.kind == "co":
        raise Status(
            statuses.ATTRIBUTE_NOT_IN_THIS_TASK, "A counter's pulses have no sample clock.", task=task.name
        )
    return look_up(values, arguments, family, task)


def _set(family: str, bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxSet<family>Attribute`; the value is checked when the task is verified.

    Raise Status for a task without channel, a read-only attribute, or while the task runs.
    """
    _require_channels(task)
    name = settable(task, arguments, family)
    tasks.changed(task)
    task.settings[name] = arguments["value"]


def _require_channels(task: Task) -> None:
    """Raise Status if the task is a watchdog or has no channel."""
    if task.kind not in ("ai", "co"):
        raise Status(statuses.ATTRIBUTE_NOT_IN_THIS_TASK, "The task has no channels.", task=task.name)


def _has_expired(task: Task) -> int:
    """Return 1 if the watchdog has expired, else 0; raise Status if the task is not reserved."""
    if task.state < TaskState.RESERVED:
        raise Status(statuses.PROPERTY_NEEDS_RESERVED_TASK, "Property: Watchdog.HasExpired", task=task.name)
    return int(task.run is not None and task.run.expired_ns is not None)


def get_watchdog(bench: Bench, task: Task, arguments: Arguments) -> Answer:
    """Answer `DAQmxGetWatchdogAttribute`; raise Status if the task is no watchdog."""
    if task.kind != "watchdog":
        raise Status(statuses.ATTRIBUTE_NOT_IN_THIS_TASK, "The task is no watchdog.", task=task.name)
    bench.settle()
    return look_up({"Watchdog.HasExpired": _has_expired}, arguments, "Watchdog", task)


TASK_HANDLERS: Mapping[str, TaskHandler] = {
    "DAQmxGetTaskAttribute": partial(_get, "Task", _TASK),
    "DAQmxGetTimingAttribute": partial(_get, "Timing", _TIMING),
    "DAQmxSetTimingAttribute": partial(_set, "Timing"),
    "DAQmxGetTrigAttribute": partial(_get, "Trig", _TRIGGER),
    "DAQmxSetTrigAttribute": partial(_set, "Trig"),
    "DAQmxGetReadAttribute": partial(_get, "Read", _READING),
    "DAQmxGetWatchdogAttribute": get_watchdog,
}
