"""Recorded shots as instruments: striker, digitizer and pulse-echo unit behind the Protocols of a rig.

A recorded shot is played back when its key is struck while the digitizer is armed at its position. A
shot, or an attempt at it, that was not recorded is a missed strike; after the last attempt the recording
says so (`last_attempt`), and nobody strikes again; a position that was not recorded is refused by name.
Counts, calibration, settings and truth pass unchanged. No instrument waits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError
from hardware_drivers.instruments import Acquired, Echo, require_timeout
from hardware_drivers.measurement import ShotKey
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE
from hardware_drivers.playback.source import ShotSource

SWITCHINGS_KEPT = 1_000
"""The record of switchings is a ring: the newest of the last 500 strikes."""


class Recording:
    """What striker and digitizer share: the source, which position is armed, which strike came."""

    def __init__(self, source: ShotSource) -> None:
        self._source = source
        self._armed: ShotKey | None = None
        self._struck: ShotKey | None = None

    def require(self, key: ShotKey, method: str) -> None:
        """Refuse a position that was not recorded by this method."""
        known = self._source.positions
        if known.get(key.position) != method:
            names = ", ".join(sorted(name for name, its in known.items() if its == method)) or "none"
            raise ConfigurationError(
                f"the recording has no {method} position {key.position!r}; it has: {names}; take the "
                "position out of the configuration, or play back another recording"
            )

    def arm(self, key: ShotKey) -> None:
        """Let the next strike at the key's position be played back."""
        self.require(key, SOLITARY_WAVE)
        if self._armed is not None:
            raise ConfigurationError(
                f"already armed at {self._armed.position!r} for shot {self._armed.shot_index} of set "
                f"{self._armed.set_index}; read or disarm first"
            )
        self._armed = key

    def disarm(self) -> None:
        """Play back nothing any more."""
        self._armed = self._struck = None

    def strike(self, key: ShotKey) -> None:
        """Remember the first strike at the armed position; any other is lost, as it is in a laboratory."""
        if self._armed is not None and self._armed.position == key.position and self._struck is None:
            self._struck = key

    def read(self) -> Acquired:
        """Hand over the record of the strike and disarm."""
        armed, struck = self._armed, self._struck
        self.disarm()
        if armed is None:
            raise ConfigurationError("not armed; arm before the strike, then read")
        if struck is None:
            raise AcquisitionTimeoutError(f"no strike at {armed.position!r} since the digitizer was armed")
        last_attempt = not self._source.tried(replace(struck, attempt=struck.attempt + 1))
        try:
            return replace(self.find(struck), last_attempt=last_attempt)
        except AcquisitionTimeoutError as error:
            error.last_attempt = last_attempt
            raise

    def find(self, key: ShotKey) -> Acquired:
        """Record of a shot; one that was not recorded is a missed strike."""
        acquired = self._source.find(key)
        if acquired is None:
            raise AcquisitionTimeoutError(
                f"the recording has no attempt {key.attempt} at shot {key.shot_index} of set "
                f"{key.set_index} at {key.position!r}"
            )
        return acquired


class RecordedStriker:
    """Has no coil: it says which shot comes next, and remembers what a coil would have done."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._switchings: deque[tuple[str, bool]] = deque(maxlen=SWITCHINGS_KEPT)

    @property
    def switchings(self) -> tuple[tuple[str, bool], ...]:
        """The newest switchings, oldest first: position, energised or not."""
        return tuple(self._switchings)

    def strike(self, key: ShotKey) -> None:
        """Let the armed digitizer play back this shot."""
        self._recording.require(key, SOLITARY_WAVE)
        self._switchings.extend(((key.position, True), (key.position, False)))
        self._recording.strike(key)

    def make_safe(self) -> None:
        """Nothing is ever energised after a strike."""


class RecordedDigitizer:
    """Plays back the shot that was struck."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording

    def arm(self, key: ShotKey) -> None:
        """Wait for a strike at the key's position."""
        self._recording.arm(key)

    def read(self, timeout_s: float) -> Acquired:
        """Hand over the recorded shot; how fast it is read from a disk never makes it a missed one."""
        require_timeout(timeout_s)
        return self._recording.read()

    def disarm(self) -> None:
        """Stop waiting."""
        self._recording.disarm()


class RecordedPulseEchoUnit:
    """Plays back pulse-echo records."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording

    def acquire(self, key: ShotKey, timeout_s: float) -> Echo:
        """Hand over the recorded echo."""
        require_timeout(timeout_s)
        self._recording.require(key, PULSE_ECHO)
        echo = self._recording.find(key)
        if not isinstance(echo, Echo):
            raise ConfigurationError(
                f"the recording has a {type(echo).__name__} at the pulse_echo position {key.position!r}; "
                "correct the method of this position"
            )
        return echo


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedInstruments:
    """The instruments of one recording; a rig is composed of them and a clock."""

    striker: RecordedStriker
    digitizer: RecordedDigitizer
    pulse_echo: RecordedPulseEchoUnit


def build_instruments(source: ShotSource, *, wanted: Mapping[str, str] | None = None) -> RecordedInstruments:
    """Instruments that play back one recording.

    Parameters
    ----------
    wanted
        Positions and methods that will be asked for: refused now rather than at their first strike.

    Raises
    ------
    ConfigurationError
        A wanted position was not recorded by its method.
    """
    recording = Recording(source)
    for position, method in (wanted or {}).items():
        recording.require(ShotKey(position=position, set_index=0, shot_index=0), method)
    return RecordedInstruments(
        striker=RecordedStriker(recording),
        digitizer=RecordedDigitizer(recording),
        pulse_echo=RecordedPulseEchoUnit(recording),
    )
