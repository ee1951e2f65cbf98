"""Encoding of calls and answers as bytes: the counterpart of `transport.c`.

Little-endian. A frame is its length (u32) and its body. A call is the entry's name and its inputs in
the table's order; an answer is status, text and the outputs, each behind a byte that says "is there".
An attribute's value has the type its number names (`attributes`).
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.doubles.vendor_api.attributes import ATTRIBUTES
from simulator.doubles.vendor_api.entry_points import ENTRY_POINTS, PACKED, EntryPoint, Parameter, Role, Tail

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
        """Read the next ``count`` bytes as a view; raise WireError if the body ends before."""
        if self._at + count > len(self._body):
            raise WireError(f"the frame has {len(self._body)} bytes and ends inside a value")
        piece = self._body[self._at : self._at + count]
        self._at += count
        return piece

    def number(self, packed: str) -> Any:
        """Read the next number in a `struct` format; raise WireError if the body ends before."""
        (number,) = struct.unpack(packed, self.take(struct.calcsize(packed)))
        return number

    def text(self) -> str:
        """Read a UTF-8 text with its length in bytes (u32) in front; invalid bytes are replaced.

        Raise WireError if the body ends before.
        """
        return bytes(self.take(self.number("<I"))).decode("utf-8", errors="replace")

    def array(self, packed: str) -> NDArray[Any]:
        """Read an array of numbers with their count (u32) in front; return a copy, shape (count,).

        Raise WireError if the body ends before.
        """
        data = self.take(self.number("<I") * struct.calcsize(packed))
        return np.frombuffer(data, dtype=packed).copy()


def _encode_text(text: str) -> bytes:
    """Encode a text as ASCII with its length (u32) in front; other characters become backslash escapes."""
    # nidaqmx decodes by the locale, which may be plain ASCII.
    encoded = text.encode("ascii", errors="backslashreplace")
    return struct.pack("<I", len(encoded)) + encoded


def list_inputs(entry: EntryPoint, attribute: int = 0) -> tuple[Parameter, ...]:
    """Return the input parameters of a call, in the order of the wire.

    A variadic entry adds ``value`` (nothing for an unknown attribute number), or ``channel_names`` and, to
    set them, ``state``.
    """
    return tuple(p for p in entry.parameters if p.goes_in) + _list_tail_inputs(entry, attribute)


def list_outputs(entry: EntryPoint, attribute: int = 0) -> tuple[Parameter, ...]:
    """Return the output parameters of a call, in the order of the wire.

    A variadic entry adds ``value`` (nothing for an unknown attribute number) or ``state``.
    """
    tail: tuple[Parameter, ...] = ()
    if entry.tail is Tail.GET_STATES:
        tail = (Parameter("state", Role.OUT_ARRAY, "int32_t"),)
    elif entry.tail is Tail.GET_ATTRIBUTE and attribute in ATTRIBUTES:
        tail = (ATTRIBUTES[attribute].value(Role.OUT, Role.OUT_ARRAY, Role.OUT_TEXT),)
    return tuple(p for p in entry.parameters if p.goes_out) + tail


def _list_tail_inputs(entry: EntryPoint, attribute: int) -> tuple[Parameter, ...]:
    """Return the variable inputs of a variadic call; empty for other calls or an unknown attribute."""
    if entry.tail is Tail.SET_ATTRIBUTE and attribute in ATTRIBUTES:
        return (ATTRIBUTES[attribute].value(Role.VALUE, Role.ARRAY, Role.TEXT),)
    names = Parameter("channel_names", Role.TEXT, "char")
    if entry.tail is Tail.SET_STATES:
        return names, Parameter("state", Role.ARRAY, "int32_t")
    return (names,) if entry.tail is Tail.GET_STATES else ()


def decode_call(body: bytes) -> tuple[EntryPoint, dict[str, Any]]:
    """Decode the body of a call to its entry point and its arguments by name.

    Raises
    ------
    WireError
        No such entry, or the body ends too soon.
    """
    reader = Reader(body)
    name = bytes(reader.take(reader.number("<H"))).decode("utf-8", errors="replace")
    if name not in ENTRY_POINTS:
        raise WireError(f"no entry point {name!r}; library and brain are of different versions")
    entry = ENTRY_POINTS[name]
    arguments = {p.name: decode_value(p, reader) for p in entry.parameters if p.goes_in}
    for parameter in _list_tail_inputs(entry, arguments.get("attribute", 0)):
        arguments[parameter.name] = decode_value(parameter, reader)
    return entry, arguments


def encode_answer(
    entry: EntryPoint, arguments: Mapping[str, Any], status: int, text: str, values: Mapping[str, Any]
) -> bytes:
    """Encode the body of an answer: status, text and outputs.

    Each output has a byte in front: 1, or 0 for an output without a value, which is left out. Raise
    struct.error if a number does not fit its type.
    """
    parts = [struct.pack("<i", status), _encode_text(text)]
    for parameter in list_outputs(entry, arguments.get("attribute", 0)):
        if parameter.name in values:
            parts += [b"\1", encode_value(parameter, values[parameter.name])]
        else:
            parts.append(b"\0")
    return b"".join(parts)


def encode_value(parameter: Parameter, content: Any) -> bytes:
    """Encode the value of one parameter by its role and C type; arrays are converted to the type.

    Raises
    ------
    struct.error
        A number does not fit its type.
    """
    if parameter.role in (Role.TEXT, Role.OUT_TEXT):
        return _encode_text(content)
    packed = PACKED[parameter.c_type]
    if parameter.role in (Role.ARRAY, Role.OUT_ARRAY):
        # `<u8` of a bool list and the like: let numpy convert once.
        numbers = np.ascontiguousarray(content, dtype=packed)
        return struct.pack("<I", numbers.size) + numbers.tobytes()
    return struct.pack(packed, content)


def decode_value(parameter: Parameter, reader: Reader) -> Any:
    """Decode the value of one parameter by its role and C type: a str, an array or a number.

    Raises
    ------
    WireError
        The body ends before.
    """
    if parameter.role in (Role.TEXT, Role.OUT_TEXT):
        return reader.text()
    read = reader.array if parameter.role in (Role.ARRAY, Role.OUT_ARRAY) else reader.number
    return read(PACKED[parameter.c_type])


def send_frame(connection: socket.socket, body: bytes) -> None:
    """Send one frame: the body with its length (u32) in front; block until all is sent.

    Raise OSError if the connection is broken.
    """
    connection.sendall(struct.pack("<I", len(body)) + body)


def receive_frame(connection: socket.socket) -> bytes | None:
    """Block until one frame has come and return its body; None if the peer closes before its end.

    Raises
    ------
    WireError
        The frame is larger than `FRAME_LIMIT`.
    OSError
        The connection is broken.
    """
    head = receive_exactly(connection, 4)
    if head is None:
        return None
    (length,) = struct.unpack("<I", head)
    if length > FRAME_LIMIT:
        raise WireError(f"a frame of {length} bytes; at most {FRAME_LIMIT} are accepted")
    return receive_exactly(connection, length)


def receive_exactly(connection: socket.socket, count: int) -> bytes | None:
    """Block until exactly ``count`` bytes have come and return them; None if the peer closes before.

    Raise OSError if the connection is broken.
    """
    pieces: list[bytes] = []
    while count > 0:
        piece = connection.recv(min(count, 1 << 20))
        if not piece:
            return None
        pieces.append(piece)
        count -= len(piece)
    return b"".join(pieces)
