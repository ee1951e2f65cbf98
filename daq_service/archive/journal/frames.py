"""Frames of the journal: each can be found, checked and read on its own.

Little-endian: a header with its own CRC-32 (`HEADER`), facts as JSON, raw counts. A reader skips
bytes that are no frame up to the next header with a valid checksum.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import orjson

from hardware_drivers.measurement import (
    Calibration,
    MissedShot,
    PulseEchoRecord,
    SetKey,
    SetRecord,
    Shot,
    ShotKey,
    Stamp,
    Waveform,
    compute_crc32,
)

MAGIC = b"SOLJ"
VERSION = 1
HEADER = struct.Struct("<4sBBHIIqqqqII")
"""Magic, version, kind, bytes a count, bytes of facts, bytes of counts, `SetKey.number`, shot id (`sequence`;
-1: no shot), utc_ns, mono_ns, CRC-32 of facts and of the CRC-32 of the counts, CRC-32 of all that."""
_CRC = struct.Struct("<I")

Buffers = tuple[bytes, bytes | memoryview]
"""A frame as it is written: header with facts, and counts, which are not copied."""


class Kind(IntEnum):
    """Kind of a frame."""

    BEGIN = 1
    SHOT = 2
    ECHO = 3
    MISSED = 4
    END = 5
    ASIDE = 6
    """The earlier frames of this set are discarded."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """One frame as read from a segment.

    Attributes
    ----------
    start, end
        Byte range in its segment, according to its header.
    sound
        Facts and counts match their checksum; if not, only the header is valid.
    """

    start: int
    end: int

    kind: Kind
    set_key: SetKey
    sequence: int
    utc_ns: int
    mono_ns: int
    width: int
    facts: bytes
    counts: bytes
    sound: bool

    def parse_facts(self) -> dict[str, Any]:
        """Parse the facts of a sound frame, JSON, to a dictionary; ValueError if they are no JSON."""
        facts: dict[str, Any] = json.loads(self.facts)
        return facts


def build_begin_frame(
    set_key: SetKey, *, due_utc_ns: int, started_utc_ns: int, disabled: Mapping[str, str]
) -> Buffers:
    """Build the frame for the start of a set; ``disabled`` has the reason for each left-out position.

    Times are ns of UTC.
    """
    facts = {"due_utc_ns": due_utc_ns, "disabled": dict(disabled)}
    return _build_frame(Kind.BEGIN, set_key, facts, utc_ns=started_utc_ns)


def build_record_frame(record: Shot | PulseEchoRecord) -> Buffers:
    """Build the frame of a record with all that the file of its set needs.

    Little-endian counts are not copied: the frame refers to the array of the record.
    """
    waveform, calibration = record.waveform, record.waveform.calibration
    facts: dict[str, Any] = {
        "key": [record.key.position, record.key.shot_index, record.key.attempt],
        "boot_id": record.stamp.boot_id,
        "sample_rate_hz": waveform.sample_rate_hz,
        "pretrigger_samples": waveform.pretrigger_samples,
        "calibration": {
            "coefficients_v": calibration.coefficients_v.tolist(),
            "resolution_bits": calibration.resolution_bits,
            "range_v": calibration.range_v,
            "date": calibration.date,
        },
        "truth": dict(record.truth),
        "settings": dict(record.settings),
    }
    if isinstance(record, PulseEchoRecord):
        facts["receiver"] = {
            "gain_db": record.gain_db,
            "offset_v": record.offset_v,
            "averages": record.averages,
        }
    counts = waveform.counts
    return _build_frame(
        Kind.ECHO if isinstance(record, PulseEchoRecord) else Kind.SHOT,
        record.key.set_key,
        facts,
        sequence=record.sequence,
        utc_ns=record.stamp.utc_ns,
        mono_ns=record.stamp.mono_ns,
        counts=counts.astype(counts.dtype.newbyteorder("<"), copy=False).view(np.uint8).data,
        counts_crc32=compute_crc32(waveform),
        width=counts.dtype.itemsize,
    )


def build_missed_frame(missed: MissedShot, utc_ns: int) -> Buffers:
    """Build the frame of a strike or echo that left no record, with cause and reason; time in ns of UTC."""
    key = {"key": [missed.key.position, missed.key.shot_index, missed.key.attempt]}
    facts = {**key, "cause": missed.cause, "reason": missed.reason}
    return _build_frame(Kind.MISSED, missed.key.set_key, facts, utc_ns=utc_ns)


def build_end_frame(record: SetRecord) -> Buffers:
    """Build the frame for the end of a complete set: its data without the records, and their ids.

    Raises
    ------
    ValueError, TypeError
        JSON cannot hold the provenance, such as NaN.
    """
    json.dumps(record.provenance, allow_nan=False)
    facts = {
        "due_utc_ns": record.due_utc_ns,
        "due_h": record.due_h,
        "started_utc_ns": record.started_utc_ns,
        "rig_kind": record.rig_kind,
        "positions": [asdict(position) for position in record.positions],
        "missed": [
            {**asdict(item.key), "cause": item.cause, "reason": item.reason} for item in record.missed
        ],
        "outcomes": [
            [sequence, outcome] for sequence, outcome in record.outcomes.items() if outcome != "accepted"
        ],
        "trouble": record.trouble,
        "environment": {name: value for name, value in record.environment.items() if value is not None},
        "provenance": record.provenance,
        "records": [
            [item.sequence, item.key.position, item.key.shot_index, item.key.attempt]
            for item in record.records
        ],
    }
    return _build_frame(Kind.END, record.set_key, facts, utc_ns=record.ended_utc_ns)


def build_discard_frame(set_key: SetKey) -> Buffers:
    """Build the frame that makes readers discard all earlier frames of a set in the journal."""
    return _build_frame(Kind.ASIDE, set_key, {}, utc_ns=0)


def _build_frame(
    kind: Kind,
    set_key: SetKey,
    facts: Mapping[str, Any],
    *,
    utc_ns: int,
    mono_ns: int = 0,
    sequence: int = -1,
    counts: bytes | memoryview = b"",
    counts_crc32: int = 0,
    width: int = 0,
) -> Buffers:
    """Build a frame: header with checksums and ``facts`` as JSON, and the counts, which are not copied.

    ``width`` is the number of bytes per count. NaN and infinities of the facts are kept.
    """
    text = orjson.dumps(facts, option=orjson.OPT_SERIALIZE_NUMPY)
    if b"null" in text:
        # orjson writes NaN and infinities as null, json keeps them.
        text = json.dumps(facts).encode()
    lengths = (width, len(text), len(counts))
    body = _compute_body_crc32(text, counts_crc32)
    fields = (MAGIC, VERSION, kind, *lengths, set_key.number, sequence, utc_ns, mono_ns, body)
    head = HEADER.pack(*fields, 0)[: -_CRC.size]
    return head + _CRC.pack(zlib.crc32(head)) + text, counts


def _compute_body_crc32(facts: bytes, counts_crc32: int) -> int:
    # File and catalogue use the CRC-32 of the counts, too: it is computed once.
    """Compute the CRC-32 of the facts (JSON bytes), continued with the CRC-32 of the counts."""
    return zlib.crc32(_CRC.pack(counts_crc32), zlib.crc32(facts))


def parse_frames(content: bytes, *, of_set: SetKey | None = None) -> Iterator[Frame]:
    """Parse the frames of a segment in order, or only those of one set; skip bytes that are no frame.

    A frame whose header is valid but whose content is corrupt or truncated is yielded with ``sound`` False.
    """
    view, offset = memoryview(content), 0
    # Searching one byte is far faster than four in the zeros at the end of a segment.
    while (offset := content.find(MAGIC[:1], offset)) >= 0 and offset + HEADER.size <= len(content):
        magic, version, kind, width, n_facts, n_counts, set_number, sequence, utc_ns, mono_ns, body, crc32 = (
            HEADER.unpack_from(view, offset)
        )
        start = offset + HEADER.size
        end = start + n_facts + n_counts
        known = magic == MAGIC and version == VERSION
        if not known or zlib.crc32(view[offset : start - _CRC.size]) != crc32:
            offset += 1
            continue
        if of_set is not None and set_number != of_set.number:
            offset = end
            continue
        facts, counts = bytes(view[start : start + n_facts]), bytes(view[start + n_facts : end])
        sound = end <= len(content) and _compute_body_crc32(facts, zlib.crc32(counts)) == body
        yield Frame(
            start=offset,
            end=end,
            kind=Kind(kind),
            set_key=SetKey.from_number(set_number),
            sequence=sequence,
            utc_ns=utc_ns,
            mono_ns=mono_ns,
            width=width,
            facts=facts,
            counts=counts,
            sound=sound,
        )
        # The header's checksum covers the length of a corrupt frame, so later frames are still found.
        offset = end


def decode_record(frame: Frame) -> Shot | PulseEchoRecord:
    """Decode the record of a sound frame, bit for bit: a pulse echo from ``ECHO``, else a shot.

    Counts are a read-only view of the frame. Raises KeyError if the facts lack a value.
    """
    facts = frame.parse_facts()
    position, shot_index, attempt = facts["key"]
    calibration = facts["calibration"]
    common: dict[str, Any] = {
        "sequence": frame.sequence,
        "key": ShotKey.from_set(frame.set_key, position, shot_index, attempt),
        "stamp": Stamp(utc_ns=frame.utc_ns, mono_ns=frame.mono_ns, boot_id=facts["boot_id"]),
        "waveform": Waveform(
            counts=np.frombuffer(frame.counts, dtype=f"<i{frame.width}"),
            sample_rate_hz=facts["sample_rate_hz"],
            pretrigger_samples=facts["pretrigger_samples"],
            calibration=Calibration(
                **{**calibration, "coefficients_v": np.array(calibration["coefficients_v"])}
            ),
        ),
        "truth": facts["truth"],
        "settings": facts["settings"],
    }
    return PulseEchoRecord(**common, **facts["receiver"]) if frame.kind is Kind.ECHO else Shot(**common)


def decode_missed(frame: Frame) -> MissedShot:
    """Decode the missed strike or echo of a sound frame of kind ``MISSED``."""
    facts = frame.parse_facts()
    position, shot_index, attempt = facts["key"]
    key = ShotKey.from_set(frame.set_key, position, shot_index, attempt)
    return MissedShot(key=key, cause=facts["cause"], reason=facts["reason"])
