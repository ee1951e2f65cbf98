"""Read the journal: complete sets without a file, and sets that a crash or a stop left open."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from daq_service.archive.journal.frames import Frame, Kind, decode_missed, decode_record, parse_frames
from daq_service.archive.records import JOURNAL_FOLDER, Damage, OpenSet, Places, SetReference, build_reference
from daq_service.shared_file import read_shared
from hardware_drivers.measurement import (
    MissedShot,
    PositionRecord,
    PulseEchoRecord,
    SetKey,
    SetRecord,
    Shot,
    ShotKey,
)

_NAME = re.compile(r"(\d{6,})\.journal")


@dataclass(slots=True, kw_only=True, eq=False)
class JournaledSet:
    """All frames of a set in the journal.

    Attributes
    ----------
    shots
        Sound frames of its records by sequence.
    end
        Facts of its end; None: it was never ended.
    segments
        Numbers of the segments that hold its frames.
    """

    set_key: SetKey
    begin: Frame | None = None
    shots: dict[int, Frame] = field(default_factory=dict)
    missed: dict[ShotKey, MissedShot] = field(default_factory=dict)
    end: Mapping[str, Any] | None = None
    last_utc_ns: int = 0
    segments: set[int] = field(default_factory=set)

    def take(self, frame: Frame, segment: int) -> None:
        """Add a frame of the set from segment number ``segment``; a record that occurs twice counts once.

        A corrupt frame only adds its segment; an ``ASIDE`` frame discards the earlier ones.
        """
        self.segments.add(segment)
        if not frame.sound:
            return  # truncated by a power cut or corrupt: the set's end frame names the missing records
        self.last_utc_ns = max(self.last_utc_ns, frame.utc_ns)
        match frame.kind:
            case Kind.BEGIN:
                self.begin = self.begin or frame
            case Kind.SHOT | Kind.ECHO:
                self.shots[frame.sequence] = frame
            case Kind.MISSED:
                missed = decode_missed(frame)
                self.missed[missed.key] = missed
            case Kind.ASIDE:
                self.begin, self.end = None, None
                self.shots.clear()
                self.missed.clear()
            case Kind.END:
                self.end = {**frame.parse_facts(), "ended_utc_ns": frame.utc_ns}

    @property
    def reference(self) -> SetReference | None:
        """Return the reference of the file that the set gets when finalized; None before its end frame."""
        return None if self.end is None else build_reference(self.set_key, self.end["due_utc_ns"])

    @property
    def is_whole(self) -> bool:
        """Return whether the set has an end frame and every record that it names is intact."""
        return self.end is not None and not self.damages()

    @property
    def n_bytes(self) -> int:
        """Return the size in bytes of the counts of all its intact records."""
        return sum(len(frame.counts) for frame in self.shots.values())

    @property
    def has_records(self) -> bool:
        """Return whether the journal has an intact record of the set."""
        return bool(self.shots)

    def find_sequence(self, position: str, shot_index: int) -> int | None:
        """Find the sequence of the accepted attempt at a shot, else of the last one; None without any.

        Raises AssertionError for a set without end frame.
        """
        assert self.end is not None, "only an ended set names its records"
        replaced = {sequence for sequence, _ in self.end["outcomes"]}
        attempts = [
            (sequence not in replaced, attempt, sequence)
            for sequence, name, index, attempt in self.end["records"]
            if (name, index) == (position, shot_index)
        ]
        return max(attempts)[-1] if attempts else None

    def damages(self) -> list[Damage]:
        """List the records that the end frame names and that are missing or unreadable; empty if complete.

        Raises AssertionError for a set without end frame.
        """
        assert self.end is not None, "only an ended set names its records"
        return [
            Damage(
                reason="its frame in the journal is damaged",
                sequence=sequence,
                position=position,
                shot_index=shot_index,
            )
            for sequence, position, shot_index, _ in self.end["records"]
            if sequence not in self.shots
        ]

    def record(self) -> SetRecord:
        """Build the set from its end frame and its intact records, without the lost ones and without results.

        Raises AssertionError for a set without end frame.
        """
        end = self.end
        assert end is not None, "a set that was not ended has no record"
        sequences = [sequence for sequence, *_ in end["records"] if sequence in self.shots]
        records = [decode_record(self.shots[sequence]) for sequence in sequences]
        return SetRecord(
            set_index=self.set_key.set_index,
            unscheduled_index=self.set_key.unscheduled_index,
            positions=[PositionRecord(**position) for position in end["positions"]],
            shots=[item for item in records if isinstance(item, Shot)],
            echoes=[item for item in records if isinstance(item, PulseEchoRecord)],
            missed=[_parse_missed(self.set_key, item) for item in end["missed"]],
            outcomes={sequence: text for sequence, text in end["outcomes"] if sequence in sequences},
            **{name: end[name] for name in _PLAIN},
        )

    def opened(self) -> OpenSet | None:
        """Build the durable part of an incomplete set, to resume it; None if no sound frame of it is left.

        Without start and end frame the time of the first shot replaces the due time (``is_dated`` False).
        """
        facts: Mapping[str, Any]
        if self.begin is not None:
            facts = {**self.begin.parse_facts(), "started_utc_ns": self.begin.utc_ns}
        elif self.end is not None:
            facts = self.end
        elif self.shots or self.missed:
            first_ns = min((frame.utc_ns for frame in self.shots.values()), default=self.last_utc_ns)
            facts = {"due_utc_ns": first_ns, "started_utc_ns": first_ns}
        else:
            return None
        return OpenSet(
            set_key=self.set_key,
            due_utc_ns=facts["due_utc_ns"],
            started_utc_ns=facts["started_utc_ns"],
            last_utc_ns=self.last_utc_ns,
            disabled=facts.get("disabled", facts.get("retired", {})),  # the latter by earlier versions
            is_dated=self.begin is not None or self.end is not None,
            records=[decode_record(frame) for _, frame in sorted(self.shots.items())],
            missed=list(self.missed.values()),
        )


_PLAIN = (
    *("due_utc_ns", "due_h", "started_utc_ns", "ended_utc_ns", "rig_kind"),
    *("trouble", "environment", "provenance"),
)


def _parse_missed(set_key: SetKey, facts: Mapping[str, Any]) -> MissedShot:
    """Parse a missed record from an entry of the end frame; KeyError if the entry lacks a key."""
    key = ShotKey.from_set(set_key, facts["position"], facts["shot_index"], facts["attempt"])
    return MissedShot(key=key, cause=facts["cause"], reason=facts["reason"])


def list_segments(folder: Path) -> dict[int, Path]:
    """List the segments of a data folder by number, in order; other file names are ignored."""
    files = ((_NAME.fullmatch(path.name), path) for path in (folder / JOURNAL_FOLDER).glob("*.journal"))
    return dict(sorted((int(match[1]), path) for match, path in files if match))


def parse_segment_number(file: str) -> int:
    """Parse the number from the file name of a segment; ValueError if the name is no number."""
    return int(Path(file).stem)


def list_misnamed(folder: Path) -> list[Path]:
    """List the files of the journal's folder that hold a frame but lack a segment's name.

    Reads these files completely; raises OSError if one is unreadable.
    """
    others = (path for path in (folder / JOURNAL_FOLDER).glob("*") if not _NAME.fullmatch(path.name))
    return [path for path in others if path.is_file() and any(parse_frames(read_shared(path)))]


def build_segment_path(folder: Path, number: int) -> Path:
    """Build the path of a segment, such as ``journal/000001.journal``; the file may be missing."""
    return folder / JOURNAL_FOLDER / f"{number:06d}.journal"


def read_journal(
    folder: Path, *, of_set: SetKey | None = None, places: Places | None = None
) -> dict[SetKey, JournaledSet]:
    """Read the segments of the journal and return the journaled sets by key, in the order of the sets.

    A segment that disappears meanwhile is skipped: its sets have files of their own.

    Parameters
    ----------
    of_set
        Read this set alone.
    places
        Byte ranges of that set's frames (`Archive.places`); None: read all segments completely.

    Raises
    ------
    OSError
        A segment cannot be read.
    """
    journaled: dict[SetKey, JournaledSet] = {}
    for number, content in read_segments(folder, places):
        for frame in parse_frames(content, of_set=of_set):
            journaled.setdefault(frame.set_key, JournaledSet(set_key=frame.set_key)).take(frame, number)
    return dict(sorted(journaled.items()))


def read_segments(folder: Path, places: Places | None = None) -> Iterator[tuple[int, bytes]]:
    """Yield number and bytes of each segment, or of byte ranges of it; skip segments that vanished.

    With ``places`` only its segments are read. Raises OSError if one cannot be read.
    """
    for number, path in list_segments(folder).items():
        if places is not None and number not in places:
            continue
        first, last = (0, None) if places is None else places[number]
        try:
            yield number, read_shared(path, first, last)
        except FileNotFoundError:
            continue
