"""Instruments of a mixed rig behind one Protocol each: a shot goes to those that serve its position."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from typing import TypeVar

from hardware_drivers.errors import ConfigurationError
from hardware_drivers.instruments import Acquired, Digitizer, Echo, PersonRequests, PulseEchoUnit, Striker
from hardware_drivers.measurement import ShotKey

T = TypeVar("T")


class Strikers:
    """Strikers by their positions."""

    def __init__(self, strikers: Mapping[str, Striker], asking: PersonRequests) -> None:
        self._strikers, self._asking = strikers, asking

    def strike(self, key: ShotKey) -> None:
        """Strike with the striker of the shot's position; that striker may instead request a strike by hand.

        Raises ConfigurationError if no striker serves the position, or the error of the striker.
        """
        striker = _find_instrument(self._strikers, key, "striker")
        self._asking.set_next_shot(key)
        striker.strike(key)

    def make_safe(self) -> None:
        """De-energize every striker once, the last one first, then withdraw the request to a person.

        All are called even if one fails; the last error is raised at the end.
        """
        with ExitStack() as every:
            every.callback(self._asking.ask, "")
            for striker in _list_distinct_instruments(self._strikers):
                every.callback(striker.make_safe)


class Digitizers:
    """Digitizers by their positions."""

    def __init__(self, digitizers: Mapping[str, Digitizer], asking: PersonRequests) -> None:
        self._digitizers, self._asking = digitizers, asking
        self._armed: ShotKey | None = None

    def arm(self, key: ShotKey) -> None:
        """Arm the digitizer of the shot's position for this shot.

        Raises ConfigurationError if one is armed already or no digitizer serves the position, or the error of
        the digitizer, which then does not count as armed.
        """
        digitizer = _find_instrument(self._digitizers, key, "digitizer")
        if self._armed is not None:
            raise ConfigurationError(f"already armed for {self._armed}; read or disarm first")
        digitizer.arm(key)
        self._armed = key

    def read(self, timeout_s: float) -> Acquired:
        """Wait at most ``timeout_s`` for the record of the armed digitizer, return it, and disarm.

        The request to a person is withdrawn, also on an error. Raises ConfigurationError if nothing is armed,
        or the error of the digitizer, such as AcquisitionTimeoutError.
        """
        key, self._armed = self._armed, None
        if key is None:
            raise ConfigurationError("not armed; arm before the strike, then read")
        try:
            return self._digitizers[key.position].read(timeout_s)
        finally:
            self._asking.ask("")

    def disarm(self) -> None:
        """Disarm every digitizer once, also where none is armed.

        All are called even if one fails; the last error is raised at the end.
        """
        self._armed = None
        with ExitStack() as every:
            for digitizer in _list_distinct_instruments(self._digitizers):
                every.callback(digitizer.disarm)


class PulseEchoUnits:
    """Pulse-echo units by their positions."""

    def __init__(self, units: Mapping[str, PulseEchoUnit]) -> None:
        self._units = units

    def acquire(self, key: ShotKey, timeout_s: float) -> Echo:
        """Acquire an echo with the unit of the shot's position, in at most ``timeout_s`` seconds.

        Raises ConfigurationError if no unit serves the position, or the error of the unit.
        """
        return _find_instrument(self._units, key, "pulse-echo unit").acquire(key, timeout_s)


def _find_instrument(instruments: Mapping[str, T], key: ShotKey, what: str) -> T:
    """Return the instrument that serves a shot's position; raise ConfigurationError if there is none.

    ``what`` names the kind of instrument in the error.
    """
    if key.position not in instruments:
        raise ConfigurationError(
            f"no {what} at position {key.position!r}; there are: {', '.join(instruments) or 'none'}; name "
            f"one in [rig.positions.{key.position}]"
        )
    return instruments[key.position]


def _list_distinct_instruments(instruments: Mapping[str, T]) -> list[T]:
    """Return each instrument object once, in order of its first position."""
    return list({id(instrument): instrument for instrument in instruments.values()}.values())
