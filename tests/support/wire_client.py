"""The C library's side of the wire, in Python."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

from simulator.doubles.vendor_api import wire
from simulator.doubles.vendor_api.entry_points import EntryPoint


def encode_call(entry: EntryPoint, arguments: Mapping[str, Any]) -> bytes:
    """Return the body of a call."""
    name = entry.name.encode()
    parts = [struct.pack("<H", len(name)), name]
    for parameter in wire.list_inputs(entry, arguments.get("attribute", 0)):
        parts.append(wire.encode_value(parameter, arguments[parameter.name]))
    return b"".join(parts)


def decode_answer(
    entry: EntryPoint, arguments: Mapping[str, Any], body: bytes
) -> tuple[int, str, dict[str, Any]]:
    """Return status, text and values of an answer."""
    reader = wire.Reader(body)
    status, text = reader.number("i"), reader.text()
    values = {
        parameter.name: wire.decode_value(parameter, reader)
        for parameter in wire.list_outputs(entry, arguments.get("attribute", 0))
        if reader.number("B")
    }
    return status, text, values
