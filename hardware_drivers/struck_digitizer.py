"""Base of digitizers whose records follow from the strike alone: simulated and recorded ones."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from hardware_drivers.errors import AcquisitionTimeoutError, ConfigurationError
from hardware_drivers.instruments import Acquired, require_timeout
from hardware_drivers.measurement import ShotKey


class StruckDigitizer(ABC):
    """Digitizer that returns the record of the first strike at the armed position; its striker notifies it.

    No one can strike while `read` runs, so a read without a strike times out at once.
    """

    no_strike_remedy: ClassVar[str] = ""
    """What a person should do about a strike that did not come, behind a semicolon."""

    def __init__(self) -> None:
        """Start disarmed, without a stored strike."""
        self._armed: ShotKey | None = None
        self._struck: ShotKey | None = None

    @abstractmethod
    def require_transducer(self, key: ShotKey) -> None:
        """Raise ConfigurationError if the key's position has no solitary-wave transducer."""

    @abstractmethod
    def record_of(self, key: ShotKey) -> Acquired:
        """Return the record of the strike `key`, which was the first at the armed position.

        Raise AcquisitionTimeoutError if it has none.
        """

    def arm(self, key: ShotKey) -> None:
        """Arm for the next strike at the key's position.

        Raise ConfigurationError if already armed, or if the position has no solitary-wave transducer.
        """
        self.require_transducer(key)
        if self._armed is not None:
            raise ConfigurationError(
                f"already armed at {self._armed.position!r} for shot {self._armed.shot_index} of set "
                f"{self._armed.set_key}; read or disarm first"
            )
        self._armed = key

    def disarm(self) -> None:
        """Disarm and discard a stored strike; harmless when not armed."""
        self._armed = self._struck = None

    def strike(self, key: ShotKey) -> bool:
        """Store a strike, and return True, if it is the first at the armed position since arming.

        Any other strike is ignored: return False.
        """
        recorded = self._armed is not None and self._armed.position == key.position and self._struck is None
        if recorded:
            self._struck = key
        return recorded

    def read(self, timeout_s: float) -> Acquired:
        """Return the record of the stored strike at once, and disarm.

        ``timeout_s`` is checked but never waited for: the time to read a record makes no strike a missed one.

        Raises
        ------
        AcquisitionTimeoutError
            No strike at the armed position since the digitizer was armed, or one without a record.
        ConfigurationError
            Not armed, or the timeout is not positive.
        """
        require_timeout(timeout_s)
        armed, struck = self._armed, self._struck
        self.disarm()
        if armed is None:
            raise ConfigurationError("not armed; arm before the strike, then read")
        if struck is None:
            raise AcquisitionTimeoutError(
                f"no strike at {armed.position!r} since the digitizer was armed{self.no_strike_remedy}"
            )
        return self.record_of(struck)
