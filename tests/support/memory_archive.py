"""An archive in memory, for tests of what writes to one and reads from one: neither disk nor HDF5."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from daq_service.archive import (
    ConflictingSetError,
    CorruptArchiveError,
    Damage,
    OpenSet,
    Places,
    SetNotFoundError,
    SetRecord,
    SetReference,
    StoredSet,
    StoreTimings,
    compute_crc32,
)
from daq_service.archive.records import SETS_FOLDER, JournalDamage
from hardware_drivers.measurement import MissedShot, PulseEchoRecord, SetKey, Shot, Waveform
from hardware_drivers.nanoseconds import NS_PER_S

NO_TIME = StoreTimings(image_s=0.0, fsync_s=0.0)


@dataclass(slots=True)
class Shelf:
    """Data that survive an archive's process: its stored sets, and which of them are corrupt."""

    sets: dict[SetReference, SetRecord] = field(default_factory=dict)
    open: dict[SetKey, OpenSet] = field(default_factory=dict)
    damaged: set[tuple[SetReference, int]] = field(default_factory=set)
    quarantine: list[tuple[SetReference, SetRecord]] = field(default_factory=list)


def reference_of(set_key: SetKey, due_utc_ns: int) -> SetReference:
    """Return the reference of a set, as a folder names its file."""
    due = datetime.fromtimestamp(due_utc_ns // NS_PER_S, tz=UTC)
    number = f"_{set_key.unscheduled_index:03d}" if set_key.unscheduled_index else ""
    return SetReference(f"{SETS_FOLDER}/set_{set_key.set_index:06d}_{due:%Y%m%dT%H%M%SZ}{number}.h5")


class MemoryArchive:
    """Archive in memory that keeps the contract, except for surviving the process.

    Parameters
    ----------
    shelf
        Another archive's, to continue with its sets as after a restart.
    """

    name = "memory"
    journal_damage = JournalDamage()

    def __init__(self, shelf: Shelf | None = None) -> None:
        self.shelf = Shelf() if shelf is None else shelf
        self._open_sets: dict[SetKey, OpenSet] = {}

    def begin_set(self, set_key: SetKey, **open_set: Any) -> None:
        last_utc_ns = open_set["started_utc_ns"]
        self._open_sets[set_key] = OpenSet(set_key=set_key, last_utc_ns=last_utc_ns, **open_set)

    def append(self, taken: Shot | PulseEchoRecord | MissedShot, utc_ns: int) -> None:
        open_set = self._open_sets.get(taken.key.set_key)
        if open_set is None:
            return
        name = "missed" if isinstance(taken, MissedShot) else "records"
        added: Any = {name: [*getattr(open_set, name), taken]}
        last_utc_ns = max(open_set.last_utc_ns, utc_ns)
        self._open_sets[taken.key.set_key] = replace(open_set, last_utc_ns=last_utc_ns, **added)

    def close(self) -> None:
        """Do nothing: no resource is held."""

    def digest(self, reference: SetReference) -> None:
        """Return no digest: there are no files."""

    def sync(self) -> list[int]:
        before = {item.sequence for open_set in self.shelf.open.values() for item in open_set.records}
        self.shelf.open |= self._open_sets
        now = [item.sequence for open_set in self._open_sets.values() for item in open_set.records]
        return [sequence for sequence in now if sequence not in before]

    def open_sets(self) -> dict[SetKey, OpenSet]:
        return dict(self.shelf.open)

    def resume_set(self, opened: OpenSet) -> None:
        self._open_sets[opened.set_key] = opened

    def places(self, set_key: SetKey) -> Places:
        """Return no byte ranges: memory has no segments."""
        return {}

    def settle(self, set_key: SetKey) -> None:
        self._open_sets.pop(set_key, None)
        self.shelf.open.pop(set_key, None)

    def store_set(self, record: SetRecord) -> StoredSet:
        reference = reference_of(record.set_key, record.due_utc_ns)
        stored = self.sets().get(record.set_key)
        record = replace(
            record,
            provenance=json.loads(json.dumps(record.provenance, allow_nan=False)),
            environment={name: value for name, value in record.environment.items() if value is not None},
            outcomes={
                sequence: outcome for sequence, outcome in record.outcomes.items() if outcome != "accepted"
            },
        )
        if stored is not None and bits(self.shelf.sets[stored]) != bits(record):
            raise ConflictingSetError(f"set {record.set_key} is stored already in {stored} and differs")
        self.shelf.sets[reference] = record
        self.settle(record.set_key)
        crc32 = {item.sequence: compute_crc32(item.waveform) for item in record.records}
        return StoredSet(file=reference, n_bytes=_n_bytes(record), crc32=crc32, timings=NO_TIME)

    def set_aside(self, reference: SetReference) -> None:
        self.shelf.quarantine.append((reference, self.shelf.sets.pop(reference)))

    def list_quarantined(self) -> list[str]:
        return [reference for reference, _ in self.shelf.quarantine]

    def sets(self) -> dict[SetKey, SetReference]:
        return dict(sorted((record.set_key, file) for file, record in self.shelf.sets.items()))

    def n_bytes(self) -> int:
        return sum(map(_n_bytes, self.shelf.sets.values()))

    def read_set(self, reference: SetReference, *, skip_damaged: bool = False) -> SetRecord:
        record, damages = self._found(reference), self.verify_set(reference)
        lost = {damage.sequence for damage in damages}
        if not damages:
            return record
        if not skip_damaged or len(lost) == len(record.records):
            raise CorruptArchiveError(f"{self.name}/{reference}: {'; '.join(map(str, damages))}")
        return replace(
            record,
            shots=[shot for shot in record.shots if shot.sequence not in lost],
            echoes=[echo for echo in record.echoes if echo.sequence not in lost],
            outcomes={
                sequence: outcome for sequence, outcome in record.outcomes.items() if sequence not in lost
            },
        )

    def read_waveform(self, reference: SetReference, position: str, shot_index: int) -> Waveform:
        record = self._found(reference)
        attempts = [
            item
            for item in record.records
            if (item.key.position, item.key.shot_index) == (position, shot_index)
        ]
        if not attempts:
            raise SetNotFoundError(
                f"{self.name}/{reference} has no shot {shot_index} of position {position!r}"
            )
        one = max(attempts, key=lambda item: (item.sequence not in record.outcomes, item.key.attempt))
        if (reference, one.sequence) in self.shelf.damaged:
            raise CorruptArchiveError(f"{self.name}/{reference}: {_damage(one)}")
        return one.waveform

    def verify_set(self, reference: SetReference) -> list[Damage]:
        records = self._found(reference).records
        return [_damage(item) for item in records if (reference, item.sequence) in self.shelf.damaged]

    def _found(self, reference: SetReference) -> SetRecord:
        try:
            return self.shelf.sets[reference]
        except KeyError:
            raise SetNotFoundError(f"there is no file {self.name}/{reference}") from None


def bits(value: Any) -> Any:
    """Return a record as plain values that are equal if every bit is."""
    if is_dataclass(value):
        return (type(value).__name__, *(bits(getattr(value, item.name)) for item in fields(value)))
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, Mapping):
        return {key: bits(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [bits(item) for item in value]
    return value.hex() if isinstance(value, float) else value


def _n_bytes(record: SetRecord) -> int:
    return sum(item.waveform.counts.nbytes for item in record.records)


def _damage(item: Shot | PulseEchoRecord) -> Damage:
    key = item.key
    return Damage(reason="CRC-32", sequence=item.sequence, position=key.position, shot_index=key.shot_index)
