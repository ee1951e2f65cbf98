"""The only place that opens the instruments of a configuration, whatever kinds they are of."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any

from daq_service.clock import read_boot_id
from daq_service.errors import UsageError
from daq_service.rig.by_position import Digitizers, PulseEchoUnits, Strikers
from daq_service.settings.instruments import Instrument, list_instruments
from daq_service.settings.tree import Settings
from hardware_drivers.errors import ConfigurationError
from hardware_drivers.instruments import (
    Acquired,
    Clock,
    Digitizer,
    Echo,
    PersonRequests,
    PowerSupply,
    PulseEchoUnit,
    Rig,
    SelfCalibrating,
)
from hardware_drivers.kinds import Opened, Opening, Role
from hardware_drivers.measurement import ShotKey
from simulator.parameters.experiment import TwinParameters

CONTROL_VARIABLE = "SOLIMON_DOUBLES_CONTROL"
"""Where the doubles of a demonstration are told which shot comes and what hour it is."""

SELF_CALIBRATION_INTERVAL_H = 24.0
"""Between two self-calibrations, where no instrument of the rig says it."""

Announce = Callable[[ShotKey], None]


Preparing = Callable[[str, bool], None]
"""Called with a slow one-time preparation, and whether it goes on (True) or has ended."""


@contextmanager
def open_rig(
    settings: Settings, clock: Clock, epoch_utc_ns: int, *, preparing: Preparing = lambda what, begins: None
) -> Iterator[Rig]:
    """Open the configured instruments and yield them as a rig; on exit they are made safe, then closed.

    Parameters
    ----------
    epoch_utc_ns
        Hour 0 of the test, ns since 1970 (UTC).
    preparing
        Called with a slow one-time preparation and its progress: True while it goes on, False at its end.

    Raises
    ------
    UsageError
        The instruments cannot be used as configured: the specimen, the recording, a missing package.
    InstrumentError
        A real instrument is wrong, busy or not there.
    """
    asking = PersonRequests()
    instruments, opened = list_instruments(settings), list[Opened]()
    with ExitStack() as stack:
        for item in instruments:
            opening = replace(
                build_opening(item, settings, clock),
                ask=asking.ask,
                epoch_utc_ns=epoch_utc_ns,
                preparing=preparing,
            )
            opened.append(stack.enter_context(item.kind.open(item.parameters, opening)))
            _require_roles(item, opened[-1])
            clock = opened[-1].clock or clock
        rig = _compose_rig(settings.rig.kind, instruments, opened, clock, asking)
        if settings.rig.on_doubles:
            rig = stack.enter_context(_announce_shots(rig, settings.twin, epoch_utc_ns))
        # Entered last, left first: coils and drive are off before any connection is closed.
        yield stack.enter_context(rig)


@contextmanager
def open_supply(settings: Settings, clock: Clock) -> Iterator[PowerSupply]:
    """Open the supply of the corrosion cell without switching it; it is closed on exit.

    Raises UsageError if the configuration is rejected, ConfigurationError if the kind opens no supply,
    ValueError if not exactly one is configured, and the InstrumentError of the driver.
    """
    (item,) = (item for item in list_instruments(settings) if "supply" in item.serves)
    with item.kind.open(item.parameters, build_opening(item, settings, clock)) as opened:
        _require_roles(item, opened)
        assert opened.supply is not None, "just required"
        yield opened.supply


def build_opening(item: Instrument, settings: Settings, clock: Clock) -> Opening:
    """Build the context in which an instrument is opened or checked.

    Its callbacks and epoch are the defaults of `Opening`; `open_rig` replaces them.
    """
    return Opening(
        clock=clock,
        serves=item.serves,
        boot_id=read_boot_id(),
        shot_interval_s=settings.schedule.shot_interval_s,
        experiment=settings.model_dump(mode="json"),
    )


def _require_roles(item: Instrument, opened: Opened) -> None:
    """Raise ConfigurationError if an instrument was opened without one of the roles that it must serve."""
    for role in item.serves:
        if getattr(opened, role) is None:
            raise ConfigurationError(
                f"{item.table}: the kind {item.offer.name!r} was opened without a {role}, which it offers; "
                f"report it to the maintainer of {item.offer.distributions[0]}"
            )


def _compose_rig(
    kind: str,
    instruments: Sequence[Instrument],
    opened: Sequence[Opened],
    clock: Clock,
    asking: PersonRequests,
) -> Rig:
    """Build the rig from the opened instruments: in a mixed rig by position, else the first of each role.

    ``opened`` is in the order of ``instruments``; ValueError if their numbers differ.
    """
    pairs = list(zip(instruments, opened, strict=True))

    def at(role: Role) -> dict[str, Any]:
        """Return the opened objects of a role by position."""
        return {name: getattr(its, role) for item, its in pairs for name in item.serves.get(role, ())}

    def first(role: Role) -> Any:
        """Return the opened object of the first instrument with a role; None if none has it."""
        return next((getattr(its, role) for item, its in pairs if role in item.serves), None)

    mixed = kind == "mixed"
    calibrating, interval_h = _find_self_calibrating(opened)
    return Rig(
        kind=kind,
        clock=clock,
        striker=Strikers(at("striker"), asking) if mixed else first("striker"),
        digitizer=Digitizers(at("digitizer"), asking) if mixed else first("digitizer"),
        pulse_echo=PulseEchoUnits(at("pulse_echo")) if mixed and at("pulse_echo") else first("pulse_echo"),
        supply=first("supply"),
        climate=first("climate"),
        self_calibrating=_Together(calibrating) if calibrating else None,
        self_calibration_interval_h=interval_h,
        asking=asking,
        dry_run=any(its.dry_run for its in opened),
        identity=_collect_identities(pairs, named=mixed),
    )


def _find_self_calibrating(opened: Sequence[Opened]) -> tuple[list[SelfCalibrating], float]:
    """Return the instruments to self-calibrate and the interval in h.

    The interval is the shortest positive one that an instrument requires, 24 h if none states one, and 0
    (never) if all stated intervals are 0. Instruments that state 0 are left out.
    """
    candidates = [(its.self_calibrating, its.self_calibration_interval_h) for its in opened]
    intervals_h = [
        interval_h for what, interval_h in candidates if what is not None and interval_h is not None
    ]
    interval_h = min(filter(None, intervals_h), default=0.0 if intervals_h else SELF_CALIBRATION_INTERVAL_H)
    return [what for what, own_h in candidates if what is not None and own_h != 0.0], interval_h


def _collect_identities(pairs: Sequence[tuple[Instrument, Opened]], *, named: bool) -> dict[str, str]:
    """Merge the identities (makers, serial numbers, versions) of the instruments into one dictionary.

    With ``named`` (mixed rig) each key has the instrument's name as prefix, and the name itself gives its
    kind and the package that offers it.
    """
    identity: dict[str, str] = {}
    for item, instrument in pairs:
        if named:
            identity[item.name] = f"{item.offer.name}, {item.offer.distributions[0]}"
        identity |= {
            f"{item.name}.{key}" if named else key: value for key, value in instrument.identity.items()
        }
    return identity


@dataclass(frozen=True, slots=True)
class _Together:
    """Several instruments calibrated one after the other."""

    parts: list[SelfCalibrating]

    def self_calibrate(self) -> Mapping[str, str]:
        """Self-calibrate the instruments one after the other and merge their summaries by key; blocks.

        An error of one instrument is raised at once; the later ones are not calibrated.
        """
        results: dict[str, str] = {}
        for part in self.parts:
            results |= part.self_calibrate()
        return results


# Doubles: the vendor's libraries with the twin below them ------------------------------------------


@contextmanager
def _announce_shots(rig: Rig, twin: TwinParameters, epoch_utc_ns: int) -> Iterator[Rig]:
    """Yield the rig with a digitizer and pulse-echo unit that announce each shot and its hour to the doubles.

    Its identity gets their version and seed. Raises UsageError if the environment variable `CONTROL_VARIABLE`
    does not give the doubles' address.
    """
    from simulator.doubles.transports.control import DoublesControl
    from simulator.experiment.corrosion import round_down_hour_h

    address = os.environ.get(CONTROL_VARIABLE)
    if not address:
        raise UsageError(
            f"rig.on_doubles is true, but {CONTROL_VARIABLE} does not name the doubles; start this "
            "test by `solimon demo --rig ...`"
        )
    with DoublesControl(address) as control:

        def announce(key: ShotKey) -> None:
            """Send the key and the test hour (held over the twin's update interval) to the doubles."""
            elapsed_ns = rig.clock.utc_ns() - epoch_utc_ns
            control.announce(key, round_down_hour_h(elapsed_ns, twin.update_interval_s))

        yield replace(
            rig,
            digitizer=_AnnouncedDigitizer(rig.digitizer, announce),
            pulse_echo=None if rig.pulse_echo is None else _AnnouncedPulseEcho(rig.pulse_echo, announce),
            identity={**rig.identity, "doubles": version("solimon"), "seed": str(twin.seed)},
        )


@dataclass(frozen=True, slots=True)
class _AnnouncedDigitizer:
    digitizer: Digitizer
    announce: Announce

    def arm(self, key: ShotKey) -> None:
        """Announce the strike to the doubles, then arm the digitizer; the errors of both pass through."""
        self.announce(key)
        self.digitizer.arm(key)

    def read(self, timeout_s: float) -> Acquired:
        """Wait at most ``timeout_s`` for the record of the announced strike and return it.

        Raises the errors of the digitizer.
        """
        return self.digitizer.read(timeout_s)

    def disarm(self) -> None:
        """Disarm the digitizer, so that it stops waiting for a strike."""
        self.digitizer.disarm()


@dataclass(frozen=True, slots=True)
class _AnnouncedPulseEcho:
    pulse_echo: PulseEchoUnit
    announce: Announce

    def acquire(self, key: ShotKey, timeout_s: float) -> Echo:
        """Announce the shot to the doubles, then acquire its echo in at most ``timeout_s`` seconds.

        Raises the errors of the pulse-echo unit.
        """
        self.announce(key)
        return self.pulse_echo.acquire(key, timeout_s)
