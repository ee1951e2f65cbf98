"""Journal frames: after a cut or a flipped bit only the corrupt frame is lost."""

import pytest
from support.archived_sets import make_set, make_shot
from support.memory_archive import bits

from daq_service.archive.journal.frames import (
    HEADER,
    build_begin_frame,
    build_end_frame,
    build_record_frame,
    decode_record,
    parse_frames,
)
from hardware_drivers.measurement import SetKey

RECORDS = make_set().records
WRITTEN = [
    build_begin_frame(SetKey(7), due_utc_ns=5, started_utc_ns=6, disabled={"C": "worn"}),
    *map(build_record_frame, RECORDS),
    build_end_frame(make_set()),
]
WRITTEN = [b"".join(frame) for frame in WRITTEN]
SEGMENT = b"".join(WRITTEN) + bytes(4096)


def sound(content):
    return {(frame.kind, frame.sequence): bits(frame) for frame in parse_frames(content) if frame.sound}


ALL = sound(SEGMENT)


def test_the_header_holds_the_number_of_an_unscheduled_set_as_in_earlier_versions():
    content = b"".join(build_begin_frame(SetKey(7, 2), due_utc_ns=5, started_utc_ns=6, disabled={}))
    assert HEADER.unpack_from(content)[6] == 20_000_007
    assert [frame.set_key for frame in parse_frames(content)] == [SetKey(7, 2)]
    assert list(parse_frames(content, of_set=SetKey(7))) == []


def test_every_record_is_restored_bit_for_bit():
    found = [decode_record(frame) for frame in parse_frames(SEGMENT) if frame.sequence >= 0]
    assert bits(found) == bits(RECORDS)
    assert len(ALL) == len(WRITTEN)


@pytest.mark.parametrize("odd", [float("nan"), float("inf"), -0.0, 5e-324])
def test_a_number_without_json_representation_is_restored(odd):
    shot = make_shot("B", 0, 1, truth={"depth_m": odd}, settings={"note": "null", "gain": odd})
    (frame,) = parse_frames(b"".join(build_record_frame(shot)))
    assert bits(decode_record(frame)) == bits(shot)


def test_a_flipped_bit_costs_one_frame_at_most():
    """The intact frames are exactly the written ones; a frame at another offset is invalid."""
    step = 13  # every byte would take half a minute; this meets every field of header, facts and counts
    for position in range(0, len(SEGMENT), step):
        content = bytearray(SEGMENT)
        content[position] ^= 1 << position % 8
        found = sound(bytes(content))
        assert found.items() <= ALL.items(), position
        assert len(found) >= len(ALL) - 1, position


def test_a_segment_cut_anywhere_keeps_what_came_before():
    ends = [sum(map(len, WRITTEN[: number + 1])) for number in range(len(WRITTEN))]
    for length in range(0, ends[-1] + 1, 11):
        found = sound(SEGMENT[:length])
        assert found.items() <= ALL.items()
        assert len(found) == sum(end <= length for end in ends)


def test_the_next_frame_is_found_after_an_unwritten_page():
    start = len(WRITTEN[0]) + 100
    content = SEGMENT[:start] + bytes(500) + SEGMENT[start + 500 :]
    found = sound(content)
    assert found.items() <= ALL.items()
    assert len(ALL) - 3 <= len(found) < len(ALL)
