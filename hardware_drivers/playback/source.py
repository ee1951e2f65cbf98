"""Source of recorded shots: read one by one, so that a recording never has to fit in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from typing import Protocol, runtime_checkable

from hardware_drivers.instruments import Acquired, Echo
from hardware_drivers.measurement import PulseEchoRecord, SetKey, Shot, ShotKey

Record = Shot | PulseEchoRecord

SETS_KEPT = 2
"""Sets held at a time: the one that is played back, and the one before it."""


@runtime_checkable
class ShotSource(Protocol):
    """Source of recorded shots."""

    @property
    def positions(self) -> Mapping[str, str]:
        """Return the recorded positions and their method: ``solitary_wave`` or ``pulse_echo``."""

    def find(self, key: ShotKey) -> Acquired | None:
        """Return the record of a shot (an `Echo` for pulse-echo); None if it was not recorded.

        Raises
        ------
        AcquisitionTimeoutError
            It was recorded, but cannot be read any more; the message states the reason.
        ConfigurationError
            The recording as a whole cannot be read.
        """

    def has_attempt(self, key: ShotKey) -> bool:
        """Return whether the recording has this attempt at a shot, with a record or as a missed strike.

        May read the set from disk.
        """


def convert_stored_record(record: Record) -> Acquired:
    """Convert a stored record to the `Acquired` or `Echo` that its instrument returned; no value changes.

    Key, sequence and time stamp are left out.
    """
    if isinstance(record, PulseEchoRecord):
        return Echo(
            waveform=record.waveform,
            truth=record.truth,
            settings=record.settings,
            gain_db=record.gain_db,
            offset_v=record.offset_v,
            averages=record.averages,
        )
    return Acquired(waveform=record.waveform, truth=record.truth, settings=record.settings)


class ShotsBySet:
    """Long recording, read set by set when a shot of the set is requested.

    Parameters
    ----------
    positions
        Recorded positions and their method.
    read
        Records of a set; empty for a set that was not recorded. What it raises reaches the caller.
    """

    def __init__(self, positions: Mapping[str, str], read: Callable[[SetKey], Iterable[Record]]) -> None:
        """Store the positions and the reader of sets; no set is read here."""
        self._positions = dict(positions)

        @lru_cache(maxsize=SETS_KEPT)
        def records_of_set(set_key: SetKey) -> Mapping[ShotKey, Record]:
            """Read the records of a set, by key; those of the last `SETS_KEPT` sets are cached."""
            return {record.key: record for record in read(set_key)}

        self.records_of_set = records_of_set
        """Returns every record of a set, from memory if it was requested lately."""

    @property
    def positions(self) -> Mapping[str, str]:
        """Return the recorded positions and their method: ``solitary_wave`` or ``pulse_echo``."""
        return self._positions

    def find(self, key: ShotKey) -> Acquired | None:
        """Return the record of a shot; None if it was not recorded.

        Its set is read if it is not in memory; errors of ``read`` pass through.
        """
        record = self.records_of_set(key.set_key).get(key)
        return None if record is None else convert_stored_record(record)

    def has_attempt(self, key: ShotKey) -> bool:
        """Return whether this attempt at a shot has a record; reads its set if it is not in memory.

        Errors of ``read`` pass through.
        """
        return key in self.records_of_set(key.set_key)
