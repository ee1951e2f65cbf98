"""Entry points of analog input: making channels, setting them up, reading them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.doubles.daqmx import tasks
from simulator.doubles.daqmx.analog_input import (
    ANALOG_EDGE,
    DEFAULT_CONFIGURATION,
    GROUP_BY_CHANNEL,
    NO_TRIGGER,
    SAMPLE_CLOCK,
    Acquisition,
    InputChannel,
    record_samples,
)
from simulator.doubles.daqmx.routing import short_name
from simulator.doubles.daqmx.tasks import Answer, Arguments, Bench, Task, TaskState
from simulator.doubles.vendor_api.statuses import (
    ATTRIBUTE_NOT_IN_THIS_TASK,
    CHANNEL_ALREADY_IN_TASK,
    DIFFERENT_CHANNEL_TYPES,
    INVALID_VALUE,
    MINIMUM_NOT_BELOW_MAXIMUM,
    NO_AUTO_START,
    NO_CHANNELS,
    NOT_AN_INPUT_TASK,
    READ_BUFFER_TOO_SMALL,
    READ_TYPE_TOO_SMALL,
    SAMPLES_NOT_YET_AVAILABLE,
    SAMPLES_WILL_NEVER_BE_AVAILABLE,
    Status,
)


def create_voltage_channels(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxCreateAIVoltageChan`."""
    task = tasks.find(bench, client, arguments["task"])
    task.require_not_running()
    if task.kind not in ("", "ai"):
        raise Status(DIFFERENT_CHANNEL_TYPES, task=task.name)
    minimum_v, maximum_v = arguments["min_val"], arguments["max_val"]
    if not minimum_v < maximum_v:
        raise Status(MINIMUM_NOT_BELOW_MAXIMUM, f"AI.Min: {minimum_v}, AI.Max: {maximum_v}", task=task.name)
    physical = bench.devices.channels(arguments["physical_channel"], "ai")
    configuration, given = arguments["terminal_config"], arguments["name_to_assign_to_channel"]
    for index, (device, number) in enumerate(physical):
        if configuration not in (DEFAULT_CONFIGURATION, device.kind.terminal_configuration):
            raise Status(
                INVALID_VALUE,
                f"Property: AI.TermCfg\nRequested Value: {configuration}\n"
                f"You Can Select: {device.kind.terminal_configuration}",
                task=task.name,
            )
        name = f"{given}{index}" if given and len(physical) > 1 else given or f"{device.name}/ai{number}"
        if name.casefold() in (channel.name.casefold() for channel in task.channels):
            raise Status(CHANNEL_ALREADY_IN_TASK, f"Channel Name: {name}", task=task.name)
        task.channels.append(
            InputChannel(name=name, device=device, number=number, minimum_v=minimum_v, maximum_v=maximum_v)
        )
    task.kind, task.state, task.verified = "ai", TaskState.UNVERIFIED, False
    bench.last_channel[client] = ", ".join(channel.name for channel in task.channels[-len(physical) :])
    return {}


def configure_sample_clock(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxCfgSampClkTiming`."""
    task = tasks.find(bench, client, arguments["task"])
    if task.kind != "ai":
        raise Status(NO_CHANNELS if not task.kind else ATTRIBUTE_NOT_IN_THIS_TASK, task=task.name)
    tasks.changed(task)
    if short_name(arguments["source"]) not in ("", "onboardclock"):
        raise Status(
            INVALID_VALUE,
            f"Property: SampClk.Src\nRequested Value: {arguments['source']}\n"
            "The double samples by the board's own clock only.",
            task=task.name,
        )
    task.settings |= {
        "SampTimingType": SAMPLE_CLOCK,
        "SampClk.Rate": arguments["rate"],
        "SampClk.ActiveEdge": arguments["active_edge"],
        "SampQuant.SampMode": arguments["sample_mode"],
        "SampQuant.SampPerChan": arguments["samps_per_chan"],
    }
    return {}


def configure_reference_trigger(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxCfgAnlgEdgeRefTrig`."""
    task = tasks.find(bench, client, arguments["task"])
    if task.kind != "ai":
        raise Status(NO_CHANNELS if not task.kind else ATTRIBUTE_NOT_IN_THIS_TASK, task=task.name)
    tasks.changed(task)
    task.settings |= {
        "RefTrig.Type": ANALOG_EDGE,
        "AnlgEdge.RefTrig.Src": arguments["trigger_source"],
        "AnlgEdge.RefTrig.Slope": arguments["trigger_slope"],
        "AnlgEdge.RefTrig.Lvl": arguments["trigger_level"],
        "RefTrig.PretrigSamples": arguments["pretrigger_samples"],
    }
    return {}


def disable_reference_trigger(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxDisableRefTrig`."""
    task = tasks.find(bench, client, arguments["task"])
    tasks.changed(task)
    task.settings["RefTrig.Type"] = NO_TRIGGER
    return {}


def available_samples(bench: Bench, task: Task) -> int:
    """Count the samples a channel that a read would hand out at once."""
    if task.state is not TaskState.RUNNING or not tasks.is_done(bench, task):
        return 0
    return record_samples(task) - int(task.run.read_samples)


def _samples(bench: Bench, task: Task, count: int, room: int, timeout_s: float) -> NDArray[Any]:
    """Wait for samples and take them, shape (channels, count)."""
    if task.kind != "ai":
        raise Status(NOT_AN_INPUT_TASK, task=task.name)
    if task.state is not TaskState.RUNNING:
        if not task.settings.get("Read.AutoStart", 1):
            raise Status(NO_AUTO_START, task=task.name)
        tasks.start(bench, task)
    run: Acquisition = task.run
    left = record_samples(task) - run.read_samples
    wanted = left if count < 0 else count
    if wanted > left:
        raise Status(
            SAMPLES_WILL_NEVER_BE_AVAILABLE,
            f"Samples asked for: {wanted}, left of this record: {left}.",
            task=task.name,
            values={"samps_per_chan_read": 0},
        )
    if wanted * len(task.channels) > room:
        raise Status(
            READ_BUFFER_TOO_SMALL,
            f"Samples: {wanted} of {len(task.channels)} channels, room for {room}.",
            task=task.name,
            values={"samps_per_chan_read": 0},
        )
    late = Status(
        SAMPLES_NOT_YET_AVAILABLE,
        f"Timeout: {timeout_s} s",
        task=task.name,
        values={"samps_per_chan_read": 0, "samps_read": 0},
    )
    tasks.wait(bench, task, timeout_s, late)
    if run.codes is None or run.ended:
        raise late
    first = run.read_samples
    run.read_samples += wanted
    return run.codes[:, first : first + wanted]


def _reader(dtype: type[np.integer[Any]]) -> Callable[[Bench, str, Arguments], Answer]:
    bits = np.dtype(dtype).itemsize * 8

    def read(bench: Bench, client: str, arguments: Arguments) -> Answer:
        """`DAQmxReadBinary..`: raw codes in the width asked for."""
        task = tasks.find(bench, client, arguments["task"])
        if task.kind == "ai" and task.channels[0].device.kind.raw_sample_bits > bits:
            raise Status(
                READ_TYPE_TOO_SMALL,
                f"Raw samples of {task.channels[0].device.kind.raw_sample_bits} bits, type of {bits}.",
                task=task.name,
                values={"samps_per_chan_read": 0},
            )
        codes = _samples(
            bench,
            task,
            arguments["num_samps_per_chan"],
            arguments["array_size_in_samps"],
            arguments["timeout"],
        )
        ordered = codes if arguments["fill_mode"] == GROUP_BY_CHANNEL else codes.T
        return {
            "read_array": ordered.reshape(-1).astype(dtype),
            "samps_per_chan_read": codes.shape[1],
        }

    return read


def read_raw(bench: Bench, client: str, arguments: Arguments) -> Answer:
    """`DAQmxReadRaw`: codes interleaved, in the board's own width."""
    task = tasks.find(bench, client, arguments["task"])
    if task.kind != "ai":
        raise Status(NOT_AN_INPUT_TASK, task=task.name)
    width = task.channels[0].device.kind.raw_sample_bits // 8
    codes = _samples(
        bench,
        task,
        arguments["num_samps_per_chan"],
        arguments["array_size_in_bytes"] // width,
        arguments["timeout"],
    )
    packed = codes.T.reshape(-1).astype(f"<i{width}")
    return {
        "read_array": np.frombuffer(packed.tobytes(), dtype=np.uint8),
        "samps_read": codes.shape[1],
        "num_bytes_per_samp": width,
    }


HANDLERS: Mapping[str, Callable[[Bench, str, Arguments], Answer]] = MappingProxyType(
    {
        "DAQmxCreateAIVoltageChan": create_voltage_channels,
        "DAQmxCfgSampClkTiming": configure_sample_clock,
        "DAQmxCfgAnlgEdgeRefTrig": configure_reference_trigger,
        "DAQmxDisableRefTrig": disable_reference_trigger,
        "DAQmxReadBinaryI16": _reader(np.int16),
        "DAQmxReadBinaryI32": _reader(np.int32),
        "DAQmxReadBinaryU16": _reader(np.uint16),
        "DAQmxReadBinaryU32": _reader(np.uint32),
        "DAQmxReadRaw": read_raw,
    }
)
