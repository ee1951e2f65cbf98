"""A double with one ultrasonic probe, and the NI-SCOPE driver with its wiring."""

from __future__ import annotations

import ctypes
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from typing import Any

import pytest

from hardware_drivers.measurement import Counts, ShotKey
from hardware_drivers.niscope.parameters import NiscopeParameters, ProbeWiring
from simulator.doubles.chassis.description import Description
from simulator.doubles.chassis.description import ProbeWiring as DoubleProbe
from simulator.doubles.chassis.scopes import ScopeParameters
from simulator.doubles.device_model import Brain
from simulator.doubles.transports.library import (
    SONAMES,
    build_environment,
    build_library,
    find_unavailability_reason,
)
from simulator.doubles.transports.server import WireServer
from simulator.electronics.transduction import quantise_volts
from simulator.parameters.electronics import NoiseParameters
from simulator.parameters.experiment import TwinParameters
from simulator.specimen import build_specimen

RESOURCE = "PXI1Slot5"
SERIAL = 0x01C5A1F0
HOUR_H = 120.0
TIMEOUT_S = 2.0
"""Far beyond 16 firings at 1 kHz."""

POLL_S = 0.01
"""The server notices within this time that it shall end."""

SCOPE = ScopeParameters(name=RESOURCE, serial_number=SERIAL)
QUIET = TwinParameters(noise=NoiseParameters(enabled=False))


def why_no_niscope() -> str:
    """Return why the NI-SCOPE library cannot be doubled here, empty if it can."""
    if find_spec("niscope") is None:
        return 'the package niscope is not installed (extra "solimon[niscope]")'
    return find_unavailability_reason()


needs_niscope = pytest.mark.skipif(bool(why_no_niscope()), reason=why_no_niscope())


def description(*, twin: TwinParameters = QUIET, scope: ScopeParameters = SCOPE, **probe: Any) -> Description:
    """Return one board with probe A on its channel 0."""
    return Description(
        boards=(), scopes=(scope,), probes={"A": DoubleProbe(resource=RESOURCE, **probe)}, twin=twin
    )


def parameters(*, averages: int = 16, **wiring: Any) -> NiscopeParameters:
    """Return the driver's side of the same wiring."""
    given = {"resource": RESOURCE, "serial_number": f"{SERIAL:08X}"} | wiring
    return NiscopeParameters(probes={"A": ProbeWiring(**given)}, averages=averages)


def preload(library: str = "niScope") -> list[Any]:
    """Load the double of one of NI's libraries into this process; return its folder.

    The loader read LD_LIBRARY_PATH when this process started. A library that is loaded already is found by
    its soname whatever the path says, so they are loaded by their files first.
    """
    folder = build_library(library)
    for soname in (SONAMES[library], *(["libnitclk.so.1"] if library == "niScope" else [])):
        ctypes.CDLL(str(folder / soname), mode=ctypes.RTLD_GLOBAL)
    return [folder]


@contextmanager
def met_brain(described: Description) -> Iterator[Brain]:
    """Run a double in a thread of this process; its unmodified `niscope` finds it."""
    brain = Brain(described)
    with met_server(WireServer(brain)):
        yield brain
        brain.faults.release()


@contextmanager
def met_server(server: WireServer) -> Iterator[WireServer]:
    """Serve in a thread of this process; its unmodified `niscope` finds the server."""
    folders = preload()
    accepted: list[socket.socket] = []

    def accept(once: Any = server.get_request) -> tuple[socket.socket, Any]:
        connection, address = once()
        accepted.append(connection)
        return connection, address

    with server, pytest.MonkeyPatch.context() as patch:
        patch.setattr(server, "get_request", accept)
        serving = threading.Thread(target=server.serve_forever, args=(POLL_S,), daemon=True)
        serving.start()
        for name, text in build_environment(server.address, *folders).items():
            patch.setenv(name, text)
        try:
            yield server
        finally:
            server.shutdown()
            serving.join()
            for connection in accepted:
                with suppress(OSError):  # its client has left already
                    connection.shutdown(socket.SHUT_RDWR)


def key(set_index: int = 7) -> ShotKey:
    """Return the shot of one set."""
    return ShotKey(position="A", set_index=set_index, shot_index=0)


def codes_of_the_twin(described: Description, shot: ShotKey) -> Counts:
    """Return unpadded codes of one noise-free record: the twin's echo through the board's scaling."""
    specimen = build_specimen(
        described.twin, transducers={}, probed_thickness_m={"A": described.probes["A"].thickness_m}
    )
    board = described.all_scopes[0]
    volts = specimen.probed_wall(shot.position, HOUR_H).volts(described.twin.echo)
    return quantise_volts(volts, board.calibration(1.0, 0.0))


def functions_of(record: dict[str, Any]) -> list[str]:
    """Return names of the calls in a double's record, in order."""
    return [call["function"] for call in record["calls"]]
