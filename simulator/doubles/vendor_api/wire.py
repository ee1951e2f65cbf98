"""Encoding of calls and answers as bytes: the counterpart of `transport.c`.

Little-endian. A frame is its length (u32) and its body. A call is the entry's name and its inputs in
the table's order; an answer is status, text and the outputs, each behind a byte that says "is there".
An attribute's value has the type its number names (`attributes`).
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from simulator.doubles.vendor_api.attributes import ATTRIBUTES
from simulator.doubles.vendor_api.entry_points import (
    INT32,
    EntryPoint,
    Parameter,
    Role,
    Scalar,
    Tail,
    out,
    out_array,
    out_text,
    value,
)
from simulator.doubles.vendor_api.entry_points import array as in_array
from simulator.doubles.vendor_api.entry_points import text as in_text
from simulator.doubles.vendor_api.table import TABLE

FRAME_LIMIT = 1 << 30
HELLO = struct.Struct("<IQ")
"""Process id and client number; 0 asks for a new one."""


class WireError(Exception):
    """Error: the peer sent no valid frame of this table."""


class Reader:
    """Reader of the values of a body, one after the other."""

    def __init__(self, body: bytes) -> None:
        self._body = memoryview(body)
        self._at = 0

    def take(self, count: int) -> memoryview:
        """Read ``count`` bytes."""
        if self._at + count > len(self._body):
            raise WireError(f"the frame has {len(self._body)} bytes and ends inside a value")
        piece = self._body[self._at : self._at + count]
        self._at += count
        return piece

    def number(self, packed: str) -> Any:
        """Read one number."""
        (number,) = struct.unpack("<" + packed, self.take(struct.calcsize("<" + packed)))
        return number

    def text(self) -> str:
        """Read a text."""
        return bytes(self.take(self.number("I"))).decode("utf-8", errors="replace")

    def array(self, scalar: Scalar) -> np.ndarray[Any, Any]:
        """Read an array of numbers."""
        count = self.number("I")
        data = self.take(count * struct.calcsize("<" + scalar.packed))
        return np.frombuffer(data, dtype="<" + scalar.packed).copy()


def _number(scalar: Scalar, number: Any) -> bytes:
    return struct.pack("<" + scalar.packed, number)


def _text(text: str) -> bytes:
    # nidaqmx decodes by the locale, which may be plain ASCII.
    encoded = text.encode("ascii", errors="backslashreplace")
    return struct.pack("<I", len(encoded)) + encoded


def _array(scalar: Scalar, numbers: Any) -> bytes:
    # `<u8` of a bool list and the like: let numpy convert once.
    packed = np.ascontiguousarray(numbers, dtype="<" + scalar.packed)
    return struct.pack("<I", packed.size) + packed.tobytes()


def inputs(entry: EntryPoint, attribute: int = 0) -> tuple[Parameter, ...]:
    """Return the parameters of a call.

    A variadic entry adds ``value``, or ``channel_names`` and ``state``.
    """
    fixed = tuple(p for p in entry.parameters if not p.goes_out and p.role is not Role.UNUSED)
    return fixed + _tail(entry, attribute, outgoing=False)


def outputs(entry: EntryPoint, attribute: int = 0) -> tuple[Parameter, ...]:
    """Return the parameters of an answer."""
    return tuple(p for p in entry.parameters if p.goes_out) + _tail(entry, attribute, outgoing=True)


def _tail(entry: EntryPoint, attribute: int, *, outgoing: bool) -> tuple[Parameter, ...]:
    if entry.tail in (Tail.SET_STATES, Tail.GET_STATES):
        if outgoing:
            return (out_array("state", INT32, ""),) if entry.tail is Tail.GET_STATES else ()
        names = (in_text("channel_names"),)
        return (*names, in_array("state", INT32, "")) if entry.tail is Tail.SET_STATES else names
    if entry.tail is (Tail.GET_ATTRIBUTE if outgoing else Tail.SET_ATTRIBUTE) and attribute in ATTRIBUTES:
        known = ATTRIBUTES[attribute]
        if known.scalar is None:
            return (out_text("value", "") if outgoing else in_text("value"),)
        if known.is_array:
            return ((out_array if outgoing else in_array)("value", known.scalar, ""),)
        return ((out if outgoing else value)("value", known.scalar),)
    return ()


def decode_call(body: bytes) -> tuple[EntryPoint, dict[str, Any]]:
    """Return entry and arguments of a call.

    Raises
    ------
    WireError
        No such entry, or the body ends too soon.
    """
    reader = Reader(body)
    name = bytes(reader.take(reader.number("H"))).decode("utf-8", errors="replace")
    if name not in TABLE:
        raise WireError(f"no entry point {name!r}; library and brain are of different versions")
    entry = TABLE[name]
    arguments: dict[str, Any] = {}
    fixed = inputs(entry)
    for parameter in fixed:
        arguments[parameter.name] = decode_value(parameter, reader)
    for parameter in inputs(entry, arguments.get("attribute", 0))[len(fixed) :]:
        arguments[parameter.name] = decode_value(parameter, reader)
    return entry, arguments


def encode_answer(
    entry: EntryPoint, arguments: Mapping[str, Any], status: int, text: str, values: Mapping[str, Any]
) -> bytes:
    """Return the body of an answer; an output without a value is marked as absent."""
    parts = [struct.pack("<i", status), _text(text)]
    for parameter in outputs(entry, arguments.get("attribute", 0)):
        if parameter.name in values:
            parts += [b"\1", encode_value(parameter, values[parameter.name])]
        else:
            parts.append(b"\0")
    return b"".join(parts)


def encode_value(parameter: Parameter, content: Any) -> bytes:
    """Return the bytes of one parameter's value."""
    if parameter.role in (Role.TEXT, Role.OUT_TEXT):
        return _text(content)
    if parameter.role in (Role.ARRAY, Role.OUT_ARRAY):
        return _array(parameter.scalar, content)
    return _number(parameter.scalar, content)


def decode_value(parameter: Parameter, reader: Reader) -> Any:
    """Read the value of one parameter from a body."""
    if parameter.role in (Role.TEXT, Role.OUT_TEXT):
        return reader.text()
    if parameter.role in (Role.ARRAY, Role.OUT_ARRAY):
        return reader.array(parameter.scalar)
    return reader.number(parameter.scalar.packed)


def send_frame(connection: socket.socket, body: bytes) -> None:
    """Write one frame."""
    connection.sendall(struct.pack("<I", len(body)) + body)


def receive_frame(connection: socket.socket) -> bytes | None:
    """Read one frame; None if the peer closed between two frames or inside one."""
    head = receive_exactly(connection, 4)
    if head is None:
        return None
    (length,) = struct.unpack("<I", head)
    if length > FRAME_LIMIT:
        raise WireError(f"a frame of {length} bytes; at most {FRAME_LIMIT} are accepted")
    return receive_exactly(connection, length)


def receive_exactly(connection: socket.socket, count: int) -> bytes | None:
    """Read ``count`` bytes; None if the peer closed before."""
    pieces: list[bytes] = []
    while count > 0:
        piece = connection.recv(min(count, 1 << 20))
        if not piece:
            return None
        pieces.append(piece)
        count -= len(piece)
    return b"".join(pieces)


def names_of(lines: str) -> Iterable[str]:
    """Return the channel names of a power-up call, which are sent as one text with line feeds."""
    return lines.split("\n") if lines else []
