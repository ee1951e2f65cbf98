"""Frames of the journal: each can be found, checked and read without any other.

Little-endian: a header with its own CRC-32 (`HEADER`), facts as JSON, raw counts. A reader that meets bytes
that are no frame goes on at the next header whose checksum holds.
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

from daq_service.archive.records import MissedRecord, SetRecord, waveform_crc32
from hardware_drivers.measurement import Calibration, PulseEchoRecord, Shot, ShotKey, Stamp, Waveform

MAGIC = b"SOLJ"
VERSION = 1
HEADER = struct.Struct("<4sBBHIIqqqqII")
"""Magic, version, kind, bytes a count, bytes of facts, bytes of counts, set index, shot id (`Shot.sequence`;
-1: no shot), utc_ns, mono_ns, CRC-32 of facts and of the CRC-32 of the counts, CRC-32 of all that."""
_CRC = struct.Struct("<I")

Buffers = tuple[bytes, bytes | memoryview]
"""A frame as it is written: header with facts, and counts, which are not copied."""


class Kind(IntEnum):
    """What a frame tells."""

    BEGIN = 1
    SHOT = 2
    ECHO = 3
    MISSED = 4
    END = 5
    ASIDE = 6
    """What came before of this set was set aside."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """One frame as it was found.

    Attributes
    ----------
    start, end
        Where it lies in its segment, by what its header says.
    sound
        Facts and counts match their checksum; of a frame that is not only the header is known.
    """

    start: int
    end: int

    kind: Kind
    set_index: int
    sequence: int
    utc_ns: int
    mono_ns: int
    width: int
    facts: bytes
    counts: bytes
    sound: bool

    def told(self) -> dict[str, Any]:
        """Facts as an object."""
        found: dict[str, Any] = json.loads(self.facts)
        return found


def begin_frame(
    set_index: int, *, due_utc_ns: int, started_utc_ns: int, retired: Mapping[str, str]
) -> Buffers:
    """Tell that a set is begun, and what its end cannot tell if it never comes."""
    facts = {"due_utc_ns": due_utc_ns, "retired": dict(retired)}
    return _frame(Kind.BEGIN, set_index, facts, utc_ns=started_utc_ns)


def record_frame(record: Shot | PulseEchoRecord) -> Buffers:
    """Tell a record with everything that its file will hold of it."""
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
    return _frame(
        Kind.ECHO if isinstance(record, PulseEchoRecord) else Kind.SHOT,
        record.key.set_index,
        facts,
        sequence=record.sequence,
        utc_ns=record.stamp.utc_ns,
        mono_ns=record.stamp.mono_ns,
        counts=counts.astype(counts.dtype.newbyteorder("<"), copy=False).view(np.uint8).data,
        counts_crc32=waveform_crc32(waveform),
        width=counts.dtype.itemsize,
    )


def missed_frame(missed: MissedRecord, utc_ns: int) -> Buffers:
    """Tell what was tried and left no record."""
    facts = {"key": [missed.key.position, missed.key.shot_index, missed.key.attempt]}
    told = {**facts, "cause": missed.cause, "reason": missed.reason}
    return _frame(Kind.MISSED, missed.key.set_index, told, utc_ns=utc_ns)


def end_frame(record: SetRecord) -> Buffers:
    """Tell everything of a whole set but its records, and which these are.

    Raises
    ------
    ValueError
        JSON cannot hold the provenance.
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
        "outcomes": [[sequence, told] for sequence, told in record.outcomes.items() if told != "accepted"],
        "trouble": record.trouble,
        "environment": {name: told for name, told in record.environment.items() if told is not None},
        "provenance": record.provenance,
        "records": [
            [item.sequence, item.key.position, item.key.shot_index, item.key.attempt]
            for item in record.records
        ],
    }
    return _frame(Kind.END, record.set_index, facts, utc_ns=record.ended_utc_ns)


def aside_frame(set_index: int) -> Buffers:
    """Tell that what came before of a set was set aside."""
    return _frame(Kind.ASIDE, set_index, {}, utc_ns=0)


def _frame(
    kind: Kind,
    set_index: int,
    facts: Mapping[str, Any],
    *,
    utc_ns: int,
    mono_ns: int = 0,
    sequence: int = -1,
    counts: bytes | memoryview = b"",
    counts_crc32: int = 0,
    width: int = 0,
) -> Buffers:
    text = orjson.dumps(facts, option=orjson.OPT_SERIALIZE_NUMPY)
    if b"null" in text:
        # What is no finite number: orjson makes null of it, json keeps it.
        text = json.dumps(facts).encode()
    lengths = (width, len(text), len(counts))
    body = _body_crc32(text, counts_crc32)
    fields = (MAGIC, VERSION, kind, *lengths, set_index, sequence, utc_ns, mono_ns, body)
    head = HEADER.pack(*fields, 0)[: -_CRC.size]
    return head + _CRC.pack(zlib.crc32(head)) + text, counts


def _body_crc32(facts: bytes, counts_crc32: int) -> int:
    # Of the counts alone the file and the catalogue ask too: it is computed once.
    return zlib.crc32(_CRC.pack(counts_crc32), zlib.crc32(facts))


def frames(content: bytes, *, of_set: int | None = None) -> Iterator[Frame]:
    """Every frame of a segment, or those of a set; bytes between them that are none are passed over."""
    whole, place = memoryview(content), 0
    # One byte is found far sooner than four behind the zeros that a segment ends with.
    while (place := content.find(MAGIC[:1], place)) >= 0 and place + HEADER.size <= len(content):
        magic, version, kind, width, n_facts, n_counts, set_index, sequence, utc_ns, mono_ns, body, crc32 = (
            HEADER.unpack_from(whole, place)
        )
        start = place + HEADER.size
        end = start + n_facts + n_counts
        known = magic == MAGIC and version == VERSION
        if not known or zlib.crc32(whole[place : start - _CRC.size]) != crc32:
            place += 1
            continue
        if of_set is not None and set_index != of_set:
            place = end
            continue
        facts, counts = bytes(whole[start : start + n_facts]), bytes(whole[start + n_facts : end])
        sound = end <= len(content) and _body_crc32(facts, zlib.crc32(counts)) == body
        yield Frame(
            start=place,
            end=end,
            kind=Kind(kind),
            set_index=set_index,
            sequence=sequence,
            utc_ns=utc_ns,
            mono_ns=mono_ns,
            width=width,
            facts=facts,
            counts=counts,
            sound=sound,
        )
        # The length of a damaged frame is covered by its header's checksum: what follows is still found.
        place = end


def record_of(frame: Frame) -> Shot | PulseEchoRecord:
    """Return the record of a sound frame, bit for bit."""
    told = frame.told()
    position, shot_index, attempt = told["key"]
    calibration = told["calibration"]
    common: dict[str, Any] = {
        "sequence": frame.sequence,
        "key": ShotKey(position=position, set_index=frame.set_index, shot_index=shot_index, attempt=attempt),
        "stamp": Stamp(utc_ns=frame.utc_ns, mono_ns=frame.mono_ns, boot_id=told["boot_id"]),
        "waveform": Waveform(
            counts=np.frombuffer(frame.counts, dtype=f"<i{frame.width}"),
            sample_rate_hz=told["sample_rate_hz"],
            pretrigger_samples=told["pretrigger_samples"],
            calibration=Calibration(
                **{**calibration, "coefficients_v": np.array(calibration["coefficients_v"])}
            ),
        ),
        "truth": told["truth"],
        "settings": told["settings"],
    }
    return PulseEchoRecord(**common, **told["receiver"]) if frame.kind is Kind.ECHO else Shot(**common)


def missed_of(frame: Frame) -> MissedRecord:
    """Return what a sound frame says was tried in vain."""
    told = frame.told()
    position, shot_index, attempt = told["key"]
    key = ShotKey(position=position, set_index=frame.set_index, shot_index=shot_index, attempt=attempt)
    return MissedRecord(key=key, cause=told["cause"], reason=told["reason"])
