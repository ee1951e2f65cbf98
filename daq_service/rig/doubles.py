"""The demonstration's rigs: the twin itself, or the vendor's packages with the twin below them.

``daqmx-library`` and ``daqmx-grpc`` run the driver of real boards, with the real ``nidaqmx`` package, on
doubles (`simulator.doubles`): one board for all transducers and, with the library, one for the ultrasonic
probe (NI-SCOPE over gRPC cannot hand out raw codes, so there the probe's position is left out).
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from daq_service.errors import RigError, UsageError
from daq_service.rig.open_rig import CONTROL_VARIABLE
from daq_service.settings.file import load_settings
from daq_service.settings.tree import Settings
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE

if TYPE_CHECKING:
    from simulator.doubles.chassis.description import Description

RIGS = ("simulated", "daqmx-library", "daqmx-grpc")

PULSE_S = 20e-3
"""Short for a real coil, long enough for the double's: a strike takes this and the fall in wall time."""
PROBE_RESOURCE = "PXI1Slot5"
NO_PROBE = {
    "grpc": "NI-SCOPE over gRPC hands out no raw codes",
    "library": "the package niscope is not installed (extra solimon[niscope])",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoRig:
    """A rig that runs: the settings that reach it, and what the recorder's environment needs."""

    settings: Settings
    environment: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@contextmanager
def run_rig_doubles(rig: str, overrides: Mapping[str, object]) -> Iterator[DemoRig]:
    """Start the doubles that a demonstration rig needs, yield its settings, and stop the doubles on exit.

    The rig ``simulated`` starts nothing. Without an ultrasonic double the pulse-echo positions are left out,
    and `DemoRig.notes` gives the reason.

    Parameters
    ----------
    rig
        One of `RIGS`.
    overrides
        Nested tables that replace values of the shipped configuration.

    Raises
    ------
    UsageError
        An override is rejected, or this machine cannot run that rig: what is missing, and the remedy.
    RigError
        The doubles did not start.
    """
    settings = load_settings(None, overrides=overrides)
    if rig == "simulated":
        yield DemoRig(settings=settings)
        return
    from simulator.doubles.errors import DoublesError
    from simulator.doubles.transports.control import running_doubles
    from simulator.doubles.transports.library import build_environment

    transport = rig.removeprefix("daqmx-")
    with ExitStack() as stack:
        try:
            folders = _compile_ni_doubles() if transport == "library" else []
            has_probe = len(folders) > 1
            doubles = stack.enter_context(running_doubles(_describe_boards(settings)))
        except DoublesError as error:
            raise RigError(f"the doubles of the NI boards did not start: {error}") from error
        if transport == "grpc" and not doubles.grpc:
            raise UsageError("--rig daqmx-grpc needs the package grpcio: pip install 'solimon[grpc]'")
        tables = _build_rig_table(settings, transport, doubles.grpc, has_probe=has_probe)
        dropped = [] if has_probe else settings.list_positions(PULSE_ECHO)
        environment = build_environment(doubles.wire, *folders, environment=_build_library_path(folders))
        yield DemoRig(
            settings=_replace_rig(settings, tables, dropped),
            environment={**environment, CONTROL_VARIABLE: doubles.control.address},
            notes=tuple(f"position {name} is left out: {NO_PROBE[transport]}" for name in dropped),
        )


def _build_library_path(folders: Sequence[Path]) -> dict[str, str]:
    """Return the present ``LD_LIBRARY_PATH``, to which `client_environment` adds the folders of the doubles.

    Empty if the variable is unset or no folder is given.
    """
    before = os.environ.get("LD_LIBRARY_PATH")
    return {"LD_LIBRARY_PATH": before} if folders and before else {}


def _describe_boards(settings: Settings) -> Description:
    """Describe the doubles' boards: one coil and input for each transducer, one channel for each probe.

    All transducers share one board. Raises UsageError if they are more than it has coils.
    """
    from simulator.doubles.chassis.description import (
        SIMULTANEOUS_16_BIT,
        Description,
        ProbeWiring,
        TransducerWiring,
    )

    serial, places = SIMULTANEOUS_16_BIT.serial_number, settings.positions
    names = settings.list_positions(SOLITARY_WAVE)
    coils = len(SIMULTANEOUS_16_BIT.kind.counter_terminals)
    if len(names) > coils:
        raise UsageError(f"the double's board drives {coils} coils, the configuration has {len(names)}")
    return Description(
        boards=(SIMULTANEOUS_16_BIT,),
        transducers={
            name: TransducerWiring(
                ai_serial=serial,
                ai_channel=index,
                counter_serial=serial,
                counter=index,
                chain=places[name].chain,
                plate=places[name].plate,
                corrosion=places[name].corrosion,
            )
            for index, name in enumerate(names)
        },
        probes={
            name: ProbeWiring(
                resource=PROBE_RESOURCE, channel=str(index), thickness_m=places[name].plate.thickness_m
            )
            for index, name in enumerate(settings.list_positions(PULSE_ECHO))
        },
        twin=settings.twin,
        shots_per_set=settings.schedule.shots_per_set,
    )


def _build_rig_table(
    settings: Settings, transport: str, grpc: str | None, *, has_probe: bool
) -> dict[str, object]:
    """Build the values of the table ``[rig]`` for the doubles' boards, with the sampling of the twin.

    ``grpc`` is the address of the doubles' gRPC server, used with the transport ``grpc``. ``[rig.niscope]``
    is included only if ``has_probe``.
    """
    from simulator.doubles.chassis.description import SIMULTANEOUS_16_BIT

    adc, echo = settings.twin.adc, settings.twin.echo
    tables: dict[str, object] = {
        "kind": "daqmx",
        "on_doubles": True,
        "daqmx": {
            "transport": transport,
            "grpc_address": grpc if transport == "grpc" else "",
            "sample_rate_hz": adc.sample_rate_hz,
            "record_samples": adc.record_samples,
            "pretrigger_samples": adc.pretrigger_samples,
            "trigger_level_v": adc.trigger_level_v,
            "pulse_s": PULSE_S,
            "transducers": {
                name: {
                    "board_serial": f"{SIMULTANEOUS_16_BIT.serial_number:08X}",
                    "input": f"ai{index}",
                    "range_v": adc.range_v,
                    "counter": f"ctr{index}",
                    "output_terminal": SIMULTANEOUS_16_BIT.kind.counter_terminals[index],
                }
                for index, name in enumerate(settings.list_positions(SOLITARY_WAVE))
            },
        },
    }
    if has_probe:
        tables["niscope"] = {
            "sample_rate_hz": echo.sample_rate_hz,
            "record_samples": echo.record_samples,
            "averages": echo.averages,
            "probes": {
                name: {
                    "resource": PROBE_RESOURCE,
                    "channel": str(index),
                    "range_v": echo.range_v,
                    "gain_db": echo.gain_db,
                }
                for index, name in enumerate(settings.list_positions(PULSE_ECHO))
            },
        }
    return tables


def _replace_rig(settings: Settings, tables: Mapping[str, object], dropped: Sequence[str]) -> Settings:
    """Return a copy of the settings with the keys ``tables`` of ``[rig]`` replaced and positions removed.

    Raises ValidationError if the result is invalid.
    """
    values = settings.model_dump(mode="json")
    values["rig"] |= tables
    for name in dropped:
        del values["positions"][name]
    return Settings(**values)


def _compile_ni_doubles() -> list[Path]:
    """Compile the NI-DAQmx double, and the NI-SCOPE double if niscope is installed; return their folders.

    Compiled doubles are cached. Raises UsageError if this machine cannot build them, and LibraryBuildError if
    the compiler fails.
    """
    from simulator.doubles.transports.library import build_library, find_unavailability_reason

    if reason := find_unavailability_reason():
        raise UsageError(f"--rig daqmx-library cannot run here: {reason}; or take --rig daqmx-grpc")
    folders = [build_library("nidaqmx")]
    if find_spec("niscope") is not None:
        folders.append(build_library("niScope"))
    return folders
