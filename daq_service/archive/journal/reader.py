"""What lies in the journal: whole sets that have no file yet, and sets that a crash or a stop left open."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from daq_service.archive.journal.frames import Frame, Kind, frames, missed_of, record_of
from daq_service.archive.records import (
    JOURNAL_FOLDER,
    Damage,
    MissedRecord,
    OpenSet,
    Places,
    PositionRecord,
    SetRecord,
    SetReference,
    set_reference,
)
from daq_service.shared_file import read_shared
from hardware_drivers.measurement import PulseEchoRecord, Shot, ShotKey

_NAME = re.compile(r"(\d{6,})\.journal")


@dataclass(slots=True, kw_only=True, eq=False)
class JournaledSet:
    """Everything that the journal holds of a set.

    Attributes
    ----------
    shots
        Sound frames of its records by sequence.
    end
        Facts of its end; None: it was never ended.
    segments
        Numbers of the segments in which its frames lie.
    """

    set_index: int
    begin: Frame | None = None
    shots: dict[int, Frame] = field(default_factory=dict)
    missed: dict[ShotKey, MissedRecord] = field(default_factory=dict)
    end: Mapping[str, Any] | None = None
    last_utc_ns: int = 0
    segments: set[int] = field(default_factory=set)

    def take(self, frame: Frame, segment: int) -> None:
        """Add what a frame says; a record that was written twice counts once."""
        self.segments.add(segment)
        if not frame.sound:
            return  # torn with the power, or damaged later: then the set's end names what is missing
        self.last_utc_ns = max(self.last_utc_ns, frame.utc_ns)
        match frame.kind:
            case Kind.BEGIN:
                self.begin = self.begin or frame
            case Kind.SHOT | Kind.ECHO:
                self.shots[frame.sequence] = frame
            case Kind.MISSED:
                missed = missed_of(frame)
                self.missed[missed.key] = missed
            case Kind.ASIDE:
                self.begin, self.end = None, None
                self.shots.clear()
                self.missed.clear()
            case Kind.END:
                self.end = {**frame.told(), "ended_utc_ns": frame.utc_ns}

    @property
    def reference(self) -> SetReference | None:
        """The file that it will have; None before its end."""
        return None if self.end is None else set_reference(self.set_index, self.end["due_utc_ns"])

    @property
    def is_whole(self) -> bool:
        """It was ended, and every record is sound."""
        return self.end is not None and not self.damages()

    @property
    def n_bytes(self) -> int:
        """Bytes of its counts."""
        return sum(len(frame.counts) for frame in self.shots.values())

    @property
    def has_records(self) -> bool:
        """One record at least is sound."""
        return bool(self.shots)

    def sequence_of(self, position: str, shot_index: int) -> int | None:
        """Of the attempts at a shot the accepted one; None if there was none."""
        assert self.end is not None, "only an ended set names its records"
        replaced = {sequence for sequence, _ in self.end["outcomes"]}
        attempts = [
            (sequence not in replaced, attempt, sequence)
            for sequence, place, index, attempt in self.end["records"]
            if (place, index) == (position, shot_index)
        ]
        return max(attempts)[-1] if attempts else None

    def damages(self) -> list[Damage]:
        """List the records that its end names and that cannot be read."""
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
        """Return the set as it was ended, as far as its records are sound."""
        told = self.end
        assert told is not None, "a set that was not ended has no record"
        sequences = [sequence for sequence, *_ in told["records"] if sequence in self.shots]
        taken = [record_of(self.shots[sequence]) for sequence in sequences]
        return SetRecord(
            set_index=self.set_index,
            positions=[PositionRecord(**position) for position in told["positions"]],
            shots=[item for item in taken if isinstance(item, Shot)],
            echoes=[item for item in taken if isinstance(item, PulseEchoRecord)],
            missed=[_missed(item) for item in told["missed"]],
            outcomes={sequence: text for sequence, text in told["outcomes"] if sequence in sequences},
            **{name: told[name] for name in _PLAIN},
        )

    def opened(self) -> OpenSet | None:
        """Return what was durable of a set that is not whole; None if nothing of it is left."""
        told: dict[str, Any]
        if self.begin is not None:
            told = {**self.begin.told(), "started_utc_ns": self.begin.utc_ns}
        elif self.end is not None:
            told = {**self.end, "retired": {}}
        elif self.shots or self.missed:
            first_ns = min((frame.utc_ns for frame in self.shots.values()), default=self.last_utc_ns)
            told = {"due_utc_ns": first_ns, "started_utc_ns": first_ns, "retired": {}}
        else:
            return None
        return OpenSet(
            set_index=self.set_index,
            due_utc_ns=told["due_utc_ns"],
            started_utc_ns=told["started_utc_ns"],
            last_utc_ns=self.last_utc_ns,
            retired=told["retired"],
            is_dated=self.begin is not None or self.end is not None,
            records=[record_of(frame) for _, frame in sorted(self.shots.items())],
            missed=list(self.missed.values()),
        )


_PLAIN = (
    *("due_utc_ns", "due_h", "started_utc_ns", "ended_utc_ns", "rig_kind"),
    *("trouble", "environment", "provenance"),
)


def _missed(told: Mapping[str, Any]) -> MissedRecord:
    key = ShotKey(**{name: told[name] for name in ("position", "set_index", "shot_index", "attempt")})
    return MissedRecord(key=key, cause=told["cause"], reason=told["reason"])


def segments(folder: Path) -> dict[int, Path]:
    """Segments of a data folder by their number, in order."""
    found = ((_NAME.fullmatch(path.name), path) for path in (folder / JOURNAL_FOLDER).glob("*.journal"))
    return dict(sorted((int(match[1]), path) for match, path in found if match))


def number_of(file: str) -> int:
    """Return the number of a segment by its name."""
    return int(Path(file).stem)


def strays(folder: Path) -> list[Path]:
    """Files of the journal's folder that hold frames, but have no segment's name."""
    others = (path for path in (folder / JOURNAL_FOLDER).glob("*") if not _NAME.fullmatch(path.name))
    return [path for path in others if path.is_file() and any(frames(read_shared(path)))]


def segment_path(folder: Path, number: int) -> Path:
    """Where a segment lies."""
    return folder / JOURNAL_FOLDER / f"{number:06d}.journal"


def read_journal(
    folder: Path, *, of_set: int | None = None, places: Places | None = None
) -> dict[int, JournaledSet]:
    """Read every segment; set index to what there is of it (of one set alone), in the order of the sets.

    A segment that goes while it is read has left its sets in files of their own.

    Parameters
    ----------
    places
        Where the frames of that set lie, as far as that is known (`Archive.places`); None: anywhere.

    Raises
    ------
    OSError
        A segment cannot be read.
    """
    found: dict[int, JournaledSet] = {}
    for number, content in contents(folder, places):
        for frame in frames(content, of_set=of_set):
            found.setdefault(frame.set_index, JournaledSet(set_index=frame.set_index)).take(frame, number)
    return dict(sorted(found.items()))


def contents(folder: Path, places: Places | None = None) -> Iterator[tuple[int, bytes]]:
    """Yield number and bytes of each segment, or its place, in order; one that goes meanwhile is left out."""
    for number, path in segments(folder).items():
        if places is not None and number not in places:
            continue
        first, last = (0, None) if places is None else places[number]
        try:
            yield number, read_shared(path, first, last)
        except FileNotFoundError:
            continue
