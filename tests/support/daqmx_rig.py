"""A double with a quick specimen behind it, and a driver with its wiring."""

from __future__ import annotations

import ctypes
import os
import socket
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cache
from typing import Any

import pytest

from hardware_drivers.daqmx.parameters import DaqmxParameters, TransducerWiring
from hardware_drivers.instruments import Acquired
from hardware_drivers.kinds import Opened
from hardware_drivers.measurement import Counts, ShotKey
from simulator.doubles.chassis.description import SIMULTANEOUS_16_BIT, BoardParameters, Description
from simulator.doubles.chassis.description import TransducerWiring as DoubleWiring
from simulator.doubles.transports.control import RunningDoubles
from simulator.doubles.transports.library import (
    SONAMES,
    build_environment,
    build_library,
    find_unavailability_reason,
)
from simulator.parameters.chain import ChainParameters
from simulator.parameters.electronics import AdcParameters, NoiseParameters
from simulator.parameters.experiment import ScatterParameters, TwinParameters
from simulator.parameters.plate import PlateParameters
from simulator.shot.model import ShotModel
from simulator.specimen import Transducer, build_specimen

QUICK_PULSE_S = 3e-3
QUICK_DROP_M = 1e-3

CHAIN = ChainParameters(drop_height_m=QUICK_DROP_M)
PLATE = PlateParameters(model="infinite_kirchhoff")
"""No plate reduction is needed, so a shot costs milliseconds."""

QUICK_TWIN = TwinParameters(noise=NoiseParameters(enabled=False), scatter=ScatterParameters(), thinning={})
"""Noise off: the counts are the rounded signal itself."""


def board(base: BoardParameters = SIMULTANEOUS_16_BIT) -> BoardParameters:
    """Return a board whose polynomial stays what it is when it calibrates itself."""
    return replace(base, self_calibration_shift_v=0.0)


def wired(ai_serial: int, index: int, counter_serial: int | None = None) -> DoubleWiring:
    """Return the double's side of a transducer with a quick shot."""
    return DoubleWiring(
        ai_serial=ai_serial,
        ai_channel=index,
        counter_serial=ai_serial if counter_serial is None else counter_serial,
        counter=index,
        lift_s=1e-3,
        chain=CHAIN,
        plate=PLATE,
    )


def quick_description(*boards: BoardParameters, positions: str = "CD") -> Description:
    """Return a double of these boards; all positions sit on the first one."""
    boards = boards or (board(),)
    serial = boards[0].serial_number
    return Description(
        boards=boards,
        transducers={name: wired(serial, index) for index, name in enumerate(positions)},
        twin=QUICK_TWIN,
    )


def parameters_of(
    description: Description, doubles: RunningDoubles | None, **changes: object
) -> DaqmxParameters:
    """Return the driver's side of the same wiring, by library unless the changes say otherwise."""
    by_serial = {one.serial_number: one for one in description.boards}
    wiring = {
        name: TransducerWiring(
            board_serial=f"{its.ai_serial:08X}",
            input=f"ai{its.ai_channel}",
            striker_serial="" if its.counter_serial == its.ai_serial else f"{its.counter_serial:08X}",
            counter=f"ctr{its.counter}",
            output_terminal=by_serial[its.counter_serial].kind.counter_terminals[its.counter],
        )
        for name, its in description.transducers.items()
    }
    values = {
        "transducers": wiring,
        "pulse_s": QUICK_PULSE_S,
        "drop_height_m": QUICK_DROP_M,
        "fall_margin_s": 0.02,
        "call_timeout_s": 2.0,
    }
    if changes.get("transport") == "grpc":
        values |= {"grpc_address": doubles.grpc, "grpc_client_name": f"test-{os.getpid()}"}
    return DaqmxParameters(**values | changes)


def why_no(transport: str) -> str:
    """Return why this transport cannot be tested here, empty if it can."""
    if transport == "library":
        return find_unavailability_reason()
    from simulator.doubles.transports.grpc_front import find_unavailability_reason as why_no_grpc

    return why_no_grpc()


TRANSPORTS = [
    "library",
    pytest.param("grpc", marks=[] if find_unavailability_reason() else pytest.mark.slow),
]
"""By library, where it cannot be built by gRPC: what the driver does is the same by either."""


def meet(doubles: RunningDoubles, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the unmodified `nidaqmx` of this process find the double of NI's library.

    The loader read LD_LIBRARY_PATH when this process started. A library that is loaded already is found by
    its soname whatever the path says, so it is loaded by its file first.
    """
    folder = build_library("nidaqmx")
    ctypes.CDLL(str(folder / SONAMES["nidaqmx"]), mode=ctypes.RTLD_GLOBAL)
    for name, text in build_environment(doubles.wire, folder).items():
        monkeypatch.setenv(name, text)


def reach(transport: str, doubles: RunningDoubles, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let this process reach a double without faults, with an empty record; skip where it cannot."""
    if reason := why_no(transport):
        pytest.skip(reason)
    if transport == "library":
        meet(doubles, monkeypatch)
    doubles.control.clear_faults()
    doubles.control.clear_record()


HOUR_H = 12.0


READ_TIMEOUT_S = 60.0
"""The doubles work in real time: reached on a machine that hangs, not on one that is busy."""


def take(
    rig: Opened, doubles: RunningDoubles, key: ShotKey, *, read_timeout_s: float = READ_TIMEOUT_S
) -> Acquired:
    """Take one shot and announce its key to the double."""
    doubles.control.announce(key, HOUR_H)
    rig.digitizer.arm(key)
    rig.striker.strike(key)
    return rig.digitizer.read(read_timeout_s)


def counts_of_the_twin(
    description: Description, parameters: DaqmxParameters, key: ShotKey, hour_h: float = HOUR_H
) -> Counts:
    """Return counts of this shot: the twin's volts through the polynomial of its board."""
    wiring = description.transducers[key.position]
    sampler = next(one for one in description.boards if one.serial_number == wiring.ai_serial)
    record = AdcParameters(
        range_v=parameters.transducers[key.position].range_v,
        sample_rate_hz=parameters.sample_rate_hz,
        record_samples=parameters.record_samples,
        pretrigger_samples=parameters.pretrigger_samples,
        trigger_level_v=parameters.trigger_level_v,
    )
    adc = sampler.adc(record)
    model = _model(wiring.chain, wiring.plate, wiring.corrosion)
    specimen = build_specimen(
        replace(description.twin, adc=adc),
        transducers={key.position: Transducer(chain=wiring.chain, model=model)},
        probed_thickness_m={},
    )
    acquired = specimen.simulate_wave(key, hour_h)
    assert acquired is not None, "the twin's strike reaches the level"
    return acquired.waveform.counts


@cache
def _model(*parameters: Any) -> ShotModel:
    return ShotModel(*parameters)


def coil_pulses_s(record: Mapping[str, Any]) -> list[float]:
    """Return the length of every pulse in a double's record; fail if a line was left high."""
    assert not any(record["levels"].values()), f"a coil is on: {record['levels']}"
    since, pulses_s = {}, []
    for event in record["lines"]:
        if event["level"]:
            since[event["line"]] = event["ns"]
        elif event["line"] in since:
            pulses_s.append((event["ns"] - since.pop(event["line"])) / 1e9)
    return pulses_s


def functions_of(record: Mapping[str, Any]) -> list[str]:
    """Return names of the calls in a double's record, in order."""
    return [call["function"].removeprefix("DAQmx") for call in record["calls"]]


class Forwarder:
    """Fixed address in front of a server that may be killed and restarted elsewhere."""

    def __init__(self, target: str) -> None:
        self.target = target
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._ends: list[socket.socket] = []
        self._ended = threading.Event()
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self) -> Forwarder:
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        for end in (self._listener, *self._ends):
            with suppress(OSError):  # it has ended already
                end.shutdown(socket.SHUT_RDWR)  # closing alone wakes no waiting thread
            end.close()

    def _accept(self) -> None:
        while not self._ended.is_set():
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            host, _, port = self.target.rpartition(":")
            try:
                server = socket.create_connection((host, int(port)))
            except OSError:
                client.close()
                continue
            self._ends += [client, server]
            for end in (client, server):
                # A frame that waits to be filled would cost 40 ms a call.
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for pair in ((client, server), (server, client)):
                threading.Thread(target=self._pump, args=pair, daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket) -> None:
        try:
            while chunk := source.recv(1 << 16):
                sink.sendall(chunk)
        except OSError:
            pass  # either side went away: so does the other
        finally:
            for end in (source, sink):
                with suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
