"""Find corruption in the journal: frames that do not match their checksums, and bytes outside frames.

Nothing is written, and concurrent changes by a recorder do not count as corruption.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from daq_service.archive.journal.frames import HEADER, Frame, parse_frames
from daq_service.archive.journal.reader import JournaledSet, build_segment_path, list_misnamed, read_segments
from daq_service.archive.records import JOURNAL_FOLDER, SETS_FOLDER, Damage, to_references
from hardware_drivers.measurement import SetKey

_SECTOR_BYTES = 512


@dataclass(slots=True, kw_only=True, eq=False)
class CheckedJournal:
    """Result of a check of the journal.

    Attributes
    ----------
    sets
         Journaled sets by key.
    damages
        Path of the segment, relative to the data folder, and the corruption.
    suspects
        Sets without a file that may lack a frame.
    unsound
        Frames that do not match their checksum, each with the path of its segment.
    last_sequence, n_lost
        Highest shot id of all frames, and upper limit of the number of lost frames.
    """

    sets: dict[SetKey, JournaledSet] = field(default_factory=dict)
    damages: list[tuple[str, Damage]] = field(default_factory=list)
    suspects: set[SetKey] = field(default_factory=set)
    unsound: list[tuple[str, Frame]] = field(default_factory=list)
    last_sequence: int = -1
    n_lost: int = 0
    n_frames: int = 0
    n_bytes: int = 0

    def take(self, number: int, name: str, content: bytes) -> None:
        """Add the frames of segment ``number`` and count its bytes; list the damage instead of raising.

        Bytes between frames that are no frame count as damage; zeros at the end do not. ``name`` is the
        segment's path in the list of damages.
        """
        end_of_last, length, last_sets = 0, len(content.rstrip(b"\0")), set[SetKey]()
        for frame in parse_frames(content):
            if frame.start > end_of_last:
                self._add_damage(name, end_of_last, frame.start, last_sets | {frame.set_key})
            if not frame.sound and not _is_truncated(frame, length, len(content)):
                self.unsound.append((name, frame))
            self.sets.setdefault(frame.set_key, JournaledSet(set_key=frame.set_key)).take(frame, number)
            self.n_frames += 1
            self.last_sequence = max(self.last_sequence, frame.sequence)
            end_of_last, last_sets = frame.end, {frame.set_key}
        # A truncated header was never acknowledged; a complete one is followed by facts.
        if length - end_of_last >= HEADER.size:
            self._add_damage(name, end_of_last, length, last_sets)
        self.n_bytes += max(end_of_last, length)

    def _add_damage(self, name: str, start: int, end: int, neighbors: set[SetKey]) -> None:
        """Add a damage for the bytes ``start`` to ``end`` of a segment, which are no frame.

        Raises the number of lost frames by as many as fit there; the sets of the frames around
        (``neighbors``) become suspects.
        """
        self.suspects |= neighbors
        self.n_lost += 1 + (end - start) // HEADER.size
        self.damages.append(
            (name, Damage(reason=f"bytes {start} to {end} are no frame, or one whose header is damaged"))
        )


def _is_truncated(frame: Frame, length: int, size: int) -> bool:
    """Return whether a crash truncated a frame: its last 512-byte sectors are zeros or outside the file.

    ``length`` is the number of bytes of the segment without zeros at its end, ``size`` with them.
    """
    return frame.end > size or -(-length // _SECTOR_BYTES) * _SECTOR_BYTES < frame.end


def check_journal(folder: Path) -> CheckedJournal:
    """Read every frame of a data folder's journal and list its corruption; nothing is written.

    A frame that a crash truncated before it was acknowledged is not corrupt. Pages lost in the middle of a
    frame, as after a power cut, cannot be distinguished from corruption. The sets are sorted by key.

    Raises
    ------
    OSError
        A segment cannot be read.
    """
    checked = CheckedJournal()
    for number, content in read_segments(folder):
        checked.take(number, _name_segment(folder, number), content)
    filed = to_references(path.name for path in (folder / SETS_FOLDER).glob("set_*.h5"))
    misnamed = Damage(reason="it holds frames, but its name is no segment's")
    checked.damages += [(f"{JOURNAL_FOLDER}/{path.name}", misnamed) for path in list_misnamed(folder)]
    reported: set[int] = set()
    for set_key, journaled in checked.sets.items():
        if journaled.end is not None and set_key not in filed:
            # If several segments share a set, the segment of a lost frame is unknown.
            set_frames = [(name, frame) for name, frame in checked.unsound if frame.set_key == set_key]
            segment_of = {frame.sequence: name for name, frame in set_frames}
            for damage in journaled.damages():
                reported.add(damage.sequence or 0)
                segment = segment_of.get(damage.sequence or 0, _name_segment(folder, min(journaled.segments)))
                checked.damages.append((segment, damage))
    for name, frame in checked.unsound:
        journaled = checked.sets[frame.set_key]
        # Frames of a set with a file are not read any more; a failed write was repeated in another segment.
        if (
            frame.set_key not in filed
            and frame.sequence not in reported
            and frame.sequence not in journaled.shots
        ):
            shot = f"shot {frame.sequence}" if frame.sequence >= 0 else "a note"
            location = f"byte {frame.start}, {shot} of set {frame.set_key}"
            reason = f"the frame at {location}, does not match its checksum"
            checked.damages.append((name, Damage(reason=reason, sequence=max(frame.sequence, 0) or None)))
    suspects = {frame.set_key for _, frame in checked.unsound} | checked.suspects
    checked.suspects = {key for key in suspects if key not in filed and not checked.sets[key].is_whole}
    checked.sets = dict(sorted(checked.sets.items()))
    return checked


def _name_segment(folder: Path, number: int) -> str:
    """Format the path of a segment relative to the data folder, with slashes."""
    return build_segment_path(folder, number).relative_to(folder).as_posix()
