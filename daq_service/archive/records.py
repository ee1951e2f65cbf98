"""Data types of the archive: what is stored of a set, and the name of its file."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, NewType

from daq_service.clock import parse_utc
from hardware_drivers.measurement import MissedShot, PulseEchoRecord, SetKey, Shot
from hardware_drivers.nanoseconds import NS_PER_S

SETS_FOLDER = "sets"
QUARANTINE_FOLDER = "quarantine"
JOURNAL_FOLDER = "journal"
TEMPORARY_SUFFIX = ".tmp"
SetReference = NewType("SetReference", str)
"""Value of the catalogue's ``sets.file``: ``sets/`` and the set's file name, in every archive."""
Places = Mapping[int, tuple[int, int | None]]
"""First and last byte (None: the end) of a set in each segment of the journal, by segment number."""
_NAME = re.compile(r"set_(\d{6,})_(\d{8}T\d{6}Z)(?:_(\d{3}))?\.h5")
_LINES = re.compile(f"^{_NAME.pattern}$", re.MULTILINE)
"""Matching a year's names at once takes half the time."""


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
        """Return the reason, for a record with shot, position and sequence."""
        if self.position is None:
            return self.reason
        return f"shot {self.shot_index} of {self.position} (sequence {self.sequence}): {self.reason}"


def build_reference(set_key: SetKey, due_utc_ns: int) -> SetReference:
    """Build the reference (file name) of a set from its key and due time; references sort by time.

    That of an unscheduled set has the index of the scheduled one before it, and ends with its own number.
    """
    due = datetime.fromtimestamp(due_utc_ns // NS_PER_S, tz=UTC)
    set_index, unscheduled_index = set_key
    number = f"_{unscheduled_index:03d}" if unscheduled_index else ""
    return SetReference(f"{SETS_FOLDER}/set_{set_index:06d}_{due:%Y%m%dT%H%M%SZ}{number}.h5")


def parse_due_utc_ns(reference: SetReference) -> int:
    """Parse the due time of a set from its reference, to the second, in ns of UTC.

    The reference must be valid (AssertionError).
    """
    match = _NAME.fullmatch(reference.rpartition("/")[2])
    assert match is not None, f"{reference} is no reference of a set"
    return parse_utc(match[2])


def parse_set_keys(names: Iterable[str]) -> set[SetKey]:
    """Parse the keys of sets from file names, without order; ignore names of other files."""
    return {*map(_parse_key, _LINES.finditer("\n".join(names)))}


def to_references(names: Iterable[str]) -> dict[SetKey, SetReference]:
    """Parse file names to references by set key, sorted by key; ignore names of other files."""
    matches = (match for match in map(_NAME.fullmatch, names) if match)
    return dict(sorted((_parse_key(match), SetReference(f"{SETS_FOLDER}/{match[0]}")) for match in matches))


def _parse_key(match: re.Match[str]) -> SetKey:
    """Parse the key of a set from a match of `_NAME`; in names of earlier versions it is one number."""
    return SetKey(int(match[1]), int(match[3])) if match[3] else SetKey.from_number(int(match[1]))
