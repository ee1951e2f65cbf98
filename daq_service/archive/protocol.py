"""What an archive is: a folder today; an object store keeps the same promises.

`tests/contract/archive_contract.py` is what each of them must pass.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

from daq_service.archive.records import (
    Damage,
    JournalDamage,
    MissedRecord,
    OpenSet,
    Places,
    SetRecord,
    SetReference,
    StoredSet,
)
from hardware_drivers.measurement import PulseEchoRecord, Shot, Waveform


@runtime_checkable
class SetReader(Protocol):
    """Reads what is stored, changes nothing; any number of them beside the one who writes.

    Attributes
    ----------
    name
        What messages call it: where the sets lie.
    """

    name: str

    def sets(self) -> Mapping[int, SetReference]:
        """Every complete set: index to reference, in the order of the sets."""
        ...

    def n_bytes(self) -> int:
        """Bytes that the complete sets take."""
        ...

    def read_set(self, reference: SetReference, *, skip_damaged: bool = False) -> SetRecord:
        """Read a set as it was stored.

        Parameters
        ----------
        skip_damaged
            Leave damaged records out; `verify_set` names them.

        Raises
        ------
        CorruptArchiveError
            A record is damaged (all of them are named) or the set as a whole.
        SetNotFoundError
            There is no such set.
        """
        ...

    def read_waveform(self, reference: SetReference, position: str, shot_index: int) -> Waveform:
        """Read one record, a shot's or (index 0) a pulse-echo record's; of attempts the accepted one.

        Raises
        ------
        SetNotFoundError
            There is no such set or record.
        CorruptArchiveError
            The record does not match its checksums.
        """
        ...

    def digest(self, reference: SetReference) -> str | None:
        """SHA-256 of a set's file; None where it has none, or none yet."""
        ...

    def verify_set(self, reference: SetReference) -> list[Damage]:
        """Read everything of a set and list what is damaged.

        Raises
        ------
        CorruptArchiveError
            The set as a whole cannot be read.
        SetNotFoundError
            There is no such set.
        """
        ...


@runtime_checkable
class Archive(SetReader, Protocol):
    """Stores sets too; the recorder's, who alone writes.

    A set may be taken in record by record (`begin_set`, `append`, `sync`, then `store_set`) or be stored at
    once. What `sync` acknowledged of a set that is never stored is there after a restart.

    Attributes
    ----------
    journal_damage
        What was found damaged when it was opened.
    """

    journal_damage: JournalDamage

    def begin_set(
        self, set_index: int, *, due_utc_ns: int, started_utc_ns: int, retired: Mapping[str, str]
    ) -> None:
        """Note that a set is begun; durable with the first `sync` after it."""
        ...

    def append(self, taken: Shot | PulseEchoRecord | MissedRecord, utc_ns: int) -> None:
        """Take in what a begun set has come to; acknowledged by `sync`."""
        ...

    def sync(self) -> list[int]:
        """Make everything durable that was taken in; return the shot ids that this acknowledges.

        Raises
        ------
        ArchiveWriteError
            Nothing was acknowledged; the next call tries again.
        """
        ...

    def open_sets(self) -> Mapping[int, OpenSet]:
        """Return the sets that an earlier process began and nobody ended, by index."""
        ...

    def resume_set(self, opened: OpenSet) -> None:
        """Go on with an open set: what comes is added to what is durable."""
        ...

    def close(self) -> None:
        """Let go of what is held open; nothing is lost."""
        ...

    def places(self, set_index: int) -> Places:
        """Where the journal has the durable frames of a set."""
        ...

    def settle(self, set_index: int) -> None:
        """Forget the journal's part of a set: it has its own file, or rows without a record."""
        ...

    def store_set(self, record: SetRecord) -> StoredSet:
        """Make a set durable; only when this returns is it acknowledged.

        Raises
        ------
        ConflictingSetError
            This set is stored with other content, which stays.
        ArchiveWriteError
            The set is not stored; it may be stored again.
        ValueError
            JSON cannot hold the provenance.
        """
        ...

    def set_aside(self, reference: SetReference) -> None:
        """Take a set that cannot be read out of the way, for a person to look at; nothing is deleted.

        Raises
        ------
        ArchiveWriteError
            It stays where it is.
        """
        ...

    def quarantined(self) -> list[str]:
        """Name everything that was set aside and is still there."""
        ...
