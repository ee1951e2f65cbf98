"""Kinds of instruments that a package offers to configurations. The complete interface.

A distribution offers a kind by one entry point for each role that it can take, all with the same name and
the same object::

    [project.entry-points."solimon.digitizer"]
    my-scope = "my_scope.kind:KIND"

    [project.entry-points."solimon.striker"]
    my-scope = "my_scope.kind:KIND"

and a configuration names it (``docs/reference/configuration.md``, mixed rigs)::

    [rig]
    kind = "mixed"

    [rig.instruments.scope]
    kind = "my-scope"
    range_v = 5.0                # a parameter of this kind

    [rig.positions.B]
    digitizer = "scope"
    striker = "scope"

What stands behind an entry point is read by every process that reads a configuration, also by those that
never open an instrument: the module of the `Kind` imports the vendor's package and whatever else is heavy
only inside ``open`` and ``check``. What happens then:

1. ``parameters`` validates the instrument's table but for ``kind``, and fills in its defaults. It is a
   pydantic ``BaseModel`` with ``extra="forbid"`` and ``frozen=True``, or a class made by
   `hardware_drivers.bounds.bounded`. The values are stored with every test, and (but for ``reached_by``)
   part of what the test is.
2. ``open`` is entered once for the instrument, however many roles and positions it serves, by the thread that
   makes every call afterwards, and left at the end: then nothing is energised and nothing is left open.
3. Each instrument of `Opened` obeys its Protocol in `hardware_drivers.instruments` and raises only errors of
   `hardware_drivers.errors`; so do ``open`` and, but for what it can say as a `Finding`, ``check``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, TypeVar

from hardware_drivers.errors import BusyError, InstrumentError
from hardware_drivers.instruments import (
    ClimateProbe,
    Clock,
    Digitizer,
    PowerSupply,
    PulseEchoUnit,
    SelfCalibrating,
    Striker,
)
from hardware_drivers.measurement import Stamp

P = TypeVar("P")

Role = Literal["digitizer", "striker", "pulse_echo", "supply", "climate"]
ROLES: tuple[Role, ...] = ("digitizer", "striker", "pulse_echo", "supply", "climate")
GROUPS: Mapping[Role, str] = {role: f"solimon.{role}" for role in ROLES}
"""Group of entry points for each role."""

State = Literal["ok", "warn", "fail"]
Value = float | str | bool | None
"""Value of a finding, for programs."""


def _ignore_request(what: str) -> None:
    """Do nothing with a request to a person: the default where there is no person to ask."""


def _ignore_notice(what: str, begins: bool) -> None:
    """Do nothing with the notice that a long operation begins or ends: the default without a listener."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Opening:
    """Context in which an instrument is opened or checked.

    Attributes
    ----------
    clock
        The experiment's time, for stamps. Deadlines use `time.monotonic`.
    serves
        Positions of each role that this instrument has, in the order of the configuration; a role that is not
        there is not wanted of it. Supply and climate serve no position: theirs is empty.
    ask
        Tells a person what to do now ("strike C now"), on page, terminal and stream, and returns at once; an
        empty text: nothing any more. solimon itself takes the text back when the shot is read or missed.
    shot_interval_s
        Between two strikes of a transducer.
    epoch_utc_ns
        Hour 0 of the experiment.
    boot_id
        Boot of this computer, that `stamp` shows.
    experiment
        The whole configuration as nested tables, for kinds that must know the specimen: simulators,
        recordings.
    preparing
        Called while the instrument is opened with what takes long ("compiling") and its progress: True while
        it goes on, False when it is done.
    """

    clock: Clock
    serves: Mapping[Role, tuple[str, ...]] = field(default_factory=dict)
    ask: Callable[[str], None] = _ignore_request
    shot_interval_s: float = 4.0
    epoch_utc_ns: int = 0
    boot_id: str = ""
    experiment: Mapping[str, Any] = field(default_factory=dict)
    preparing: Callable[[str, bool], None] = _ignore_notice

    @property
    def positions(self) -> tuple[str, ...]:
        """Return every position that the instrument serves in any role, each once, in configured order."""
        return tuple(dict.fromkeys(name for names in self.serves.values() for name in names))

    def stamp(self) -> Stamp:
        """Return the present time stamp (test UTC and monotonic time in ns, boot) for a reading."""
        return Stamp(utc_ns=self.clock.utc_ns(), mono_ns=self.clock.mono_ns(), boot_id=self.boot_id)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Opened:
    """Opened instrument, by the roles that `Opening.serves` requested.

    Attributes
    ----------
    self_calibrating
        Calibrated between sets, at least every `self_calibration_interval_h`; 0: never; None: together with
        the others of the rig, each 24 h where there are none.
    clock
        Takes the place of the experiment's clock: a recording knows when its shots were taken.
    identity
        Maker, serial number, versions: stored with every set and shown by `info`.
    dry_run
        A rehearsal: nothing is ever energised. The parameter that asks for it has this name, too.
    """

    digitizer: Digitizer | None = None
    striker: Striker | None = None
    pulse_echo: PulseEchoUnit | None = None
    supply: PowerSupply | None = None
    climate: ClimateProbe | None = None
    self_calibrating: SelfCalibrating | None = None
    self_calibration_interval_h: float | None = None
    clock: Clock | None = None
    identity: Mapping[str, str] = field(default_factory=dict)
    dry_run: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Result of one check: state and remedy.

    Attributes
    ----------
    subject, check
        What was looked at, and what for: ``board 01E18096``, ``calibrated``.
    remedy
        What to do; needed where `state` is not ``ok``.
    held
        It failed because another program holds the instrument.
    values
        The same for programs, SI units in the names.
    """

    subject: str
    check: str
    state: State
    detail: str
    remedy: str = ""
    held: bool = False
    values: Mapping[str, Value] = field(default_factory=dict)


def build_error_finding(subject: str, check: str, error: InstrumentError, otherwise: str) -> Finding:
    """Build the failed finding on an instrument's error.

    The message's text after its last ``; `` is the remedy, the text before it the detail. A `BusyError` names
    the owner: its detail is the complete message, and `held` is True.

    Parameters
    ----------
    otherwise
        Remedy where the message has none.
    """
    problem, _, remedy = str(error).rpartition("; ")
    held = isinstance(error, BusyError)
    return Finding(
        subject=subject,
        check=check,
        state="fail",
        detail=str(error) if held else problem or str(error),
        remedy=remedy if problem else otherwise,
        held=held,
    )


def _list_no_packages(parameters: object) -> Iterable[str]:
    """Return an empty tuple: the default of `Kind.packages`, for a kind without further distributions."""
    return ()


def _return_zero_s(parameters: object) -> float:
    """Return 0.0 s: the default of `Kind.longest_call_s`, for a kind without long calls."""
    return 0.0


def _accept_all_positions(parameters: Any, serves: Mapping[Role, tuple[str, ...]]) -> None:
    """Do nothing, so that all positions are accepted: the default of `Kind.require`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Kind(Generic[P]):
    """Kind of instrument: its parameters, how it is opened, what `solimon doctor` checks.

    Attributes
    ----------
    parameters
        Validated by pydantic: a ``BaseModel`` or a `hardware_drivers.bounds.bounded` class. Its docstring
        and the text below each field explain the keys.
    open
        Context manager of the opened instrument. Raises `InstrumentError`.
    check
        Looks at the instrument without striking, switching or changing anything; `InstrumentError` that it
        raises ends the look as a failed finding.
    packages
        Distributions that these parameters need (``picosdk``), for `solimon doctor`.
    longest_call_s
        Longest time that a call may take that is given no ``timeout_s`` (arm, strike, self-calibrate); the
        recorder's sign of life waits for it. 0: less than `rig.stall_timeout_s` allows anyway.
    reached_by
        Parameters that say how the instrument is reached, not what is measured: they may differ when a test
        is gone on with. Dots lead into tables (``"line.port"``).
    require
        Raises ValueError where these parameters cannot serve the positions that the configuration gives them
        (`Opening.serves`): a position that they do not wire. Asked when a configuration is read.
    """

    parameters: type[P]
    open: Callable[[P, Opening], AbstractContextManager[Opened]]
    check: Callable[[P, Opening], Iterable[Finding]]
    packages: Callable[[P], Iterable[str]] = _list_no_packages
    longest_call_s: Callable[[P], float] = _return_zero_s
    reached_by: frozenset[str] = frozenset()
    require: Callable[[P, Mapping[Role, tuple[str, ...]]], None] = _accept_all_positions
