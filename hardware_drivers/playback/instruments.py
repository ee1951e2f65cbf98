"""Recorded shots as instruments: striker, digitizer and pulse-echo unit behind the Protocols of a rig.

A recorded shot is played back when its key is struck while the digitizer is armed at its position. A
shot, or an attempt at it, that was not recorded is a missed strike; after the last attempt the recording
says so (`last_attempt`), and no one strikes again; a position that was not recorded is refused by name.
Counts, calibration, settings and truth pass unchanged. No instrument waits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace

from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError
from hardware_drivers.instruments import Acquired, Echo, require_timeout
from hardware_drivers.kinds import Opened
from hardware_drivers.measurement import ShotKey
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE
from hardware_drivers.playback.source import ShotSource
from hardware_drivers.struck_digitizer import StruckDigitizer

SWITCHINGS_KEPT = 1_000
"""The record of switchings is a ring: the newest of the last 500 strikes."""


class Recording(StruckDigitizer):
    """Digitizer and pulse-echo unit that play back the records of a source."""

    def __init__(self, source: ShotSource) -> None:
        """Play back the records of ``source``; none is read here."""
        super().__init__()
        self._source = source

    def require_recorded(self, key: ShotKey, method: str) -> None:
        """Raise ConfigurationError unless the key's position was recorded by this method.

        The message names the positions that were.
        """
        known = self._source.positions
        if known.get(key.position) != method:
            recorded = sorted(name for name in known if known[name] == method)
            names = ", ".join(recorded) or "none"
            raise ConfigurationError(
                f"the recording has no {method} position {key.position!r}; it has: {names}; take the "
                "position out of the configuration, or play back another recording"
            )

    def require_transducer(self, key: ShotKey) -> None:
        """Raise ConfigurationError if no solitary waves were recorded at the key's position."""
        self.require_recorded(key, SOLITARY_WAVE)

    def record_of(self, key: ShotKey) -> Acquired:
        """Return the recorded shot; its ``last_attempt`` is True if no further attempt was recorded.

        Raise AcquisitionTimeoutError, with the same attribute, if this attempt has no record; errors of the
        source pass through.
        """
        last_attempt = not self._source.has_attempt(replace(key, attempt=key.attempt + 1))
        try:
            return replace(self.find(key), last_attempt=last_attempt)
        except AcquisitionTimeoutError as error:
            error.last_attempt = last_attempt
            raise

    def find(self, key: ShotKey) -> Acquired:
        """Return the record of a shot or echo.

        Raise AcquisitionTimeoutError (a missed strike) if it was not recorded. Errors of the source pass
        through.
        """
        acquired = self._source.find(key)
        if acquired is None:
            raise AcquisitionTimeoutError(
                f"the recording has no attempt {key.attempt} at shot {key.shot_index} of set "
                f"{key.set_key} at {key.position!r}"
            )
        return acquired

    def acquire(self, key: ShotKey, timeout_s: float) -> Echo:
        """Return the recorded echo at once; the timeout is checked but never waited for.

        Raises
        ------
        AcquisitionTimeoutError
            This echo was not recorded.
        ConfigurationError
            No pulse-echo records of this position, its record is no echo, or the timeout is not positive.
        """
        require_timeout(timeout_s)
        self.require_recorded(key, PULSE_ECHO)
        echo = self.find(key)
        if not isinstance(echo, Echo):
            raise ConfigurationError(
                f"the recording has a {type(echo).__name__} at the pulse_echo position {key.position!r}; "
                "correct the method of this position"
            )
        return echo


class RecordedStriker:
    """Striker without a coil: it selects the next shot, and records what a coil would have done."""

    def __init__(self, recording: Recording) -> None:
        """Store the recording that a strike advances; no switching is recorded yet."""
        self._recording = recording
        self._switchings: deque[tuple[str, bool]] = deque(maxlen=SWITCHINGS_KEPT)

    @property
    def switchings(self) -> tuple[tuple[str, bool], ...]:
        """Return the newest `SWITCHINGS_KEPT` switchings, oldest first: position, energised or not."""
        return tuple(self._switchings)

    def strike(self, key: ShotKey) -> None:
        """Make the armed digitizer play back this shot, and record the two switchings of a coil, on and off.

        Raise ConfigurationError for a position without recorded solitary waves.
        """
        self._recording.require_transducer(key)
        self._switchings.extend(((key.position, True), (key.position, False)))
        self._recording.strike(key)

    def make_safe(self) -> None:
        """Do nothing: there is no coil."""


def build_instruments(source: ShotSource, *, wanted: Mapping[str, str] | None = None) -> Opened:
    """Build striker, digitizer and pulse-echo unit that play back one recording.

    Parameters
    ----------
    wanted
        Positions that will be used, and their method; they are checked here, not at their first strike.

    Raises
    ------
    ConfigurationError
        A wanted position was not recorded by its method.
    """
    recording = Recording(source)
    for position, method in (wanted or {}).items():
        recording.require_recorded(ShotKey(position=position, set_index=0, shot_index=0), method)
    return Opened(striker=RecordedStriker(recording), digitizer=recording, pulse_echo=recording)
