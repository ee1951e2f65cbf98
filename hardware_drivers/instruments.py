"""Instruments as small Protocols, and the Rig, which is a set of them.

Simulated, recorded and real instruments are siblings behind these Protocols and pass the same
contract suites (``hardware_drivers/conformance``). Every blocking call is bounded by ``timeout_s``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.measurement import ClimateReading, ShotKey, SupplyReading, Waveform


def require_timeout(timeout_s: float) -> None:
    """Raise an error unless a timeout is a positive number.

    Raises
    ------
    ConfigurationError
        It is zero, negative or NaN.
    """
    if not timeout_s > 0.0:
        raise ConfigurationError(f"timeout_s is {timeout_s}; it must be positive")


@runtime_checkable
class Clock(Protocol):
    """Clock of the test. Driver deadlines use the monotonic clock of the machine instead."""

    def utc_ns(self) -> int:
        """Return the test time (UTC) in ns since 1970-01-01T00:00Z."""

    def mono_ns(self) -> int:
        """Return monotonic test time in ns; never steps back within one ``boot_id``."""

    def wait_until(self, utc_ns: int, idle: Callable[[], bool]) -> bool:
        """Wait until ``utc_ns``: return True once it is reached, False as soon as ``idle()`` returns False.

        ``idle`` is called at least every 0.2 s of wall time while waiting: the caller sends its heartbeat and
        checks for a request to stop in it. A past time is reached at once.
        """


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Acquired:
    """Record from a digitizer or pulse-echo unit.

    Attributes
    ----------
    truth
        What a simulated specimen knows of the record; empty on a real one.
    settings
        What the instrument says of the record, SI units in the names.
    last_attempt
        The shot cannot be struck again: a recording has no further attempt.
    """

    waveform: Waveform
    truth: Mapping[str, float] = field(default_factory=dict)
    settings: Mapping[str, float | str] = field(default_factory=dict)
    last_attempt: bool = False


@runtime_checkable
class Digitizer(Protocol):
    """Digitizer that samples one transducer's sensor around a trigger."""

    def arm(self, key: ShotKey) -> None:
        """Start waiting for the trigger of a shot; the pre-trigger buffer fills in time for the wave.

        Raises
        ------
        ConfigurationError
            Already armed, or no such position.
        BusyError, ConnectionLostError
            Another program holds the instrument, or it does not answer; nothing is armed.
        """

    def read(self, timeout_s: float) -> Acquired:
        """Wait up to ``timeout_s`` for the record of the armed shot, return it, and disarm.

        Raises
        ------
        AcquisitionTimeoutError
            Nothing triggered in time; the digitizer is disarmed.
        ConfigurationError
            Not armed, or the timeout is not positive.
        ConnectionLostError
            The digitizer does not answer.
        """

    def disarm(self) -> None:
        """Stop waiting; harmless when not armed."""


@runtime_checkable
class Striker(Protocol):
    """Striker that lifts and drops a mass by a pulse of bounded length."""

    def strike(self, key: ShotKey) -> None:
        """Pulse the coil of the key's position once; on return it is off.

        Raises
        ------
        ConfigurationError
            No such position; nothing moved.
        AcquisitionTimeoutError, BusyError, ConnectionLostError
            The pulse failed.
        """

    def make_safe(self) -> None:
        """De-energise every coil; harmless when already safe, allowed at any time.

        ConnectionLostError if the state of a coil is unknown.
        """


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Echo(Acquired):
    """Pulse-echo record and its receiver settings."""

    gain_db: float = 0.0
    offset_v: float = 0.0
    averages: int = 1


@runtime_checkable
class PulseEchoUnit(Protocol):
    """Pulse-echo unit that fires an ultrasonic probe and returns one averaged record."""

    def acquire(self, key: ShotKey, timeout_s: float) -> Echo:
        """Fire the probe of a position and return the averaged echo; wait up to ``timeout_s`` (s).

        Raises
        ------
        AcquisitionTimeoutError
            No record in time.
        ConfigurationError
            No such position, or the timeout is not positive.
        BusyError, ConnectionLostError
            Another program holds the unit, or it does not answer.
        """


@runtime_checkable
class PowerSupply(Protocol):
    """Corrosion supply. Only `energise` switches it on, and only a person requests that."""

    def read(self, timeout_s: float) -> SupplyReading:
        """Measure voltage in V and current in A, and read the output's state, within ``timeout_s``.

        Nothing is ever switched.

        Raises
        ------
        ConfigurationError
            The timeout is not positive.
        ConnectionLostError
            The supply does not answer: the state of its output is unknown.
        """

    def energise(self, voltage_v: float, current_limit_a: float) -> None:
        """Set voltage in V and current limit in A, read both back, then switch the output on.

        Raises
        ------
        ConfigurationError
            Beyond the configured caps, or not read back as set; the output stays off.
        ConnectionLostError
            The supply does not answer: the state of its output may be unknown.
        """

    def make_safe(self) -> None:
        """Switch the output off and read that back; harmless when off.

        Raises
        ------
        ConnectionLostError
            The supply does not answer: the state of its output is unknown.
        """

    def identity(self) -> Mapping[str, str]:
        """Return maker, model, serial number and firmware as the supply reports them, by name of the item.

        ConnectionLostError if it does not answer.
        """


@runtime_checkable
class ClimateProbe(Protocol):
    """Thermometer and hygrometer next to the specimen."""

    def read(self, timeout_s: float) -> ClimateReading:
        """Measure temperature in degrees Celsius and relative humidity (0 to 1) within ``timeout_s``.

        Raises
        ------
        ConfigurationError
            The timeout is not positive.
        ConnectionLostError
            The probe does not answer.
        """


@runtime_checkable
class SelfCalibrating(Protocol):
    """Instrument that adjusts itself to its temperature; between sets only."""

    def self_calibrate(self) -> Mapping[str, str]:
        """Calibrate each board; return date and temperature of its calibration by serial number.

        Raises
        ------
        ConfigurationError
            Called while armed.
        ConnectionLostError, BusyError
            As for a record.
        """


class PersonRequests:
    """Requests of an instrument to a person, and their listeners."""

    def __init__(self) -> None:
        """Start without a request, a shot and a listener."""
        self._text = ""
        self._key: ShotKey | None = None
        self._hear: Callable[[str, ShotKey | None], None] = lambda text, key: None

    def listen(self, hear: Callable[[str, ShotKey | None], None]) -> None:
        """Set the listener, called with text and shot of each request; it replaces the former one.

        An empty text means that nothing is left to do; the shot is None before the first `set_next_shot`.
        """
        self._hear = hear

    def set_next_shot(self, key: ShotKey) -> None:
        """Set the shot with which the next requests are sent; nothing is sent here."""
        self._key = key

    def ask(self, text: str) -> None:
        """Send a request, with the shot that was set, to the listener, unless its text is the last one."""
        if text != self._text:
            self._text = text
            self._hear(text, self._key)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rig:
    """Instruments of one test; a context manager that leaves everything safe.

    Attributes
    ----------
    kind
        ``simulated``, ``daqmx``, ``playback``, ``mixed``: what the reader of a number should know of its
        origin.
    self_calibration_interval_h
        Longest time between two self-calibrations; 0: never.
    asking
        What the instruments ask a person to do.
    dry_run
        A rehearsal: everything is set up, but no coil is ever energised and records show noise.
    identity
        Serial numbers, driver versions and the like, stored with every set.
    """

    kind: str
    clock: Clock
    striker: Striker
    digitizer: Digitizer
    pulse_echo: PulseEchoUnit | None = None
    supply: PowerSupply | None = None
    climate: ClimateProbe | None = None
    self_calibrating: SelfCalibrating | None = None
    self_calibration_interval_h: float = 0.0
    asking: PersonRequests = field(default_factory=PersonRequests)
    dry_run: bool = False
    identity: Mapping[str, str] = field(default_factory=dict)

    def __enter__(self) -> Rig:
        """Return the rig itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Make the rig safe; errors of that are raised."""
        self.make_safe()

    def make_safe(self) -> None:
        """De-energise the strikers, then disarm the digitizer, also if the striker fails.

        Errors of either are raised.
        """
        try:
            self.striker.make_safe()
        finally:
            self.digitizer.disarm()
