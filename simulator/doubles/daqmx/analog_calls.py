"""Entry points of analog input: create a channel, configure it, read it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.doubles.daqmx import tasks
from simulator.doubles.daqmx.analog_input import (
    ANALOG_EDGE,
    DEFAULT_CONFIGURATION,
    NO_TRIGGER,
    SAMPLE_CLOCK,
    Acquisition,
    InputChannel,
    get_recorded_codes,
    record_samples,
)
from simulator.doubles.daqmx.routing import short_name
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench, Task, TaskHandler, TaskState
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.statuses import Status


def create_voltage_channel(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxCreateAIVoltageChan`: give an empty task a voltage input channel.

    Raise Status if it has a channel or runs, for a minimum not below the maximum, and for an unknown board,
    input or terminal configuration; the range is checked when the task is verified.
    """
    task.require_empty()
    minimum_v, maximum_v = arguments["min_val"], arguments["max_val"]
    if not minimum_v < maximum_v:
        raise Status(
            statuses.MINIMUM_NOT_BELOW_MAXIMUM, f"AI.Min: {minimum_v}, AI.Max: {maximum_v}", task=task.name
        )
    device, number = bench.devices.channel(arguments["physical_channel"], "ai")
    configuration = arguments["terminal_config"]
    if configuration not in (DEFAULT_CONFIGURATION, device.kind.terminal_configuration):
        detail = f"You Can Select: {device.kind.terminal_configuration}"
        raise statuses.create_rejection(task.name, "AI.TermCfg", detail, requested=configuration)
    task.set_channel(
        "ai",
        InputChannel(
            name=arguments["name_to_assign_to_channel"] or f"{device.name}/ai{number}",
            device=device,
            number=number,
            minimum_v=minimum_v,
            maximum_v=maximum_v,
        ),
    )
    bench.last_channel[task.client] = task.channel.name


def _change_settings(task: Task, settings: Mapping[str, Any]) -> None:
    """Change settings of an input task, which must then be verified again.

    Raise Status if it is no input task, or runs.
    """
    if task.kind != "ai":
        raise Status(
            statuses.NO_CHANNELS if not task.kind else statuses.ATTRIBUTE_NOT_IN_THIS_TASK, task=task.name
        )
    tasks.mark_changed(task)
    task.settings |= settings


def configure_sample_clock(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxCfgSampClkTiming`: set rate, mode and length of the record.

    Raise Status for another clock than the board's own, for no input task, or while it runs; the values are
    checked when the task is verified.
    """
    if short_name(arguments["source"]) not in ("", "onboardclock"):
        detail = "The double samples by the board's own clock only."
        raise statuses.create_rejection(task.name, "SampClk.Src", detail, requested=arguments["source"])
    _change_settings(
        task,
        {
            "SampTimingType": SAMPLE_CLOCK,
            "SampClk.Rate": arguments["rate"],
            "SampQuant.SampMode": arguments["sample_mode"],
            "SampQuant.SampPerChan": arguments["samps_per_chan"],
        },
    )


def configure_reference_trigger(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxCfgAnlgEdgeRefTrig`: set source, slope, level in V and pre-trigger samples of the trigger.

    Raise Status if the task is no input task, or runs; the values are checked when it is verified.
    """
    _change_settings(
        task,
        {
            "RefTrig.Type": ANALOG_EDGE,
            "AnlgEdge.RefTrig.Src": arguments["trigger_source"],
            "AnlgEdge.RefTrig.Slope": arguments["trigger_slope"],
            "AnlgEdge.RefTrig.Lvl": arguments["trigger_level"],
            "RefTrig.PretrigSamples": arguments["pretrigger_samples"],
        },
    )


def disable_reference_trigger(bench: Bench, task: Task, arguments: Arguments) -> None:
    """Answer `DAQmxDisableRefTrig`: record without an analog trigger.

    Raise Status if the task is no input task, or runs.
    """
    _change_settings(task, {"RefTrig.Type": NO_TRIGGER})


def _wait_for_samples(bench: Bench, task: Task, count: int, room: int, timeout_s: float) -> NDArray[Any]:
    """Wait for the record and return its next ``count`` raw codes, shape (count,); negative: the rest.

    A task that does not run is started. Raise Status if the record has fewer left, the caller's buffer
    (``room``) is too small, the task is stopped, or ``timeout_s`` is over (negative: no limit).
    """
    if task.state is not TaskState.RUNNING:
        tasks.start_task(bench, task)
    run: Acquisition = task.run
    left = record_samples(task) - run.read_samples
    wanted = left if count < 0 else count
    refusal = None
    if wanted > left:
        refusal = (
            statuses.SAMPLES_WILL_NEVER_BE_AVAILABLE,
            f"Samples: {wanted}, left of this record: {left}.",
        )
    elif wanted > room:
        refusal = statuses.READ_BUFFER_TOO_SMALL, f"Samples: {wanted}, room for {room}."
    if refusal is not None:
        raise Status(*refusal, task=task.name, values={"samps_per_chan_read": 0})
    late = Status(
        statuses.SAMPLES_NOT_YET_AVAILABLE,
        f"Timeout: {timeout_s} s",
        task=task.name,
        values={"samps_per_chan_read": 0},
    )
    tasks.wait_until_done(bench, task, timeout_s, late)
    codes = None if run.ended else get_recorded_codes(bench, task)
    if codes is None:
        raise late
    first = run.read_samples
    run.read_samples += wanted
    return codes[first : first + wanted]


def _read_raw_codes(dtype: type[np.integer[Any]], bench: Bench, task: Task, arguments: Arguments) -> Answer:
    """Answer `DAQmxReadBinary..` with raw codes of type ``dtype`` and their number; wait for the record.

    Raise Status if the task is no input task, the type is too narrow for the board's codes, or as
    `_wait_for_samples`.
    """
    if task.kind != "ai":
        raise Status(statuses.NOT_AN_INPUT_TASK, task=task.name)
    bits, raw_bits = np.dtype(dtype).itemsize * 8, task.device.kind.raw_sample_bits
    if raw_bits > bits:
        raise Status(
            statuses.READ_TYPE_TOO_SMALL,
            f"Raw samples of {raw_bits} bits, type of {bits}.",
            task=task.name,
            values={"samps_per_chan_read": 0},
        )
    codes = _wait_for_samples(
        bench, task, arguments["num_samps_per_chan"], arguments["array_size_in_samps"], arguments["timeout"]
    )
    return {"read_array": codes.astype(dtype), "samps_per_chan_read": codes.size}


TASK_HANDLERS: Mapping[str, TaskHandler] = {
    "DAQmxCreateAIVoltageChan": create_voltage_channel,
    "DAQmxCfgSampClkTiming": configure_sample_clock,
    "DAQmxCfgAnlgEdgeRefTrig": configure_reference_trigger,
    "DAQmxDisableRefTrig": disable_reference_trigger,
    "DAQmxReadBinaryI16": partial(_read_raw_codes, np.int16),
    "DAQmxReadBinaryI32": partial(_read_raw_codes, np.int32),
}
