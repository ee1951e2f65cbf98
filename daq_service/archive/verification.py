"""Look at every byte of the archive that carries meaning: files of sets, frames of the journal.

Nothing is written, and nothing that a recorder does meanwhile counts as damage.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from daq_service.archive.errors import CorruptArchiveError, SetNotFoundError
from daq_service.archive.journal.frames import HEADER, Frame, frames
from daq_service.archive.journal.reader import JournaledSet, contents, segment_path
from daq_service.archive.layout import build_image
from daq_service.archive.nexus import opened_image
from daq_service.archive.reader import HDF5_ERRORS, examine, read_stored, unreadable_parts
from daq_service.archive.records import Damage, SetRecord, referenced_sets

log = logging.getLogger(__name__)

_PAGE_BYTES = 4096
_PREVIEW_TOLERANCE = 1e-6
"""Of the largest value: a mean in another order of summation, as 32-bit floats."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CheckedFile:
    """A set's file as it was found.

    Attributes
    ----------
    record
        What can be read of it; None: nothing.
    damages
        What cannot, or contradicts itself.
    touched
        Its SHA-256 is not the one that is known of it.
    sha256
        What it is; empty where the file cannot be read.
    """

    n_bytes: int
    record: SetRecord | None
    damages: list[Damage]
    touched: bool = False
    sha256: str = ""


def check_file(path: Path, *, sha256: str | None = None) -> CheckedFile:
    """Read a set's file to the last byte.

    Parameters
    ----------
    sha256
        Of the file as it was written, in hexadecimal. None: it is not known; then the file is made anew from
        its own records and compared, so that what it says twice (axes, factors, previews) must agree.

    Raises
    ------
    SetNotFoundError
        There is no such file.
    """
    try:
        content = read_stored(path)
    except FileNotFoundError as error:
        raise SetNotFoundError(f"there is no file {path}") from error
    except OSError as error:
        return CheckedFile(
            n_bytes=0, record=None, damages=[Damage(reason=f"it cannot be read ({error.strerror or error})")]
        )
    found = hashlib.sha256(content).hexdigest()
    touched = sha256 is not None and found != sha256
    try:
        record, damages = examine(path, content)
        made = None if record is None or damages or sha256 is not None else _made(record)
        # Else every byte is the one that was written, or that these records make.
        if damages or touched or (sha256 is None and made != content):
            damages += unreadable_parts(path, content)
            if not damages and not touched:
                damages = [Damage(reason=told) for told in _contradictions(content, made)]
    except CorruptArchiveError as error:
        record, damages = None, [Damage(reason=str(error.__cause__ or error))]
    return CheckedFile(n_bytes=len(content), record=record, damages=damages, touched=touched, sha256=found)


def _made(record: SetRecord) -> bytes | None:
    """Make the file anew; None: of what was read no file can be made."""
    try:
        return build_image(record)
    except Exception as error:  # noqa: BLE001 - a damaged name or length can break any step of it
        log.debug("no file can be made of what was read: %s", error)
        return None


def damage_of(path: Path, sha256: str | None = None) -> tuple[str, str]:
    """Say what is damaged in a set's file, empty: nothing, and its SHA-256; see `check_file`."""
    found = check_file(path, sha256=sha256)
    told = [str(damage) for damage in found.damages]
    touched = ["its SHA-256 is not that of the file that was written"] if found.touched else []
    return "; ".join([*touched, *told]), found.sha256


def _contradictions(content: bytes, made: bytes | None) -> list[str]:
    """Compare a file, value by value, with the one that its own records make.

    Another version of a library packs the same values into other bytes; then flips in bytes that hold
    nothing pass unseen.
    """
    if made is None:
        return ["what can be read of it makes no set"]
    try:
        with (
            h5py.File(opened_image(content)) as found,
            h5py.File(opened_image(made, is_own=True)) as expected,
        ):
            values, wanted = _values(found), _values(expected)
            same_format = found.attrs["solimon_format_version"] == expected.attrs["solimon_format_version"]
    except HDF5_ERRORS as error:
        return [f"the structure of the file is damaged ({error})"]
    return [
        f"{name} is not what the rest of the file says"
        for name in sorted({*values, *wanted} if same_format else values)
        if not _alike(name, values, wanted, same_format=same_format)
    ]


def _values(file: h5py.File) -> dict[str, Any]:
    """Every array and attribute by its path, the version of the format left out."""
    found: dict[str, Any] = {}

    def add(name: str, item: Any) -> None:
        # An axis tells in REFERENCE_LIST which arrays it belongs to: what their DIMENSION_LIST says already.
        attributes = {key: value for key, value in item.attrs.items() if key != "REFERENCE_LIST"}
        found.update({f"{name}@{key}": _plain(file, value) for key, value in attributes.items()})
        found[name] = _plain(file, item[()]) if isinstance(item, h5py.Dataset) else None

    add("", file)
    file.visititems(add)
    found.pop("@solimon_format_version", None)
    return found


def _plain(file: h5py.File, value: Any) -> Any:
    """Text however it is stored, a reference as the name of what it leads to, numbers as an array."""
    if isinstance(value, h5py.Reference):
        return file[value].name
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    if isinstance(value, np.ndarray) and value.dtype.kind in "SO":
        return [_plain(file, part) for part in value.flat]
    return value if isinstance(value, str) else np.asarray(value)


def _alike(name: str, found: Mapping[str, Any], expected: Mapping[str, Any], *, same_format: bool) -> bool:
    if not same_format and "@" in name and (name not in expected or str(found.get(name)) == ""):
        return True  # a label that is not written any more, or was left empty
    if name not in found or name not in expected:
        return False
    left, right = found[name], expected[name]
    if not (isinstance(left, np.ndarray) and isinstance(right, np.ndarray)):
        return type(left) is type(right) and bool(left == right)
    if "/preview/" in name and "@" not in name and left.shape == right.shape and left.dtype == right.dtype:
        scale = float(np.max(np.abs(right), initial=0.0))
        return bool(np.all(np.abs(left - right) <= _PREVIEW_TOLERANCE * scale))
    return (left.dtype, left.shape, left.tobytes()) == (right.dtype, right.shape, right.tobytes())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CheckedJournal:
    """The journal as it was found.

    Attributes
    ----------
    sets
        What it holds, by set index.
    damages
        Segment, relative to the data folder, and what of it is damaged.
    """

    sets: Mapping[int, JournaledSet]
    damages: list[tuple[str, Damage]]
    n_frames: int = 0
    n_bytes: int = 0


@dataclass(slots=True, eq=False)
class _Scan:
    """Frames that were found in all segments, and bytes between them that are none."""

    sets: dict[int, JournaledSet] = field(default_factory=dict)
    unsound: list[tuple[str, Frame]] = field(default_factory=list)
    odd: list[tuple[str, Damage]] = field(default_factory=list)
    n_frames: int = 0
    n_bytes: int = 0

    def take(self, number: int, name: str, content: bytes) -> None:
        """Add a segment: frames, each directly behind the one before, then zeros to its end."""
        place, length = 0, len(content.rstrip(b"\0"))
        for frame in frames(content):
            if frame.start > place:
                self._tell(name, place, frame.start)
            if not frame.sound and not _is_torn(frame, length, len(content)):
                self.unsound.append((name, frame))
            self.sets.setdefault(frame.set_index, JournaledSet(set_index=frame.set_index)).take(frame, number)
            self.n_frames += 1
            place = frame.end
        # A header alone that is cut was never acknowledged; behind a whole one there are facts.
        if length - place >= HEADER.size:
            self._tell(name, place, length)
        self.n_bytes += max(place, length)

    def _tell(self, name: str, start: int, end: int) -> None:
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
    filed = referenced_sets(path.name for path in (folder / "sets").glob("set_*.h5"))
    damages = list(scan.odd)
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
    return CheckedJournal(sets=scan.sets, damages=damages, n_frames=scan.n_frames, n_bytes=scan.n_bytes)


def _name(folder: Path, number: int) -> str:
    return segment_path(folder, number).relative_to(folder).as_posix()
