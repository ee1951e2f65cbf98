"""Calls and answers as bytes."""

import numpy as np
import pytest
from support.wire_client import decode_answer, encode_call

from simulator.doubles.vendor_api import wire
from simulator.doubles.vendor_api.attributes import ATTRIBUTES
from simulator.doubles.vendor_api.entry_points import ENTRY_POINTS, HANDLE, PACKED, Role, Tail

EXTREMES = {
    "int16_t": -(2**15),
    "uint16_t": 2**16 - 1,
    "int32_t": -(2**31),
    "uint32_t": 2**32 - 1,
    "uint64_t": 2**64 - 1,
    HANDLE: 2**64 - 1,
    "double": -1.25e-300,
    "uint8_t": 255,
}


def example(parameter):
    """A value that a narrower or differently signed type would spoil."""
    if parameter.role in (Role.TEXT, Role.OUT_TEXT):
        return "Dev1/ai0, Dev1/ai1"
    number = EXTREMES[parameter.c_type]
    if parameter.role in (Role.ARRAY, Role.OUT_ARRAY):
        return np.array([0, number, 1], dtype=PACKED[parameter.c_type])
    return number


def attributes_of(entry):
    if entry.tail not in (Tail.GET_ATTRIBUTE, Tail.SET_ATTRIBUTE):
        return [0]
    family = entry.name.removeprefix("DAQmxGet").removeprefix("DAQmxSet").removesuffix("Attribute")
    return [number for number, attribute in ATTRIBUTES.items() if attribute.family == family]


ENTRIES = pytest.mark.parametrize("entry", ENTRY_POINTS.values(), ids=lambda entry: entry.name)


def same(first, second):
    return first.keys() == second.keys() and all(np.array_equal(first[name], second[name]) for name in first)


@ENTRIES
def test_a_call_arrives_as_it_was_sent(entry):
    for attribute in attributes_of(entry):
        arguments = {parameter.name: example(parameter) for parameter in wire.list_inputs(entry, attribute)}
        if "attribute" in arguments:
            arguments["attribute"] = attribute
        found, decoded = wire.decode_call(encode_call(entry, arguments))
        assert found is entry
        assert same(decoded, arguments)


@ENTRIES
def test_an_answer_arrives_as_it_was_given(entry):
    for attribute in attributes_of(entry):
        arguments = {"attribute": attribute}
        values = {parameter.name: example(parameter) for parameter in wire.list_outputs(entry, attribute)}
        body = wire.encode_answer(entry, arguments, -200088, "The task is invalid.", values)
        status, text, decoded = decode_answer(entry, arguments, body)
        assert (status, text) == (-200088, "The task is invalid.")
        assert same(decoded, values)


@ENTRIES
def test_an_answer_without_values_is_reported(entry):
    body = wire.encode_answer(entry, {}, -1, "", {})
    assert decode_answer(entry, {}, body) == (-1, "", {})


def test_text_that_the_caller_s_locale_may_not_know_is_escaped():
    entry = ENTRY_POINTS["DAQmxCreateTask"]
    body = wire.encode_answer(entry, {}, -1, "9 µs", {})
    assert decode_answer(entry, {}, body)[1] == "9 \\xb5s"


def test_a_call_of_an_unknown_entry_is_refused():
    entry = ENTRY_POINTS["DAQmxCreateTask"]
    body = encode_call(entry, {"session_name": "a"}).replace(b"Create", b"Create"[::-1])
    with pytest.raises(wire.WireError, match="different versions"):
        wire.decode_call(body)


@pytest.mark.parametrize("cut", [1, 3, 20, -1])
def test_a_frame_that_ends_too_soon_is_refused(cut):
    body = encode_call(
        ENTRY_POINTS["DAQmxConnectTerms"],
        {
            "source_terminal": "/Dev1/PFI0",
            "destination_terminal": "/Dev1/PFI1",
            "signal_modifiers": 0,
        },
    )
    with pytest.raises(wire.WireError, match="ends inside a value"):
        wire.decode_call(body[:cut])
