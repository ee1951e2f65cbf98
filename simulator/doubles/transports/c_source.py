"""Generate the C source of a double library from the table of entry points."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from importlib.resources import files

from simulator.doubles.vendor_api.attributes import ATTRIBUTES, Attribute
from simulator.doubles.vendor_api.entry_points import FLOAT64, HANDLE, EntryPoint, Parameter, Role, Tail
from simulator.doubles.vendor_api.table import of_library


def library_source(library: str) -> str:
    """Return the source of one shared library: the common part, then one function per entry."""
    shared = files("simulator.doubles.transports").joinpath("transport.c").read_text(encoding="utf-8")
    functions = [_function(entry) for entry in of_library(library)]
    return "\n".join([shared, _attribute_kinds(ATTRIBUTES.values()), *functions])


def _attribute_kinds(attributes: Iterable[Attribute]) -> str:
    cases = [f"    case {entry.number}: return {_kind(entry)};" for entry in attributes]
    return "\n".join(
        [
            "static int attribute_kind(int32_t attribute) {",
            "    switch (attribute) {",
            *cases,
            "    default: return KIND_UNKNOWN;",
            "    }",
            "}",
            "",
        ]
    )


def _kind(attribute: Attribute) -> str:
    if attribute.scalar is None:
        return "KIND_TEXT"
    width = struct.calcsize("<" + attribute.scalar.packed)
    if attribute.is_array:
        return str(-width)
    return "KIND_FLOAT64" if attribute.scalar is FLOAT64 else str(width)


def _function(entry: EntryPoint) -> str:
    declared = [_declaration(parameter) for parameter in entry.parameters]
    if entry.tail is not Tail.NONE:
        declared.append("...")
    head = f"int32_t {entry.name}({', '.join(declared) or 'void'}) {{"
    body = _local_body(entry) if entry.local else _remote_body(entry)
    return "\n".join([head, *(f"    {statement}" for statement in body), "}", ""])


def _declaration(parameter: Parameter) -> str:
    match parameter.role:
        case Role.VALUE:
            return f"{parameter.scalar.c_type} {parameter.name}"
        case Role.TEXT:
            return f"const char *{parameter.name}"
        case Role.ARRAY:
            return f"const {parameter.scalar.c_type} *{parameter.name}"
        case Role.OUT_TEXT:
            return f"char *{parameter.name}"
        case Role.UNUSED:
            return f"void *{parameter.name}"
    return f"{parameter.scalar.c_type} *{parameter.name}"


def _local_body(entry: EntryPoint) -> list[str]:
    """Return the body of an entry without a call.

    The library keeps only the last error, one per thread, as NI's.
    """
    (text,) = (parameter for parameter in entry.parameters if parameter.role is Role.OUT_TEXT)
    return [f"return fill_text(0, error_text, strlen(error_text), {text.name}, (uint32_t){text.size});"]


def _remote_body(entry: EntryPoint) -> list[str]:
    last = entry.parameters[-1].name if entry.parameters else ""
    variadic = entry.tail is not Tail.NONE
    lines = ["struct message message;", "int32_t status;"]
    if variadic:
        lines += ["va_list tail;", f"va_start(tail, {last});"]
    lines.append(f'begin(&message, "{entry.name}");')
    lines += [_put(parameter) for parameter in entry.parameters if _is_input(parameter)]
    if entry.tail is Tail.SET_ATTRIBUTE:
        lines.append("put_attribute(&message, attribute, tail);")
    if entry.tail in (Tail.SET_STATES, Tail.GET_STATES):
        with_values = int(entry.tail is Tail.SET_STATES)
        lines += [
            "{ va_list again; va_copy(again, tail);",
            f"put_states(&message, again, {with_values}); va_end(again); }}",
        ]
    lines.append("status = exchange(&message);")
    lines += [_take(parameter) for parameter in entry.parameters if parameter.goes_out]
    if entry.tail is Tail.GET_ATTRIBUTE:
        lines.append("status = take_attribute(&message, status, attribute, tail);")
    if entry.tail is Tail.GET_STATES:
        lines.append("take_states(&message, tail);")
    if variadic:
        lines.append("va_end(tail);")
    return [*lines, "free(message.bytes);", "return status;"]


def _is_input(parameter: Parameter) -> bool:
    return not parameter.goes_out and parameter.role is not Role.UNUSED


def _put(parameter: Parameter) -> str:
    name = parameter.name
    if parameter.role is Role.TEXT:
        return f"put_text(&message, {name});"
    if parameter.role is Role.ARRAY:
        return f"put_array(&message, {name}, (uint32_t){parameter.size}, sizeof *{name});"
    if parameter.scalar is HANDLE:
        return f"{{ uint64_t number = (uint64_t)(uintptr_t){name}; put(&message, &number, sizeof number); }}"
    return f"put(&message, &{name}, sizeof {name});"


def _take(parameter: Parameter) -> str:
    name = parameter.name
    if parameter.role is Role.OUT_TEXT:
        return f"status = take_text(&message, status, {name}, (uint32_t){parameter.size});"
    if parameter.role is Role.OUT_ARRAY:
        return f"take_array(&message, {name}, (uint32_t){parameter.size}, sizeof *{name});"
    if parameter.scalar is HANDLE:
        return (
            f"{{ uint64_t number = (uint64_t)(uintptr_t)*{name}; take(&message, &number, sizeof number); "
            f"*{name} = (void *)(uintptr_t)number; }}"
        )
    return f"take(&message, {name}, sizeof *{name});"
