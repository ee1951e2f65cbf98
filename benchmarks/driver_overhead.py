"""Overhead of the NI-DAQmx driver per shot, next to the bare `nidaqmx` calls in the same run.

    python benchmarks/driver_overhead.py [--transport library|grpc] [--shots N] [--json]

One double, one board, one transducer, three ways in turn: the bare calls on tasks committed once; the
driver, which commits once a transducer's turn; and the bare calls with tasks made, committed and cleared
for every shot. Each time runs from arming to counts in memory; the coil's pulse, the striker's fall and the
record itself, real time and the same for all, are taken off. Medians; the ratios are what counts, the times
hold for this machine and this double. Takes some ten seconds.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from hardware_drivers.daqmx.instruments import open_daqmx
from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring
from hardware_drivers.measurement import ShotKey
from simulator.doubles.chassis.description import SIMULTANEOUS_16_BIT, Description
from simulator.doubles.chassis.description import TransducerWiring as DoubleWiring
from simulator.doubles.transports.control import running_doubles
from simulator.parameters.chain import ChainParameters
from simulator.parameters.electronics import NoiseParameters
from simulator.parameters.experiment import ScatterParameters, TwinParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import ShotModel
from simulator.specimen import Transducer, build_specimen

ROUNDS = 5
POSITION = "C"
CHAIN = ChainParameters()
"""The fall of 5 mm takes 32 ms, in which the double computes the record: none of that is counted."""
PLATE = PlateParameters(model="infinite_kirchhoff")
SAMPLER = SIMULTANEOUS_16_BIT
# Every shot is the same to the last bit, so every shot takes the same time of its own.
TWIN = TwinParameters(noise=NoiseParameters(enabled=False), scatter=ScatterParameters(scale=0.0), thinning={})


def description() -> Description:
    serial = SAMPLER.serial_number
    wiring = DoubleWiring(ai_serial=serial, counter_serial=serial, lift_s=1e-3, chain=CHAIN, plate=PLATE)
    return Description(boards=(SAMPLER,), transducers={POSITION: wiring}, twin=TWIN)


def parameters(**transport: Any) -> DaqmxParameters:
    wiring = TransducerWiring(board_serial=f"{SAMPLER.serial_number:08X}")
    return DaqmxParameters(
        transducers={POSITION: wiring},
        pulse_s=2e-3,
        drop_height_m=CHAIN.drop_height_m,
        grpc_client_name=f"benchmark-{os.getpid()}",
        **transport,
    )


def own_time_s(wired: DaqmxParameters) -> float:
    """Return the time of delay, pulse, fall, path to the sensor and the record after its trigger."""
    model = ShotModel(CHAIN, PLATE, CorrosionParameters())
    adc = replace(TWIN.adc, record_samples=wired.record_samples)
    specimen = build_specimen(
        replace(TWIN, adc=adc),
        transducers={POSITION: Transducer(chain=CHAIN, model=model)},
        probed_thickness_m={},
    )
    key = ShotKey(position=POSITION, set_index=0, shot_index=0)
    acquired = specimen.simulate_wave(key, 0.0)
    assert acquired is not None, "the strike reaches the level"
    after_s = (wired.record_samples - wired.pretrigger_samples) / wired.sample_rate_hz
    height_m = specimen.strike(key, 0.0).drop_height_m
    fall_s = (2.0 * height_m / 9.81) ** 0.5
    return wired.initial_delay_s + wired.pulse_s + fall_s + acquired.truth["trigger_time_s"] + after_s


class BareCalls:
    """Minimal calls of a hand-written program, by the same transport."""

    def __init__(self, wired: DaqmxParameters) -> None:
        self._wired = wired
        self._channel = None
        if wired.transport == "grpc":
            import grpc

            self._channel = grpc.insecure_channel(wired.grpc_address)
        self.buffer = np.zeros((1, wired.record_samples), dtype=np.int16)

    def _options(self) -> Any:
        from nidaqmx import GrpcSessionOptions

        return None if self._channel is None else GrpcSessionOptions(self._channel, "")

    def tasks(self) -> tuple[Any, Any, Any]:
        """Return two committed tasks and the reader of one."""
        from nidaqmx import Task
        from nidaqmx.constants import AcquisitionType, Level, TaskMode
        from nidaqmx.stream_readers import AnalogUnscaledReader

        wired, name = self._wired, SAMPLER.name
        acquisition = Task(grpc_options=self._options())
        acquisition.ai_channels.add_ai_voltage_chan(f"{name}/ai0", min_val=-5.0, max_val=5.0)
        acquisition.timing.cfg_samp_clk_timing(
            wired.sample_rate_hz, sample_mode=AcquisitionType.FINITE, samps_per_chan=wired.record_samples
        )
        acquisition.triggers.reference_trigger.cfg_anlg_edge_ref_trig(
            f"{name}/ai0", wired.pretrigger_samples, trigger_level=wired.trigger_level_v
        )
        coil = Task(grpc_options=self._options())
        coil.co_channels.add_co_pulse_chan_time(
            f"{name}/ctr0",
            idle_state=Level.LOW,
            initial_delay=wired.initial_delay_s,
            high_time=wired.pulse_s,
        )
        for task in (acquisition, coil):
            task.control(TaskMode.TASK_COMMIT)
        reader = AnalogUnscaledReader(acquisition.in_stream)
        reader.verify_array_shape = False
        return acquisition, coil, reader

    def shot(self, acquisition: Any, coil: Any, reader: Any) -> None:
        """Start, strike, read, stop."""
        acquisition.start()
        coil.start()
        coil.wait_until_done(1.0)
        coil.stop()
        reader.read_int16(self.buffer, self._wired.record_samples, 2.0)
        acquisition.stop()

    @contextmanager
    def committed_once(self) -> Iterator[Callable[[], None]]:
        """Return a shot with tasks for all shots of a turn."""
        acquisition, coil, reader = self.tasks()
        try:
            yield lambda: self.shot(acquisition, coil, reader)
        finally:
            coil.close()
            acquisition.close()

    @contextmanager
    def task_a_shot(self) -> Iterator[Callable[[], None]]:
        """Return a shot with tasks of its own."""

        def shot() -> None:
            with self.committed_once() as once:
                once()

        yield shot


@contextmanager
def through_the_driver(wired: DaqmxParameters) -> Iterator[Callable[[], None]]:
    key = ShotKey(position=POSITION, set_index=0, shot_index=0)
    with open_daqmx(wired) as rig:

        def shot() -> None:
            rig.digitizer.arm(key)
            rig.striker.strike(key)
            rig.digitizer.read(2.0)

        yield shot


def measure(wired: DaqmxParameters, shots: int) -> dict[str, float]:
    bare = BareCalls(wired)
    ways: dict[str, Callable[[], Any]] = {
        "bare_s": bare.committed_once,
        "driver_s": lambda: through_the_driver(wired),
        "task_a_shot_s": bare.task_a_shot,
    }
    own_s = own_time_s(wired)
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(ROUNDS):
        for name, way in ways.items():
            with way() as shot:
                shot()  # the first shot of a turn commits; it is reported separately below
                for _ in range(shots // ROUNDS):
                    started_s = time.perf_counter()
                    shot()
                    times[name].append(time.perf_counter() - started_s - own_s)
    medians = {name: statistics.median(values) for name, values in times.items()}
    return {
        "own_time_s": own_s,
        **medians,
        "driver_to_bare": medians["driver_s"] / medians["bare_s"],
        "task_a_shot_to_bare": medians["task_a_shot_s"] / medians["bare_s"],
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--transport", choices=("library", "grpc"), default="library")
    parser.add_argument("--shots", type=int, default=100, help="of each way (default 100)")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--address", help=argparse.SUPPRESS)  # of the double: the measuring child's side
    arguments = parser.parse_args()
    if arguments.address is None:
        with running_doubles(description()) as doubles:
            library = arguments.transport == "library"
            # The loader looks for NI's library where its path said when the process started.
            environment = doubles.client_environment() if library else dict(os.environ)
            address = doubles.wire if library else doubles.grpc
            command = [sys.executable, __file__, *sys.argv[1:], "--address", address]
            return subprocess.run(command, env=environment, check=False).returncode
    transport = {"transport": arguments.transport}
    if arguments.transport == "grpc":
        transport["grpc_address"] = arguments.address
    results = measure(parameters(**transport), arguments.shots)
    if arguments.json:
        print(json.dumps(results))
    else:
        for name, value in results.items():
            text = f"{1e3 * value:9.3f} ms" if name.endswith("_s") else f"{value:9.3f}"
            print(f"{name:22s} {text}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
