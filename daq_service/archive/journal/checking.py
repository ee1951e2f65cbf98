"""What of the journal is damaged: frames that do not match their checksums, and bytes that are no frame.

Nothing is written, and nothing that a recorder does meanwhile counts as damage.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from daq_service.archive.journal.frames import HEADER, Frame, frames
from daq_service.archive.journal.reader import JournaledSet, contents, segment_path, strays
from daq_service.archive.records import JOURNAL_FOLDER, SETS_FOLDER, Damage, referenced_sets

_PAGE_BYTES = 4096


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CheckedJournal:
    """The journal as it was found.

    Attributes
    ----------
    sets
        What it holds, by set index.
    damages
        Segment, relative to the data folder, and what of it is damaged.
    suspects
        Sets without a file that may lack a frame.
    last_sequence, n_lost
        Highest shot id that a frame has, and how many more frames there can have been.
    """

    sets: Mapping[int, JournaledSet]
    damages: list[tuple[str, Damage]]
    suspects: frozenset[int] = frozenset()
    last_sequence: int = -1
    n_lost: int = 0
    n_frames: int = 0
    n_bytes: int = 0


@dataclass(slots=True, eq=False)
class _Scan:
    """Frames that were found in all segments, and bytes between them that are none."""

    sets: dict[int, JournaledSet] = field(default_factory=dict)
    unsound: list[tuple[str, Frame]] = field(default_factory=list)
    odd: list[tuple[str, Damage]] = field(default_factory=list)
    suspects: set[int] = field(default_factory=set)
    last_sequence: int = -1
    n_lost: int = 0
    n_frames: int = 0
    n_bytes: int = 0

    def take(self, number: int, name: str, content: bytes) -> None:
        """Add a segment: frames, each directly behind the one before, then zeros to its end."""
        place, length, before = 0, len(content.rstrip(b"\0")), set[int]()
        for frame in frames(content):
            if frame.start > place:
                self._tell(name, place, frame.start, before | {frame.set_index})
            if not frame.sound and not _is_torn(frame, length, len(content)):
                self.unsound.append((name, frame))
            self.sets.setdefault(frame.set_index, JournaledSet(set_index=frame.set_index)).take(frame, number)
            self.n_frames += 1
            self.last_sequence = max(self.last_sequence, frame.sequence)
            place, before = frame.end, {frame.set_index}
        # A header alone that is cut was never acknowledged; behind a whole one there are facts.
        if length - place >= HEADER.size:
            self._tell(name, place, length, before)
        self.n_bytes += max(place, length)

    def _tell(self, name: str, start: int, end: int, neighbors: set[int]) -> None:
        self.suspects |= neighbors
        self.n_lost += 1 + (end - start) // HEADER.size
        self.odd.append(
            (name, Damage(reason=f"bytes {start} to {end} are no frame, or one whose header is damaged"))
        )


def _is_torn(frame: Frame, length: int, size: int) -> bool:
    """Whether a frame was cut while it was written: the system writes page after page, the rest is zeros."""
    return frame.end > size or -(-length // _PAGE_BYTES) * _PAGE_BYTES < frame.end


def check_journal(folder: Path) -> CheckedJournal:
    """Read every frame of a data folder's journal.

    What a crash cut before anybody was told of it is no damage; where whole pages were lost in its midst,
    as a power cut can do, nobody can tell it from damage.

    Raises
    ------
    OSError
        A segment cannot be read.
    """
    scan = _Scan()
    for number, content in contents(folder):
        scan.take(number, _name(folder, number), content)
    filed = referenced_sets(path.name for path in (folder / SETS_FOLDER).glob("set_*.h5"))
    damages = list(scan.odd)
    misnamed = Damage(reason="it holds frames, but its name is no segment's")
    damages += [(f"{JOURNAL_FOLDER}/{path.name}", misnamed) for path in strays(folder)]
    told: set[int] = set()
    for index, item in scan.sets.items():
        if item.end is not None and index not in filed:
            # Where several segments share a set, nobody knows in which of them a frame is gone.
            own = [(name, frame) for name, frame in scan.unsound if frame.set_index == index]
            places = {frame.sequence: name for name, frame in own}
            for damage in item.damages():
                told.add(damage.sequence or 0)
                place = places.get(damage.sequence or 0, _name(folder, min(item.segments)))
                damages.append((place, damage))
    for name, frame in scan.unsound:
        item = scan.sets[frame.set_index]
        # Of a set with a file nobody reads it any more; a group that failed was written again elsewhere.
        if frame.set_index not in filed and frame.sequence not in told and frame.sequence not in item.shots:
            shot = f"shot {frame.sequence}" if frame.sequence >= 0 else "a note"
            where = f"byte {frame.start}, {shot} of set {frame.set_index}"
            reason = f"the frame at {where}, does not match its checksum"
            damages.append((name, Damage(reason=reason, sequence=max(frame.sequence, 0) or None)))
    suspects = {frame.set_index for _, frame in scan.unsound} | scan.suspects
    return CheckedJournal(
        sets=dict(sorted(scan.sets.items())),
        damages=damages,
        suspects=frozenset(i for i in suspects if i not in filed and not scan.sets[i].is_whole),
        last_sequence=scan.last_sequence,
        n_lost=scan.n_lost,
        n_frames=scan.n_frames,
        n_bytes=scan.n_bytes,
    )


def _name(folder: Path, number: int) -> str:
    return segment_path(folder, number).relative_to(folder).as_posix()
