"""The only place that chooses between real, simulated and recorded instruments."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path

from daq_service.acquisition.schedule import plan
from daq_service.acquisition.take_set import strikes_after
from daq_service.clock import boot_id
from daq_service.errors import UsageError
from daq_service.settings.tree import RigSettings, Settings
from hardware_drivers.instruments import (
    Acquired,
    Clock,
    Digitizer,
    Echo,
    PowerSupply,
    PulseEchoUnit,
    Rig,
    SelfCalibrating,
)
from hardware_drivers.measurement import ShotKey, Stamp
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE
from hardware_drivers.serial_port.parameters import SupplyParameters

CONTROL_VARIABLE = "SOLIMON_DOUBLES_CONTROL"
"""Where the doubles of a demonstration are told which shot comes and what hour it is."""

STRIKES_WORTH_A_PROCESS = 2_000
"""From so many on a process of its own for the twin saves more time than it takes to start."""

Announce = Callable[[ShotKey], None]


Preparing = Callable[[str, bool], None]
"""Told what takes long, once on a computer, and whether it begins (True) or is done."""
COMPILING = "compiling the twin's loops, once on this computer"
BUILDING = "building the twin's plates, which are kept for the next time"


@contextmanager
def open_rig(
    settings: Settings, clock: Clock, epoch_utc_ns: int, *, preparing: Preparing = lambda what, begins: None
) -> Iterator[Rig]:
    """Instruments of the configured kind; safe again when the context ends.

    Parameters
    ----------
    preparing
        Called by any thread.

    Raises
    ------
    UsageError
        They cannot be had as configured: the specimen, the recording, a missing package.
    InstrumentError
        A real instrument is wrong, busy or not there.
    """
    with ExitStack() as stack:
        match settings.rig.kind:
            case "simulated":
                rig = stack.enter_context(_simulated(settings, clock, epoch_utc_ns, preparing))
            case "daqmx":
                rig = stack.enter_context(_daqmx(settings.rig, clock))
                if settings.rig.on_doubles:
                    rig = stack.enter_context(_announced(rig, settings, epoch_utc_ns))
            case "playback":
                rig = stack.enter_context(_playback(settings, clock))
        # Entered last, left first: coils and drive are off before any connection is closed.
        yield stack.enter_context(_with_serial_instruments(rig, settings.rig, stack))


@contextmanager
def _simulated(settings: Settings, clock: Clock, epoch_utc_ns: int, preparing: Preparing) -> Iterator[Rig]:
    from daq_service.rig.twin import records, transducers_of, twin_process

    places, schedule = settings.positions, settings.schedule
    sets = plan(schedule.phases, epoch_utc_ns, end_h=schedule.end_h)
    own_process, compiling = _deserves_a_process(settings, len(sets)), partial(preparing, COMPILING)
    with ExitStack() as stack:
        # One worker: the physics of the next shots runs while this one is stored and judged.
        executor: Executor = (
            stack.enter_context(twin_process(settings, compiling))
            if own_process
            else ThreadPoolExecutor(max_workers=1, thread_name_prefix="twin")
        )
        stack.callback(executor.shutdown, cancel_futures=True)
        # These imports take a while: the worker has started by now.
        from simulator.errors import SimulatorError
        from simulator.instruments import build_bench
        from simulator.numerics.machine_code import compilation_told

        stack.enter_context(compilation_told(compiling))
        preparing(BUILDING, True)
        try:
            transducers = transducers_of(settings)
        except SimulatorError as error:
            raise UsageError(f"the twin cannot be built as configured: {error}") from error
        finally:
            preparing(BUILDING, False)
        bench = build_bench(
            settings.twin,
            clock=clock,
            epoch_utc_ns=epoch_utc_ns,
            transducers=transducers,
            probed_thickness_m={
                name: places[name].plate.thickness_m for name in settings.names_of(PULSE_ECHO)
            },
            strikes_after=strikes_after(
                sets,
                settings.names_of(SOLITARY_WAVE),
                shots_per_set=schedule.shots_per_set,
                shot_interval_s=schedule.shot_interval_s,
            ),
            executor=executor,
            compute=partial(records, settings.model_dump_json()) if own_process else None,
        )
        yield Rig(
            kind="simulated",
            clock=clock,
            striker=bench.striker,
            digitizer=bench.digitizer,
            pulse_echo=bench.pulse_echo,
            identity={"twin": version("solimon"), "seed": str(settings.twin.seed)},
        )


def _deserves_a_process(settings: Settings, n_sets: int) -> bool:
    """Whether nobody watches and the test is long: a process takes a second or two to start."""
    unpaced = settings.clock.kind == "simulated" and settings.clock.pace_h_per_s is None
    strikes = n_sets * settings.schedule.shots_per_set * len(settings.names_of(SOLITARY_WAVE))
    return unpaced and strikes >= STRIKES_WORTH_A_PROCESS


@contextmanager
def _daqmx(settings: RigSettings, clock: Clock) -> Iterator[Rig]:
    from hardware_drivers.daqmx import open_daqmx

    assert settings.daqmx is not None, "the settings ask for it"
    with ExitStack() as stack:
        boards = stack.enter_context(open_daqmx(settings.daqmx))
        dry_run = settings.daqmx.dry_run
        identity = {**boards.identity, **({"dry_run": "yes"} if dry_run else {})}
        calibrating: list[SelfCalibrating] = [boards.self_calibrating]
        pulse_echo = None
        if settings.niscope is not None:
            from hardware_drivers.niscope.pulse_echo import open_niscope

            pulse_echo = stack.enter_context(open_niscope(settings.niscope))
            identity |= pulse_echo.identity()
            calibrating.append(pulse_echo)
        yield Rig(
            kind="daqmx",
            clock=clock,
            striker=boards.striker,
            digitizer=boards.digitizer,
            pulse_echo=pulse_echo,
            self_calibrating=_Together(calibrating),
            dry_run=dry_run,
            identity=identity,
        )


@dataclass(frozen=True, slots=True)
class _Together:
    """Several instruments calibrated one after the other."""

    parts: list[SelfCalibrating]

    def self_calibrate(self) -> Mapping[str, str]:
        told: dict[str, str] = {}
        for part in self.parts:
            told |= part.self_calibrate()
        return told


@contextmanager
def _playback(settings: Settings, clock: Clock) -> Iterator[Rig]:
    from daq_service.rig.playback import open_recording, playback_rig

    assert settings.rig.playback is not None, "the settings ask for it"
    with open_recording(settings.rig.playback, Path.cwd()) as source:
        yield playback_rig(
            source,
            clock,
            wanted={name: place.method for name, place in settings.positions.items()},
            identity={"recording": str(settings.rig.playback.source)},
            recorded_times=settings.clock.kind == "simulated",
            shot_interval_s=settings.schedule.shot_interval_s,
        )


@contextmanager
def _with_serial_instruments(rig: Rig, settings: RigSettings, stack: ExitStack) -> Iterator[Rig]:
    """Add the electrochemical drive and the climate probe; leave everything safe."""
    if settings.supply is not None:
        rig = replace(rig, supply=stack.enter_context(open_supply(settings.supply, rig.clock)))
    if settings.climate is not None:
        from hardware_drivers.serial_port.climate_probe import ScpiClimateProbe

        probe = ScpiClimateProbe(settings.climate, stamp=_stamps(rig.clock))
        stack.callback(probe.close)
        rig = replace(rig, climate=probe)
    with rig:
        yield rig


@contextmanager
def open_supply(parameters: SupplyParameters, clock: Clock) -> Iterator[PowerSupply]:
    """Drive of the corrosion; its port is opened by the first call, and nothing is switched here."""
    from hardware_drivers.serial_port.power_supply import ScpiPowerSupply

    with closing(ScpiPowerSupply(parameters, stamp=_stamps(clock))) as supply:
        yield supply


def _stamps(clock: Clock) -> Callable[[], Stamp]:
    boot = boot_id()
    return lambda: Stamp(utc_ns=clock.utc_ns(), mono_ns=clock.mono_ns(), boot_id=boot)


# Doubles: the vendor's libraries with the twin below them ------------------------------------------


@contextmanager
def _announced(rig: Rig, settings: Settings, epoch_utc_ns: int) -> Iterator[Rig]:
    """Tell the doubles before each shot which one comes and at what hour: they know no experiment."""
    from simulator.doubles.doors.control import DoublesControl
    from simulator.experiment.corrosion import held_hour_h

    address = os.environ.get(CONTROL_VARIABLE)
    if not address:
        raise UsageError(
            f"rig.on_doubles is true, but {CONTROL_VARIABLE} does not say where the doubles are; start this "
            "test by `solimon demo --rig ...`"
        )
    with DoublesControl(address) as control:

        def announce(key: ShotKey) -> None:
            elapsed_ns = rig.clock.utc_ns() - epoch_utc_ns
            control.announce(key, held_hour_h(elapsed_ns, settings.twin.update_interval_s))

        yield replace(
            rig,
            digitizer=_AnnouncedDigitizer(rig.digitizer, announce),
            pulse_echo=None if rig.pulse_echo is None else _AnnouncedPulseEcho(rig.pulse_echo, announce),
            identity={**rig.identity, "doubles": version("solimon"), "seed": str(settings.twin.seed)},
        )


@dataclass(frozen=True, slots=True)
class _AnnouncedDigitizer:
    digitizer: Digitizer
    announce: Announce

    def arm(self, key: ShotKey) -> None:
        self.announce(key)
        self.digitizer.arm(key)

    def read(self, timeout_s: float) -> Acquired:
        return self.digitizer.read(timeout_s)

    def disarm(self) -> None:
        self.digitizer.disarm()


@dataclass(frozen=True, slots=True)
class _AnnouncedPulseEcho:
    pulse_echo: PulseEchoUnit
    announce: Announce

    def acquire(self, key: ShotKey, timeout_s: float) -> Echo:
        self.announce(key)
        return self.pulse_echo.acquire(key, timeout_s)
