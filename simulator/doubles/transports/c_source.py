"""Generate the C source of a double library from the table of entry points."""

from __future__ import annotations

import struct
from importlib.resources import files

from simulator.doubles.vendor_api.attributes import ATTRIBUTES, Attribute
from simulator.doubles.vendor_api.entry_points import (
    ENTRY_POINTS,
    HANDLE,
    PACKED,
    EntryPoint,
    Parameter,
    Role,
    Tail,
)


def generate_library_source(library: str) -> str:
    """Generate the C source of a library: common part, attribute types, and a function per entry point.

    ``library`` is one of `LIBRARIES`; another one gets no functions.
    """
    shared = files("simulator.doubles.transports").joinpath("transport.c").read_text(encoding="utf-8")
    functions = [_generate_function(entry) for entry in ENTRY_POINTS.values() if entry.library == library]
    return "\n".join([shared, _generate_attribute_kinds(), *functions])


def _generate_attribute_kinds() -> str:
    """Generate the C function that maps an attribute's number to the type of its value."""
    cases = [f"    case {entry.number}: return {_format_kind(entry)};" for entry in ATTRIBUTES.values()]
    head = "static int attribute_kind(int32_t attribute) {\n    switch (attribute) {"
    return "\n".join([head, *cases, "    default: return KIND_UNKNOWN;", "    }", "}", ""])


def _format_kind(attribute: Attribute) -> str:
    """Format the C expression for an attribute's type: a constant, or the width of a number in bytes.

    The width is negative for arrays.
    """
    if attribute.c_type == "char":
        return "KIND_TEXT"
    width = struct.calcsize(PACKED[attribute.c_type])
    if attribute.is_array:
        return str(-width)
    return "KIND_FLOAT64" if attribute.c_type == "double" else str(width)


def _generate_function(entry: EntryPoint) -> str:
    """Generate the C function of an entry point: send the inputs, wait for the answer, write the outputs."""
    lines = [f"int32_t {entry.name}({entry.declared}) {{", "struct message message;", "int32_t status;"]
    variadic = entry.tail is not Tail.NONE
    if variadic:
        lines += ["va_list tail;", f"va_start(tail, {entry.parameters[-1].name});"]
    lines.append(f'begin(&message, "{entry.name}");')
    lines += [_generate_put(parameter) for parameter in entry.parameters if parameter.goes_in]
    if entry.tail is Tail.SET_ATTRIBUTE:
        lines.append("put_attribute(&message, attribute, tail);")
    if entry.tail in (Tail.SET_STATES, Tail.GET_STATES):
        with_values = int(entry.tail is Tail.SET_STATES)
        lines += [
            "{ va_list again; va_copy(again, tail);",
            f"put_states(&message, again, {with_values}); va_end(again); }}",
        ]
    lines.append("status = exchange(&message);")
    lines += [_generate_take(parameter) for parameter in entry.parameters if parameter.goes_out]
    if entry.tail is Tail.GET_ATTRIBUTE:
        lines.append("status = take_attribute(&message, status, attribute, tail);")
    if entry.tail is Tail.GET_STATES:
        lines.append("take_states(&message, tail);")
    if variadic:
        lines.append("va_end(tail);")
    return "\n    ".join([*lines, "free(message.bytes);", "return status;"]) + "\n}\n"


def _generate_put(parameter: Parameter) -> str:
    """Generate the C statement that adds an input parameter to the message, by its role and type."""
    name = parameter.name
    if parameter.role is Role.TEXT:
        return f"put_text(&message, {name});"
    if parameter.role is Role.ARRAY:
        return f"put_array(&message, {name}, (uint32_t){parameter.size}, sizeof *{name});"
    if parameter.c_type == HANDLE:
        return f"{{ uint64_t number = (uint64_t)(uintptr_t){name}; put(&message, &number, sizeof number); }}"
    return f"put(&message, &{name}, sizeof {name});"


def _generate_take(parameter: Parameter) -> str:
    """Generate the C statement that reads an output parameter from the answer, by its role and type."""
    name = parameter.name
    if parameter.role is Role.OUT_TEXT:
        return f"status = take_text(&message, status, {name}, (uint32_t){parameter.size});"
    if parameter.role is Role.OUT_ARRAY:
        return f"take_array(&message, {name}, (uint32_t){parameter.size}, sizeof *{name});"
    if parameter.c_type == HANDLE:
        return (
            f"{{ uint64_t number = (uint64_t)(uintptr_t)*{name}; take(&message, &number, sizeof number); "
            f"*{name} = (void *)(uintptr_t)number; }}"
        )
    return f"take(&message, {name}, sizeof *{name});"
