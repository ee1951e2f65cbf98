"""The table of C entry points that the doubles answer, read from the headers next to this module.

From it are made the C source of the libraries (`c_source`), the bytes on the wire (`wire`) and the
brain's dispatch.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path

LIBRARIES = ("nidaqmx", "niScope")
"""Libraries of the doubles; each has a header."""

HANDLE = "TaskHandle"
"""C type of a task handle: a pointer to the caller, a number to the brain."""

PACKED = {
    "int16_t": "<h",
    "uint16_t": "<H",
    "int32_t": "<i",
    "uint32_t": "<I",
    "uint64_t": "<Q",
    "double": "<d",
    "uint8_t": "<B",
    "char": "<B",
    "void": "<B",
    HANDLE: "<Q",
}
"""`struct` format of each C type: little-endian, no padding."""

_ENTRY = re.compile(r"int32_t (\w+)\(([^)]*)\);")
_PARAMETER = re.compile(r"(const )?(\w+) (\*?)(\w+)(?:\[(\w+)\])?")
_TAIL = re.compile(r"DAQmx(Get|Set)\w*(Attribute|States)")


class Role(Enum):
    """Purpose of a parameter."""

    VALUE = auto()
    """A number by value."""
    TEXT = auto()
    """`const char *`; NULL reads as empty."""
    ARRAY = auto()
    """Numbers to read; `size` names the parameter that holds how many."""
    OUT = auto()
    """Pointer to one number to write; may be NULL."""
    OUT_ARRAY = auto()
    """Numbers to write; `size` names the parameter that holds the room, in elements."""
    OUT_TEXT = auto()
    """Text to write; with `size` 0 the entry returns the room that is needed."""
    UNUSED = auto()
    """A reserved pointer."""


class Tail(Enum):
    """Arguments after the fixed parameters of a variadic entry."""

    NONE = auto()
    GET_ATTRIBUTE = auto()
    """Where to write the attribute's value and, for text and arrays, the room there."""
    SET_ATTRIBUTE = auto()
    """The attribute's value and, for arrays, how many."""
    SET_STATES = auto()
    """Pairs of channel name and state, ended by NULL."""
    GET_STATES = auto()
    """Pairs of channel name and where to write its state, ended by NULL."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """Parameter of one entry point."""

    name: str
    role: Role
    c_type: str
    size: str = ""

    @property
    def goes_out(self) -> bool:
        """Return whether the parameter is an output, part of the answer."""
        return self.role in (Role.OUT, Role.OUT_ARRAY, Role.OUT_TEXT)

    @property
    def goes_in(self) -> bool:
        """Return whether the parameter is an input, part of the call; a reserved pointer is neither."""
        return not self.goes_out and self.role is not Role.UNUSED


@dataclass(frozen=True, slots=True)
class EntryPoint:
    """C function.

    Attributes
    ----------
    library
        Which of `LIBRARIES` exports it.
    declared
        Its parameters in C.
    """

    name: str
    library: str
    declared: str
    parameters: tuple[Parameter, ...]
    tail: Tail


def _build_parameter(const: str, c_type: str, pointer: str, name: str, size: str) -> Parameter:
    """Create a parameter from the parts of its C declaration (empty if absent), which determine its role."""
    role = Role.VALUE
    if c_type == "void":
        role = Role.UNUSED
    elif size:
        role = Role.OUT_TEXT if c_type == "char" else Role.ARRAY if const else Role.OUT_ARRAY
    elif pointer:
        role = Role.TEXT if const else Role.OUT
    return Parameter(name, role, c_type, size)


def _read_header(library: str) -> Iterator[EntryPoint]:
    """Read a library's C header; yield the entry points that it declares, in order; skip other lines."""
    header = Path(__file__).with_name(f"{library}.h").read_text(encoding="utf-8")
    for name, declared in _ENTRY.findall(header):
        tail = _TAIL.match(name) if declared.endswith("...") else None
        yield EntryPoint(
            name=name,
            library=library,
            declared=re.sub(r"(\w+)\[\w+\]", r"*\1", declared),
            parameters=tuple(_build_parameter(*parts) for parts in _PARAMETER.findall(declared)),
            tail=Tail.NONE if tail is None else Tail["_".join(tail.groups()).upper()],
        )


ENTRY_POINTS: Mapping[str, EntryPoint] = {
    entry.name: entry for library in LIBRARIES for entry in _read_header(library)
}
"""By C name, of all libraries."""
