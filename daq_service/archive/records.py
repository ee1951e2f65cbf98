"""Data types of the archive: a set of measurements, its parts, and the name of its file."""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any, NewType

from daq_service.clock import parse_utc
from hardware_drivers.measurement import DueSet, MissedShot, OfSet, PulseEchoRecord, SetKey, Shot, Waveform
from hardware_drivers.nanoseconds import NS_PER_S

SETS_FOLDER = "sets"
QUARANTINE_FOLDER = "quarantine"
JOURNAL_FOLDER = "journal"
TEMPORARY_SUFFIX = ".tmp"
Results = Mapping[str, Mapping[str, Sequence[float | str]]]
"""Results of a set: name of a table, name of a column, values."""
SetReference = NewType("SetReference", str)
"""Value of the catalogue's ``sets.file``: ``sets/`` and the set's file name, in every archive."""
Places = Mapping[int, tuple[int, int | None]]
"""First and last byte (None: the end) of a set in each segment of the journal, by segment number."""
_NAME = re.compile(r"set_(\d{6,})_(\d{8}T\d{6}Z)(?:_(\d{3}))?\.h5")
_LINES = re.compile(f"^{_NAME.pattern}$", re.MULTILINE)
"""Matching a year's names at once takes half the time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionRecord:
    """Planned records of a position in this set, and why some are missing.

    Attributes
    ----------
    method
        ``solitary_wave`` or ``pulse_echo``.
    n_planned
         Number of planned records.
    cause
        Why fewer were taken; empty if the set is complete.
    serial_number
        Serial number of the transducer; empty if unknown.
    """

    position: str
    method: str
    n_planned: int
    cause: str = ""
    label: str = ""
    serial_number: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SetRecord(OfSet):
    """All measurements of one due time.

    Attributes
    ----------
    due_h
        Hours since the experiment's epoch.
    started_utc_ns, ended_utc_ns
        Experiment time of the first and after the last measurement.
    positions
        Every planned position, also those without a record.
    missed
         Strikes and echoes without a record.
    outcomes
        Sequence of a record to ``accepted`` or ``superseded`` (a repetition of the same shot counts
        instead); a record that is not named is accepted.
    trouble
        The instrument's error that ended the set early, ``class: message``; empty: there was none.
    environment
        JSON-ready: values of supply and climate probe around the set; empty if there are none.
    provenance
        JSON-ready: configuration, ``configuration_hash``, host, versions, the rig's identity.
    results
        A copy of the catalogue's results of the set (`layout.RESULTS`), NaN for a missing value; empty if the
        set was stored before they were computed.

    Raises
    ------
    ValueError
        No record at all (a set without records has no file), a record of another set or of a position that
        is not in `positions`, or a sequence twice.
    """

    set_index: int
    due_utc_ns: int
    due_h: float
    started_utc_ns: int
    ended_utc_ns: int
    rig_kind: str
    positions: Sequence[PositionRecord]
    shots: Sequence[Shot] = ()
    echoes: Sequence[PulseEchoRecord] = ()
    missed: Sequence[MissedShot] = ()
    outcomes: Mapping[int, str] = field(default_factory=dict)
    trouble: str = ""
    environment: Mapping[str, float | str | None] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    results: Results = field(default_factory=dict)
    unscheduled_index: int = 0

    def __post_init__(self) -> None:
        for name in ("positions", "shots", "echoes", "missed"):
            Any.__setattr__(self, name, tuple(getattr(self, name)))
        records = self.records
        if not records:
            raise ValueError(f"set {self.set_key} has no record; a set without one has rows but no file")
        names = [position.position for position in self.positions]
        if len(set(names)) != len(names):
            raise ValueError(f"set {self.set_key} names a position twice: {names}")
        for record in records:
            if record.key.set_key != self.set_key or record.key.position not in names:
                raise ValueError(
                    f"shot {record.sequence} is of set {record.key.set_key}, {record.key.position!r}; "
                    f"this is set {self.set_key} of positions {names}"
                )
        if len({record.sequence for record in records}) != len(records):
            raise ValueError(f"set {self.set_key} has a sequence twice; each record needs its own")

    @property
    def due(self) -> DueSet:
        """Due time of the set, and the position of an unscheduled one."""
        return DueSet(
            set_index=self.set_index,
            unscheduled_index=self.unscheduled_index,
            due_h=self.due_h,
            due_utc_ns=self.due_utc_ns,
            position=self.positions[0].position if self.unscheduled_index else None,
        )

    @property
    def records(self) -> list[Shot | PulseEchoRecord]:
        """Return shots and pulse-echo records in the order of acquisition."""
        return sorted((*self.shots, *self.echoes), key=lambda record: record.sequence)

    def n_missed(self, position: str) -> int:
        """Count the strikes or echoes of a position without a record."""
        return sum(item.key.position == position for item in self.missed)

    def n_tried(self, position: str) -> int:
        """Count the shots of a position that were struck, with or without a record, without repetitions."""
        return self._attempts_at(position).count(0)

    def n_restrikes(self, position: str) -> int:
        """Count the repetitions of a position's shots, with or without a record."""
        return sum(attempt > 0 for attempt in self._attempts_at(position))

    def _attempts_at(self, position: str) -> list[int]:
        tried: list[Shot | MissedShot] = [*self.shots, *self.missed]
        return [item.key.attempt for item in tried if item.key.position == position]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SetTables:
    """Tables of a set's file, each as rows: of its records (``shots``), and the results of each kind."""

    set_key: SetKey
    shots: Sequence[Mapping[str, Any]]
    results: Mapping[str, Sequence[Mapping[str, Any]]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpenSet:
    """Durable part of a set that a crash or a stop interrupted.

    Attributes
    ----------
    disabled
        Positions that were excluded at its start, and why.
    last_utc_ns
        Experiment time of its last durable frame.
    is_dated
        False: the frame with due time and ``disabled`` is corrupt; the time of the first shot replaces it.
    """

    set_key: SetKey
    due_utc_ns: int
    started_utc_ns: int
    last_utc_ns: int
    disabled: Mapping[str, str] = field(default_factory=dict)
    records: Sequence[Shot | PulseEchoRecord] = ()
    missed: Sequence[MissedShot] = ()
    is_dated: bool = True


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JournalDamage:
    """Corruption of the journal that was found at a start.

    Attributes
    ----------
    files
        Copy of each corrupt segment in the quarantine, with a description of the corruption.
    sets
        Sets without a file that may lack a record.
    next_sequence
        Greater than every shot id in the journal and every possible id of a lost frame.
    n_lost
        Maximum number of lost frames with unknown ids.
    """

    files: Mapping[str, str] = field(default_factory=dict)
    sets: frozenset[SetKey] = frozenset()
    next_sequence: int = 0
    n_lost: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class StoreTimings:
    """Durations of the steps of storing a set."""

    image_s: float
    fsync_s: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StoredSet:
    """A durable set.

    Attributes
    ----------
    file
        Relative to the data folder, with forward slashes.
    crc32
        Sequence of each record to the CRC-32 of its counts: the catalogue's ``shots.crc32``.
    """

    file: SetReference
    n_bytes: int
    crc32: Mapping[int, int]
    timings: StoreTimings


@dataclass(frozen=True, slots=True, kw_only=True)
class Damage:
    """Description of an unreadable record; `position` None: another part of the file."""

    reason: str
    sequence: int | None = None
    position: str | None = None
    shot_index: int | None = None

    def __str__(self) -> str:
        if self.position is None:
            return self.reason
        return f"shot {self.shot_index} of {self.position} (sequence {self.sequence}): {self.reason}"


@lru_cache(maxsize=64)
def waveform_crc32(waveform: Waveform) -> int:
    """Return the CRC-32 (zlib's) of a record's counts as little-endian bytes.

    Cached, since file, acknowledgement and catalogue need the CRC-32 of the same, immutable waveform.
    """
    counts = waveform.counts
    return zlib.crc32(counts.astype(counts.dtype.newbyteorder("<"), order="C", copy=False).data)


def set_reference(set_key: SetKey, due_utc_ns: int) -> SetReference:
    """Return the reference of a set; references sort by time.

    That of an unscheduled set has the index of the scheduled one before it, and ends with its own number.
    """
    due = datetime.fromtimestamp(due_utc_ns // NS_PER_S, tz=UTC)
    set_index, unscheduled_index = set_key
    number = f"_{unscheduled_index:03d}" if unscheduled_index else ""
    return SetReference(f"{SETS_FOLDER}/set_{set_index:06d}_{due:%Y%m%dT%H%M%SZ}{number}.h5")


def due_utc_ns(reference: SetReference) -> int:
    """Return the due time of a set to the second."""
    match = _NAME.fullmatch(reference.rpartition("/")[2])
    assert match is not None, f"{reference} is no reference of a set"
    return parse_utc(match[2])


def set_keys(names: Iterable[str]) -> set[SetKey]:
    """Return the keys of the sets with these file names."""
    return {*map(_key_of, _LINES.finditer("\n".join(names)))}


def referenced_sets(names: Iterable[str]) -> dict[SetKey, SetReference]:
    """Return the reference of each complete set by key, from file names, in the order of the sets."""
    matches = (match for match in map(_NAME.fullmatch, names) if match)
    return dict(sorted((_key_of(match), SetReference(f"{SETS_FOLDER}/{match[0]}")) for match in matches))


def _key_of(match: re.Match[str]) -> SetKey:
    """Return the key of a set; in file names of earlier versions the first number may be that of any set."""
    return SetKey(int(match[1]), int(match[3])) if match[3] else SetKey.of_number(int(match[1]))
