"""Interface of an archive: a folder today; an object store would have the same contract.

`tests/contract/archive_contract.py` tests each of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

from daq_service.archive.records import Damage, JournalDamage, OpenSet, Places, SetReference, StoredSet
from hardware_drivers.measurement import MissedShot, PulseEchoRecord, SetKey, SetRecord, Shot, Waveform


@runtime_checkable
class SetReader(Protocol):
    """Read-only access to stored sets; several readers may work while one process writes.

    Attributes
    ----------
    name
        Location of the sets, for messages.
    """

    name: str

    def sets(self) -> Mapping[SetKey, SetReference]:
        """Return every complete set, key to reference, in the order of the sets.

        Raises ArchiveError if they cannot be read.
        """
        ...

    def n_bytes(self) -> int:
        """Return the size of the complete sets in bytes: of their files, without a file of their counts."""
        ...

    def read_set(self, reference: SetReference, *, skip_damaged: bool = False) -> SetRecord:
        """Read a set, records and metadata, as it was stored.

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
        """Read one record: the accepted attempt of a shot, or (shot index 0) a pulse-echo record.

        Raises
        ------
        SetNotFoundError
            There is no such set or record.
        CorruptArchiveError
            The record does not match its checksums.
        """
        ...

    def digest(self, reference: SetReference) -> str | None:
        """Compute the SHA-256 of a set's file in hexadecimal; None if it has no file (yet).

        Raises ArchiveError if the file cannot be read.
        """
        ...

    def verify_set(self, reference: SetReference) -> list[Damage]:
        """Read a complete set and list its corrupt records and parts; empty if it is sound.

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
    """Archive that the recorder, the only writer, stores sets in.

    A set may be stored record by record (`begin_set`, `append`, `sync`, then `store_set`) or at once. Records
    of an unfinished set that `sync` acknowledged are available after a restart.

    Attributes
    ----------
    journal_damage
        Corruption of the journal that was found on opening.
    """

    journal_damage: JournalDamage

    def begin_set(
        self, set_key: SetKey, *, due_utc_ns: int, started_utc_ns: int, disabled: Mapping[str, str]
    ) -> None:
        """Add the start of a set to the journal; the next `sync` makes it durable.

        ``disabled`` holds the reason of each position that is left out; times are ns of UTC.
        """
        ...

    def append(self, item: Shot | PulseEchoRecord | MissedShot, utc_ns: int) -> None:
        """Add a record or a missed record to a started set; the next `sync` acknowledges it.

        ``utc_ns`` is the test's time of a missed record.
        """
        ...

    def sync(self) -> list[int]:
        """Make all additions durable; block until then and return the ids of the acknowledged shots.

        Raises
        ------
        ArchiveWriteError
            Nothing was acknowledged; the next call tries again.
        """
        ...

    def open_sets(self) -> Mapping[SetKey, OpenSet]:
        """Return the unfinished sets that earlier processes left, by key; empty if there are none."""
        ...

    def resume_set(self, opened: OpenSet) -> None:
        """Continue an open set of an earlier process: later additions follow its durable records."""
        ...

    def close(self) -> None:
        """Release open files without a sync; what was acknowledged is not lost."""
        ...

    def places(self, set_key: SetKey) -> Places:
        """Return first and last byte of a set's durable frames in the journal by number of the segment."""
        ...

    def settle(self, set_key: SetKey) -> None:
        """Remove a set from the journal, because it has its own file, or rows without a record.

        Segments without other sets are deleted.
        """
        ...

    def store_set(self, record: SetRecord) -> StoredSet:
        """Make a complete set durable, blocking until it is; it is acknowledged only when this returns.

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
        """Move an unreadable set to the quarantine, so that it may be stored again; nothing is deleted.

        Raises
        ------
        ArchiveWriteError
            It stays where it is.
        """
        ...

    def list_quarantined(self) -> list[str]:
        """List all files in the quarantine by path relative to the data folder, sorted; empty without any."""
        ...
