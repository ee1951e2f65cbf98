"""Attributes of a task: its name, timing, triggers, and the expiry of its watchdog."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from simulator.doubles.daqmx import analog_input, tasks
from simulator.doubles.daqmx.attribute_lookup import answer_attribute, require_settable
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench, Task, TaskHandler, TaskState
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import Status

SAMPLE_PERIODS = 10286

Values = Mapping[str, Callable[[Task], object]]
"""By attribute name: how its value is found."""


def _build_setting_getter(name: str, default: float | str) -> Callable[[Task], object]:
    """Create a function that returns a task's setting by attribute name, or ``default`` if it was not set."""
    return lambda task: task.settings.get(name, default)


def _build_terminal_getter(name: str) -> Callable[[Task], object]:
    """Create a function that returns a task's input terminal with its board, ``/Dev1/ai/<name>``."""
    return lambda task: f"/{task.device.name}/ai/{name}"


_TASK: Values = {
    "Task.Name": lambda task: task.name,
    "Task.Channels": lambda task: task.channel.name if task.kind in ("ai", "co") else "",
}
_READING: Values = {"Read.NumChans": lambda task: 1}

_TIMING: Values = {
    "SampClk.Rate": analog_input.rate_hz,
    "RefClk.Rate": _build_setting_getter("RefClk.Rate", 10e6),
    "RefClk.Src": _build_setting_getter("RefClk.Src", ""),
}

_TRIGGER: Values = {
    "RefTrig.Type": _build_setting_getter("RefTrig.Type", analog_input.NO_TRIGGER),
    "AnlgEdge.RefTrig.Slope": _build_setting_getter("AnlgEdge.RefTrig.Slope", analog_input.RISING_SLOPE),
    "AnlgEdge.RefTrig.Src": _build_setting_getter("AnlgEdge.RefTrig.Src", ""),
    "AnlgEdge.RefTrig.Lvl": _build_setting_getter("AnlgEdge.RefTrig.Lvl", 0.0),
    "RefTrig.PretrigSamples": _build_setting_getter("RefTrig.PretrigSamples", 2),
    "RefTrig.Term": _build_terminal_getter("ReferenceTrigger"),
    "StartTrig.Type": _build_setting_getter("StartTrig.Type", analog_input.NO_TRIGGER),
    "StartTrig.Term": _build_terminal_getter("StartTrigger"),
    "DigEdge.StartTrig.Src": _build_setting_getter("DigEdge.StartTrig.Src", ""),
    "StartTrig.Delay": analog_input.start_delay_s,
    "StartTrig.DelayUnits": _build_setting_getter("StartTrig.DelayUnits", SAMPLE_PERIODS),
    "DigEdge.StartTrig.Edge": _build_setting_getter("DigEdge.StartTrig.Edge", analog_input.RISING_SLOPE),
}


def _get_attribute(family: str, values: Values, bench: Bench, task: Task, arguments: Arguments) -> Answer:
    """Answer `DAQmxGet<family>Attribute`; raise Status if the task has no channel or no such attribute.

    The family Task needs no channel; a pulse task has no Timing attributes.
    """
    if family != "Task":
        _require_channel_task(task)
    if family == "Timing" and task.kind == "co":
        raise Status(
            statuses.ATTRIBUTE_NOT_IN_THIS_TASK, "A counter's pulses have no sample clock.", task=task.name
        )
    return answer_attribute(values, arguments, family, task)


def _set_attribute(family: str, bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxSet<family>Attribute`: store the value, which is checked when the task is verified.

    Raise Status for a task without channel, an unknown or read-only attribute, or while the task runs.
    """
    _require_channel_task(task)
    name = require_settable(task, arguments, family)
    tasks.mark_changed(task)
    task.settings[name] = arguments["value"]


def _require_channel_task(task: Task) -> None:
    """Raise Status if the task is a watchdog or has no channel."""
    if task.kind not in ("ai", "co"):
        raise Status(statuses.ATTRIBUTE_NOT_IN_THIS_TASK, "The task has no channels.", task=task.name)


def _get_expired_flag(task: Task) -> int:
    """Return 1 if the watchdog has expired, else 0; raise Status if the task is not reserved."""
    if task.state < TaskState.RESERVED:
        raise Status(statuses.PROPERTY_NEEDS_RESERVED_TASK, "Property: Watchdog.HasExpired", task=task.name)
    return int(task.run is not None and task.run.expired_ns is not None)


def get_watchdog_attribute(bench: Bench, task: Task, arguments: Arguments) -> Answer:
    """Answer `DAQmxGetWatchdogAttribute` with 1 if the watchdog has expired, else 0.

    Raise Status if the task is no watchdog or not reserved, or for another attribute.
    """
    if task.kind != "watchdog":
        raise Status(statuses.ATTRIBUTE_NOT_IN_THIS_TASK, "The task is no watchdog.", task=task.name)
    bench.settle()
    return answer_attribute({"Watchdog.HasExpired": _get_expired_flag}, arguments, "Watchdog", task)


TASK_HANDLERS: Mapping[str, TaskHandler] = {
    "DAQmxGetTaskAttribute": partial(_get_attribute, "Task", _TASK),
    "DAQmxGetTimingAttribute": partial(_get_attribute, "Timing", _TIMING),
    "DAQmxSetTimingAttribute": partial(_set_attribute, "Timing"),
    "DAQmxGetTrigAttribute": partial(_get_attribute, "Trig", _TRIGGER),
    "DAQmxSetTrigAttribute": partial(_set_attribute, "Trig"),
    "DAQmxGetReadAttribute": partial(_get_attribute, "Read", _READING),
    "DAQmxGetWatchdogAttribute": get_watchdog_attribute,
}
