"""Doubles of NI's libraries for any suite: a brain in this process, or a running one that `nidaqmx` meets.

A `conftest.py` next to the tests imports the fixtures: ``from doubles_bench import doubles, meeting``.
A module sets ``DESCRIPTION`` for other boards than the default ones.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from simulator.doubles.chassis.description import (
    SIMULTANEOUS_16_BIT,
    Description,
    ProbeWiring,
    TransducerWiring,
    build_default_description,
)
from simulator.doubles.device_model import Brain
from simulator.doubles.transports.control import RunningDoubles
from simulator.doubles.transports.library import build_library, find_unavailability_reason
from simulator.doubles.vendor_api.statuses import NOT_DONE_IN_TIME, Status
from simulator.parameters.experiment import TwinParameters
from support.daqmx_models import running_brain
from support.daqmx_rig import reach


def one_board_description(twin: TwinParameters | None = None) -> Description:
    """Return one 16-bit board that serves B, C and D: inputs 0..2, counters 0..2."""
    serial = SIMULTANEOUS_16_BIT.serial_number
    return Description(
        boards=(SIMULTANEOUS_16_BIT,),
        transducers={
            position: TransducerWiring(
                ai_serial=serial, ai_channel=index, counter_serial=serial, counter=index
            )
            for index, position in enumerate("BCD")
        },
        probes={"A": ProbeWiring(resource="PXI1Slot5")},
        twin=twin or TwinParameters(),
    )


class SteppedClock:
    """Clock that advances only during a wait, at once to the next event."""

    def __init__(self, now_ns: int = 1_000_000_000) -> None:
        self.time_ns = now_ns

    def now_ns(self) -> int:
        return self.time_ns

    def wait(self, changed: threading.Condition, until_ns: int | None) -> None:
        assert until_ns is not None, "nothing would ever end this wait"
        self.time_ns = max(self.time_ns, until_ns)

    def pass_s(self, seconds: float) -> None:
        self.time_ns += round(seconds * 1e9)


class Caller:
    """Client of a brain in this process: C names without prefix, arguments by name."""

    DEFAULTS: Mapping[str, Mapping[str, Any]] = {
        "CreateTask": {"session_name": ""},
        "CreateAIVoltageChan": {
            "name_to_assign_to_channel": "",
            "terminal_config": -1,
            "min_val": -5.0,
            "max_val": 5.0,
            "units": 10348,
            "custom_scale_name": "",
        },
        "CreateCOPulseChanTime": {
            "name_to_assign_to_channel": "",
            "units": 10364,
            "idle_state": 10214,
            "initial_delay": 2e-4,
            "low_time": 0.01,
            "high_time": 0.02,
        },
        "CfgSampClkTiming": {"source": "", "active_edge": 10280, "sample_mode": 10178},
        "CfgAnlgEdgeRefTrig": {"trigger_slope": 10280},
        "ReadBinaryI16": {"num_samps_per_chan": -1, "fill_mode": 0, "array_size_in_samps": 1 << 20},
        "ReadBinaryI32": {"num_samps_per_chan": -1, "fill_mode": 0, "array_size_in_samps": 1 << 20},
        "GetChanAttribute": {"channel": ""},
        "SetChanAttribute": {"channel": ""},
        "GetWatchdogAttribute": {"lines": ""},
    }

    def __init__(self, brain: Brain, kind: Any = "library", label: str = "test") -> None:
        self.brain = brain
        self.name = brain.open_client(kind, label)

    def __call__(self, function: str, task: int | None = None, **arguments: Any) -> dict[str, Any]:
        given = {} if task is None else {"task": task}
        return self.brain.call(
            self.name, f"DAQmx{function}", {**self.DEFAULTS.get(function, {}), **given, **arguments}
        )

    def digitizer(
        self,
        channel: str,
        *,
        name: str = "",
        rate: float = 10e6,
        samples: int = 13_600,
        pretrigger: int = 1_000,
        level: float = 0.25,
        range_v: float = 5.0,
    ) -> int:
        """Create a task that waits for a strike at the first channel."""
        task: int = self("CreateTask", session_name=name)["task"]
        self("CreateAIVoltageChan", task, physical_channel=channel, min_val=-range_v, max_val=range_v)
        self("CfgSampClkTiming", task, rate=rate, samps_per_chan=samples)
        self(
            "CfgAnlgEdgeRefTrig",
            task,
            trigger_source=channel.split(",", maxsplit=1)[0],
            trigger_level=level,
            pretrigger_samples=pretrigger,
        )
        return task

    def coil(self, counter: str, *, name: str = "", **times: Any) -> int:
        """Create a task that pulses a coil once."""
        task: int = self("CreateTask", session_name=name)["task"]
        self("CreateCOPulseChanTime", task, counter=counter, **times)
        return task

    def is_done(self, task: int) -> bool:
        """Return whether a task has ended."""
        try:
            self("WaitUntilTaskDone", task, time_to_wait=0.0)
        except Status as status:
            if status.code != NOT_DONE_IN_TIME:
                raise
            return False
        return True

    def control(self, task: int, action: int) -> None:
        """Call `DAQmxTaskControl`."""
        self("TaskControl", task, action=action)


@pytest.fixture(scope="session")
def double_library() -> Path:
    """Return the folder of libnidaqmx; skip the test with the reason if it cannot be built."""
    if reason := find_unavailability_reason():
        pytest.skip(reason)
    return build_library("nidaqmx")


@pytest.fixture(scope="module")
def doubles(request: pytest.FixtureRequest) -> Iterator[RunningDoubles]:
    """Yield one running double for a module; a test that breaks it starts its own."""
    with running_brain(
        getattr(request.module, "DESCRIPTION", None) or build_default_description()
    ) as running:
        yield running


@pytest.fixture
def meeting(doubles: RunningDoubles, monkeypatch: pytest.MonkeyPatch) -> RunningDoubles:
    """Yield a running double that the `nidaqmx` of this process finds, with an empty record."""
    reach("library", doubles, monkeypatch)
    return doubles
