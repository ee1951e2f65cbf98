"""Read sets back, bit for bit; every record is checked against its CRC-32.

Only complete files have their final name, and they never change: any number of readers may open them
while the recorder runs.
"""

from __future__ import annotations

import errno
import hashlib
import json
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5a
from numpy.typing import NDArray

from daq_service.archive.errors import (
    BACK,
    ArchiveError,
    ArchiveReadError,
    CorruptArchiveError,
    SetNotFoundError,
)
from daq_service.archive.journal.frames import decode_record
from daq_service.archive.journal.reader import JournaledSet, read_journal
from daq_service.archive.layout import RESULTS
from daq_service.archive.nexus import open_image, read_field
from daq_service.archive.plain import RefusedError
from daq_service.archive.records import SETS_FOLDER, Damage, SetReference, SetTables, to_references
from daq_service.shared_file import read_shared
from hardware_drivers.measurement import (
    Calibration,
    MissedShot,
    PositionRecord,
    PulseEchoRecord,
    SetKey,
    SetRecord,
    Shot,
    ShotKey,
    Stamp,
    Waveform,
    compute_crc32,
)

# What h5py raises on damaged or foreign files, besides our own errors.
HDF5_ERRORS = (OSError, RuntimeError, KeyError, ValueError, TypeError, IndexError)
_TEMPORARY_ERRORS = {errno.EMFILE, errno.ENFILE, errno.ENOMEM}
"""Errors of the operating system that do not concern the file."""
_READABLE_FORMAT = "1."

_PLANNED = ("method", "n_planned", "cause", "label", "serial_number")

_Columns = Mapping[str, list[Any]]


class FolderSetReader:
    """Reader of the sets of a data folder or of its copy; never writes there.

    Parameters
    ----------
    folder
        Data folder that contains ``sets/``; without it there are no sets.
    """

    def __init__(self, folder: Path) -> None:
        """Store the data folder; read nothing yet."""
        self.folder, self.name = folder, str(folder)

    def sets(self) -> dict[SetKey, SetReference]:
        """Return the complete sets in journal and files: key to reference, in the order of the sets.

        A set counts as complete in the journal with its end frame. Raises ArchiveError if the journal is
        unreadable.
        """
        journaled = {key: item.reference for key, item in self._read_journal().items() if item.reference}
        return dict(sorted({**journaled, **self._list_files()}.items()))

    def n_bytes(self) -> int:
        """Return the size in bytes of all set files, and of the counts of complete sets without a file."""
        files = self._list_files()
        journaled = sum(
            item.n_bytes for item in self._read_journal().values() if item.end and item.set_key not in files
        )
        return journaled + sum((self.folder / file).stat().st_size for file in files.values())

    def read_set(self, reference: SetReference, *, skip_damaged: bool = False) -> SetRecord:
        """Read a set as it was stored, from its file or, without one, from the journal.

        Raises CorruptArchiveError if it is unreadable or has corrupt records, with ``skip_damaged`` only if
        no record is left, and SetNotFoundError if it is missing.
        """
        journaled = self._find_journaled(reference)
        if journaled is None:
            return read_set_file(self.folder / reference, skip_damaged=skip_damaged)
        damages = journaled.damages()
        if damages and not (skip_damaged and journaled.has_records):
            raise _create_corruption_error(self.folder / reference, damages)
        return journaled.record()

    def read_position_records(self, reference: SetReference, position: str) -> list[Shot | PulseEchoRecord]:
        """Read the intact records of one position in order of sequence.

        Those of a file come without truth and settings. Raises SetNotFoundError without such a set,
        CorruptArchiveError if its file is unreadable.
        """
        journaled = self._find_journaled(reference)
        if journaled is None:
            with open_set_file(self.folder / reference) as entry:
                return _read_records(entry, facts=False, position=position)[0]
        shots = [decode_record(frame) for _, frame in sorted(journaled.shots.items())]
        return [record for record in shots if record.key.position == position]

    def read_waveform(self, reference: SetReference, position: str, shot_index: int) -> Waveform:
        """Read the accepted record of a shot, else that of its last attempt, from its file or the journal.

        Raises SetNotFoundError if it is missing, CorruptArchiveError if it is corrupt.
        """
        journaled, path = self._find_journaled(reference), self.folder / reference
        if journaled is None:
            return _read_waveform(path, position, shot_index)
        sequence = journaled.find_sequence(position, shot_index)
        if sequence is None:
            raise SetNotFoundError(f"{path} has no shot {shot_index} of position {position!r}")
        if sequence not in journaled.shots:
            damages = [damage for damage in journaled.damages() if damage.sequence == sequence]
            raise _create_corruption_error(path, damages)
        return decode_record(journaled.shots[sequence]).waveform

    def read_tables(self, reference: SetReference, sha256: str) -> SetTables | None:
        """Read the tables of shots and results of a set's file as rows, without its waveforms.

        Returns None if the file does not have this SHA-256 or cannot be read. Raises CorruptArchiveError if a
        table is invalid.
        """
        try:
            content = read_regular_file(self.folder / reference)
        except OSError:
            return None  # a reader of the complete set names the reason
        if hashlib.sha256(content).hexdigest() != sha256:
            return None
        # The recorder made the bytes that have this checksum: nothing in them leads elsewhere.
        with open_set_file(self.folder / reference, content, is_own=True) as entry:
            return SetTables(
                set_key=read_set_key(entry),
                shots=_to_rows(_read_shot_table(entry)),
                results={
                    name: _to_rows(_read_columns(entry[name], *entry[name]))
                    for name in RESULTS
                    if name in entry
                },
            )

    def digest(self, reference: SetReference) -> str | None:
        """Compute the SHA-256 of a set's file in hexadecimal; None if it has no file.

        Raises ArchiveError if the file cannot be read.
        """
        try:
            return hashlib.sha256(read_regular_file(self.folder / reference)).hexdigest()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise ArchiveError(f"{self.folder / reference} cannot be read: {error}") from error

    def verify_set(self, reference: SetReference) -> list[Damage]:
        """Read a complete set and list its corrupt records and other corrupt parts; empty if it is sound.

        Raises CorruptArchiveError if it cannot be read at all, SetNotFoundError if it is missing.
        """
        journaled = self._find_journaled(reference)
        if journaled is not None:
            return journaled.damages()
        with open_set_file(self.folder / reference) as entry:
            return _read_records(entry)[1] + _list_unreadable(entry)

    def _list_files(self) -> dict[SetKey, SetReference]:
        """List the references of the set files in the folder by key, in order; ignore other file names."""
        return to_references(path.name for path in (self.folder / SETS_FOLDER).glob("set_*.h5"))

    def _read_journal(self) -> dict[SetKey, JournaledSet]:
        """Read all journaled sets by key, in order; raise `ArchiveError` if a segment cannot be read."""
        try:
            return read_journal(self.folder)
        except OSError as error:
            raise ArchiveError(f"the journal of {self.folder} cannot be read: {error}") from error

    def _find_journaled(self, reference: SetReference) -> JournaledSet | None:
        """Find a set in the journal by its reference; None if it has a file, or if the journal lacks it.

        Raises ArchiveError if the journal cannot be read.
        """
        if (self.folder / reference).exists():
            return None
        # It may get its file meanwhile: then the journal does not have it any more, and the file is read.
        matches = (item for item in self._read_journal().values() if item.reference == reference)
        return next(matches, None)


def read_set_file(path: Path, *, skip_damaged: bool = False) -> SetRecord:
    """Read a set with its records and metadata from its file.

    Raises CorruptArchiveError if it is unreadable or has corrupt records, with ``skip_damaged`` only if no
    record is left, and SetNotFoundError if there is no file.
    """
    with open_set_file(path) as entry:
        records, damages = _read_records(entry)
        if damages and not (skip_damaged and records):
            raise _create_corruption_error(path, damages)
        return _build_record(entry, records)


def read_records(path: Path, content: bytes, *, is_own: bool = False) -> list[Shot | PulseEchoRecord]:
    """Read the records of a set file in memory in order, without simulated truth and settings.

    Parameters
    ----------
    path
        Name of the file, for messages.
    is_own
        This process made the content, so it cannot contain links to other files.

    Raises
    ------
    CorruptArchiveError
        A record is damaged, or the set as a whole.
    """
    with open_set_file(path, content, is_own=is_own) as entry:
        records, damages = _read_records(entry, facts=False)
        if damages:
            raise _create_corruption_error(path, damages)
        return records


def examine_file(path: Path, content: bytes) -> tuple[SetRecord | None, list[Damage]]:
    """Read every record and all metadata of a set file in memory; list also its corrupt records.

    ``path`` names the file in messages.

    Returns
    -------
    tuple
        The readable part of the set, None without a readable record or metadata, and the damaged records.

    Raises
    ------
    CorruptArchiveError
        It cannot be read as a whole.
    """
    with open_set_file(path, content) as entry:
        records, damages = _read_records(entry)
        try:
            return (_build_record(entry, records) if records else None), damages
        except HDF5_ERRORS:
            if damages:
                return None, damages
            raise


def list_unreadable_parts(path: Path, content: bytes) -> list[Damage]:
    """List the parts of a set file in memory, other than records, that cannot be read; empty if none.

    Raises
    ------
    CorruptArchiveError
        It cannot be read as a whole.
    """
    with open_set_file(path, content) as entry:
        return _list_unreadable(entry)


def _build_record(entry: h5py.Group, records: Sequence[Shot | PulseEchoRecord]) -> SetRecord:
    """Read the metadata of a set and combine it with its records to a `SetRecord`.

    Raises one of `HDF5_ERRORS` if they are unreadable.
    """
    set_index, unscheduled_index = read_set_key(entry)
    return SetRecord(
        set_index=set_index,
        unscheduled_index=unscheduled_index,
        due_utc_ns=int(read_field(entry.id, "due_utc_ns")),
        due_h=float(read_field(entry.id, "due_h")),
        started_utc_ns=int(read_field(entry.id, "started_utc_ns")),
        ended_utc_ns=int(read_field(entry.id, "ended_utc_ns")),
        rig_kind=_decode_text(read_field(entry.id, "instrument/name")[()]),
        positions=_read_positions(entry),
        shots=[record for record in records if isinstance(record, Shot)],
        echoes=[record for record in records if isinstance(record, PulseEchoRecord)],
        missed=_read_missed(entry),
        outcomes=_read_outcomes(_read_shot_table(entry), records),
        trouble=_decode_text(entry["trouble"][()]) if "trouble" in entry else "",
        environment=_read_environment(entry),
        provenance=json.loads(_decode_text(entry["provenance/data"][0])),
        results={name: _read_columns(entry[name], *entry[name]) for name in RESULTS if name in entry},
    )


def _create_corruption_error(path: Path, damages: Sequence[Damage]) -> CorruptArchiveError:
    """Create, but do not raise, the error that lists all corrupt records of a file, with the remedy."""
    error = CorruptArchiveError(f"{path}: {'; '.join(map(str, damages))}; {BACK}")
    error.add_note("read_set(..., skip_damaged=True) reads its other records")
    return error


def _read_waveform(path: Path, position: str, shot_index: int) -> Waveform:
    """Read the accepted record of a shot from a set's file, else that of its last attempt.

    Raises SetNotFoundError if file or record is missing, CorruptArchiveError if corrupt.
    """
    with open_set_file(path) as entry:
        table = _read_shot_table(entry)
        rows = [
            row
            for row, name in enumerate(table["position"])
            if name == position and table["shot_index"][row] == shot_index
        ]
        if not rows:
            raise SetNotFoundError(f"{path} has no shot {shot_index} of position {position!r}")
        row = max(rows, key=lambda row: (table["outcome"][row] == "accepted", table["attempt"][row]))
        for name in list_record_groups(entry):
            if _decode_text(entry[name].attrs["position"]) != position:
                continue
            group = RecordGroup(entry, name)
            if table["shot_id"][row] in group.sequences:
                waveform = group.waveform(group.sequences.index(table["shot_id"][row]), table["crc32"][row])
                if isinstance(waveform, Waveform):
                    return waveform
                raise CorruptArchiveError(f"{path}: {_build_damage(table, row, waveform)}")
        raise CorruptArchiveError(f"{path}: {_build_damage(table, row, 'no array holds it')}")


def _list_unreadable(entry: h5py.Group) -> list[Damage]:
    """List the parts of a set's file, other than records, that cannot be read; empty if there are none.

    Reads every table and attribute; errors are not raised.
    """
    unreadable: list[Damage] = []
    arrays = {f"{name}/{signal}" for name in list_record_groups(entry) for signal in ("waveform", "record")}
    _collect_unreadable(entry, "", arrays, unreadable)
    try:
        # Visits the free-space lists of the groups' names, too, which no other access reads.
        entry.visititems(lambda _name, _item: None)
    except HDF5_ERRORS as error:
        unreadable.append(Damage(reason=f"the structure of the file is damaged ({error})"))
    return unreadable


class RecordGroup:
    """One NXdata of records with its detector."""

    def __init__(self, entry: h5py.Group, name: str) -> None:
        """Read position, ids, sampling and calibration of the group ``name``; KeyError if it is missing."""
        self.data = entry[name]
        self.position = _decode_text(self.data.attrs["position"])
        self.signal = self.data[_decode_text(self.data.attrs["signal"])]
        self.sequences: list[int] = read_field(self.data.id, "shot_id").tolist()
        detector = entry["instrument"][name].id
        self.sample_rate_hz = float(read_field(detector, "sample_rate"))
        self.pretrigger_samples = int(read_field(detector, "pretrigger_samples"))
        self.calibration = Calibration(
            coefficients_v=read_field(detector, "calibration_coefficients"),
            resolution_bits=int(read_field(detector, "resolution_bits")),
            range_v=float(read_field(detector, "input_range")),
            date=_decode_text(read_field(detector, "calibration_date")[()]),
        )

    def read_all_counts(self) -> NDArray[Any] | None:
        """Read the counts of all records, shape (n_records, n_samples); None if one is unreadable."""
        try:
            counts: NDArray[Any] = self.signal[()]
        except HDF5_ERRORS:
            return None  # `waveform` finds which ones
        return counts

    def waveform(self, row: int, crc32: int, all_counts: NDArray[Any] | None = None) -> Waveform | str:
        """Read the record of a row, or return why it is unreadable or does not match ``crc32`` of its counts.

        ``all_counts``, shape (n_records, n_samples), replaces the access to the file.
        """
        try:
            counts = self.signal[row] if all_counts is None else all_counts[row]
        except HDF5_ERRORS as error:
            return f"unreadable ({error})"
        waveform = Waveform(
            counts=counts.astype(counts.dtype.newbyteorder("="), copy=False),
            sample_rate_hz=self.sample_rate_hz,
            pretrigger_samples=self.pretrigger_samples,
            calibration=self.calibration,
        )
        crc32_read = compute_crc32(waveform)
        return waveform if crc32_read == crc32 else f"CRC-32 is {crc32_read:08x}, stored as {crc32:08x}"

    def read_echo_settings(self, row: int) -> dict[str, Any]:
        """Read gain in dB, offset in V and number of averages of a row's pulse-echo record, by name."""
        return {
            "gain_db": float(self.data["gain"][row]),
            "offset_v": float(self.data["offset"][row]),
            "averages": int(self.data["averages"][row]),
        }


def _read_records(
    entry: h5py.Group, *, facts: bool = True, position: str | None = None
) -> tuple[list[Shot | PulseEchoRecord], list[Damage]]:
    """Read the intact records of one position (None: all) in the order of the table; list the corrupt ones.

    ``facts`` False leaves out truth and settings. Raises one of `HDF5_ERRORS` if the tables are unreadable.
    """
    table = _read_shot_table(entry)
    set_key = read_set_key(entry)
    truths = _read_facts(entry, "truth") if facts else {}
    settings = _read_facts(entry, "settings") if facts else {}
    row_of = {
        sequence: row
        for row, sequence in enumerate(table["shot_id"])
        if position in (None, table["position"][row])
    }
    reasons = dict.fromkeys(row_of, "no readable array holds it")
    record_of_sequence: dict[int, Shot | PulseEchoRecord] = {}
    for name in list_record_groups(entry):
        try:
            if position not in (None, _decode_text(entry[name].attrs["position"])):
                continue
            group = RecordGroup(entry, name)
        except HDF5_ERRORS as error:
            reasons = {sequence: f"{text} ({name}: {error})" for sequence, text in reasons.items()}
            continue
        is_echo, all_counts = "gain" in group.data, group.read_all_counts()
        for row, sequence in enumerate(group.sequences):
            waveform = group.waveform(row, table["crc32"][row_of[sequence]], all_counts)
            if isinstance(waveform, str):
                reasons[sequence] = waveform
                continue
            common: dict[str, Any] = {
                "sequence": sequence,
                "key": _build_shot_key(table, row_of[sequence], set_key),
                "stamp": _build_stamp(table, row_of[sequence]),
                "waveform": waveform,
                "truth": truths.get(sequence, {}),
                "settings": settings.get(sequence, {}),
            }
            record_of_sequence[sequence] = (
                PulseEchoRecord(**common, **group.read_echo_settings(row)) if is_echo else Shot(**common)
            )
    damages = [
        _build_damage(table, row, reasons[sequence])
        for sequence, row in row_of.items()
        if sequence not in record_of_sequence
    ]
    return [record_of_sequence[sequence] for sequence in row_of if sequence in record_of_sequence], damages


def _read_columns(table: h5py.Group, *names: str) -> _Columns:
    """Read the named columns of a table as lists of Python values; text is decoded.

    Raises KeyError if a column is missing.
    """
    columns = {name: read_field(table.id, name).tolist() for name in names}
    return {
        name: [_decode_text(value) if isinstance(value, bytes) else value for value in values]
        for name, values in columns.items()
    }


def _to_rows(columns: _Columns) -> list[dict[str, Any]]:
    """Convert columns to rows, one dictionary per row; ValueError if their lengths differ."""
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _read_shot_table(entry: h5py.Group) -> _Columns:
    """Read the columns of the table of shots by name; in format 1.0 every outcome is "accepted"."""
    table = entry["shots"]
    names = ("shot_id", "position", "shot_index", "attempt", "utc_ns", "mono_ns", "boot_id", "crc32")
    if "outcome" in table:
        return _read_columns(table, *names, "outcome")
    # Format 1.0 has no repeated shots: every record counts.
    return {**_read_columns(table, *names), "outcome": ["accepted"] * table["shot_id"].size}


def _read_outcomes(table: _Columns, records: Sequence[Shot | PulseEchoRecord]) -> dict[int, str]:
    """Return the outcomes of the given records that are not "accepted", by sequence."""
    outcomes = dict(zip(table["shot_id"], table["outcome"], strict=True))
    return {
        record.sequence: outcomes[record.sequence]
        for record in records
        if outcomes[record.sequence] != "accepted"
    }


def read_set_key(entry: h5py.Group) -> SetKey:
    """Read the key of a set from its ``entry``; up to format 1.5 it is one number."""
    key = SetKey.from_number(int(read_field(entry.id, "set_index")))
    if "unscheduled_index" not in entry:
        return key
    return key._replace(unscheduled_index=int(read_field(entry.id, "unscheduled_index")))


def _build_shot_key(table: _Columns, row: int, set_key: SetKey) -> ShotKey:
    """Build the shot key of a row of the table of shots or missed records."""
    return ShotKey.from_set(set_key, table["position"][row], table["shot_index"][row], table["attempt"][row])


def _build_stamp(table: _Columns, row: int) -> Stamp:
    """Build the time stamp (UTC and monotonic ns, boot) of a row of the table of shots."""
    return Stamp(utc_ns=table["utc_ns"][row], mono_ns=table["mono_ns"][row], boot_id=table["boot_id"][row])


def _build_damage(table: _Columns, row: int, reason: str) -> Damage:
    """Build the damage (id, position, shot, reason) for the corrupt record of a row of the table of shots."""
    return Damage(
        sequence=table["shot_id"][row],
        position=table["position"][row],
        shot_index=table["shot_index"][row],
        reason=reason,
    )


def _read_facts(entry: h5py.Group, kind: str) -> dict[int, dict[str, Any]]:
    """Read the facts (``kind`` "truth" or "settings") of each record, by sequence.

    Records without any are omitted.
    """
    facts: dict[int, dict[str, Any]] = {}
    for group_name in entry:
        # Up to format 1.6 each position has a group of its own.
        if group_name != kind and not group_name.endswith(f"_{kind}"):
            continue
        group = entry[group_name]
        sequences = read_field(group.id, "shot_id").tolist()
        for name in group:
            if name == "shot_id":
                continue
            has_mask = h5a.exists(group.id, b"known", obj_name=name.encode())
            known = group[name].attrs["known"] if has_mask else np.ones(len(sequences))
            values = read_field(group.id, name).tolist()
            for sequence, value, is_known in zip(sequences, values, known, strict=True):
                if is_known:
                    fact = _decode_text(value) if isinstance(value, bytes) else value
                    facts.setdefault(sequence, {})[name] = fact
    return facts


def _read_missed(entry: h5py.Group) -> list[MissedShot]:
    """Read the strikes and echoes without a record, in order; empty if the file has none."""
    if "missed" not in entry:
        return []
    columns = _read_columns(entry["missed"], "position", "shot_index", "attempt", "cause", "reason")
    set_key = read_set_key(entry)
    return [
        MissedShot(key=_build_shot_key(columns, row, set_key), cause=cause, reason=columns["reason"][row])
        for row, cause in enumerate(columns["cause"])
    ]


def _read_environment(entry: h5py.Group) -> dict[str, float | str | None]:
    """Read the supply and climate values of the set, number or text by name; empty if the file has none."""
    if "environment" not in entry:
        return {}
    group = entry["environment"]
    values = {name: read_field(group.id, name)[()] for name in group}
    return {
        name: _decode_text(value) if isinstance(value, bytes) else float(value)
        for name, value in values.items()
    }


def _read_positions(entry: h5py.Group) -> list[PositionRecord]:
    """Read method, planned number, cause, label and serial number of each position, in order."""
    columns = _read_columns(entry["positions"], "name", *_PLANNED)
    return [
        PositionRecord(position=position, **{name: columns[name][row] for name in _PLANNED})
        for row, position in enumerate(columns["name"])
    ]


def list_record_groups(entry: h5py.Group) -> list[str]:
    """List the names of the NXdata groups that hold records, which are those with a detector."""
    return [name for name in entry["instrument"] if name != "name"]


def _collect_unreadable(group: h5py.Group, parent: str, left_out: set[str], unreadable: list[Damage]) -> None:
    """Read all values and attributes below a group recursively; append a damage for each unreadable one.

    ``parent`` is the group's path; values at the paths in ``left_out`` are not read.
    """
    for name in group:
        path = f"{parent}{name}"
        try:
            item = group[name]
            dict(item.attrs)
            if hasattr(item, "shape"):
                if path not in left_out:
                    item[()]
                continue
        except HDF5_ERRORS as error:
            unreadable.append(Damage(reason=f"{path} is unreadable ({error})"))
            continue
        _collect_unreadable(item, f"{path}/", left_out, unreadable)


def read_regular_file(path: Path) -> bytes:
    """Read a complete file of a data folder, which may come from an unknown source.

    Raises
    ------
    RefusedError
        It is a link, a pipe or a device.
    OSError
        It cannot be read.
    """
    if not stat.S_ISREG(path.lstat().st_mode):
        raise RefusedError("it is a link, a pipe or a device; put the file itself there")
    return read_shared(path)


@contextmanager
def open_set_file(path: Path, content: bytes | None = None, *, is_own: bool = False) -> Iterator[h5py.Group]:
    """Open the group ``entry`` of a set's file, or of its content in memory, until the block ends.

    Unless ``is_own``, the content is checked for links to other files before.

    Raises
    ------
    SetNotFoundError
        There is no such file.
    ArchiveReadError
        The system refuses the access at present.
    CorruptArchiveError
        It is damaged, has another format, or contains what no set has; also for errors inside the block.
    """
    try:
        image = read_regular_file(path) if content is None else content
        with h5py.File(open_image(image, is_own=is_own)) as file:
            version = _decode_text(file.attrs.get("solimon_format_version", ""))
            if not version.startswith(_READABLE_FORMAT):
                raise CorruptArchiveError(
                    f"{path} has format {version or 'unknown'}, this version reads {_READABLE_FORMAT}x; "
                    "a newer version may read it"
                )
            yield file["entry"]
    except FileNotFoundError as error:
        raise SetNotFoundError(f"there is no file {path}") from error
    except PermissionError as error:
        raise ArchiveReadError(
            f"{path} cannot be read: {error}; give this user the right to read it"
        ) from error
    except RefusedError as error:
        raise CorruptArchiveError(f"{path} is refused: {error}") from error
    except HDF5_ERRORS as error:
        if isinstance(error, OSError) and error.errno in _TEMPORARY_ERRORS:
            raise ArchiveReadError(f"{path} cannot be read now: {error}; end other programs") from error
        raise CorruptArchiveError(f"{path} is damaged: {error}; {BACK}") from error


def _decode_text(value: object) -> str:
    """Decode UTF-8 bytes of HDF5 to text; convert other values with `str`. UnicodeDecodeError if invalid."""
    return value.decode() if isinstance(value, bytes) else str(value)
