"""The table of entry points against what `nidaqmx` itself calls."""

import ast
import inspect
import re
from pathlib import Path

import pytest

from simulator.doubles.device_model import HANDLERS, TASK_HANDLERS
from simulator.doubles.transports.c_source import library_source
from simulator.doubles.vendor_api import entry_points as table
from simulator.doubles.vendor_api.attributes import ATTRIBUTES
from simulator.doubles.vendor_api.entry_points import ENTRY_POINTS, Role, Tail
from simulator.doubles.vendor_api.statuses import TEXTS
from simulator.doubles.vendor_api.table import TABLE

nidaqmx = pytest.importorskip("nidaqmx")
PACKAGE = Path(nidaqmx.__file__).parent

NUMBERS = {
    table.INT16: "int16",
    table.UINT16: "uint16",
    table.INT32: "int32",
    table.UINT32: "uint32",
    table.UINT64: "uint64",
    table.FLOAT64: "float64",
    table.BYTE: "uint8",
}
C_NUMBERS = {
    "ctypes.c_int": "int32",
    "ctypes.c_int32": "int32",
    "ctypes.c_uint": "uint32",
    "ctypes.c_uint32": "uint32",
    "ctypes.c_ulonglong": "uint64",
    "ctypes.c_double": "float64",
    "c_bool32": "uint32",
}


def functions():
    source = (PACKAGE / "_library_interpreter.py").read_text(encoding="utf-8")
    (interpreter,) = (
        node
        for node in ast.parse(source).body
        if isinstance(node, ast.ClassDef) and node.name == "LibraryInterpreter"
    )
    return [node for node in interpreter.body if isinstance(node, ast.FunctionDef)]


def declared_types():
    """By C name: the argument types that the interpreter declares, as source text."""
    found = {}
    for function in functions():
        name = re.search(r"lib_importer\.\w+\.(DAQmx\w+)", ast.unparse(function))
        for node in ast.walk(function):
            if (
                name
                and isinstance(node, ast.Assign)
                and ast.unparse(node.targets[0]) == "c_func.argtypes"
                and isinstance(node.value, ast.List)
            ):
                found.setdefault(name[1], []).append([ast.unparse(element) for element in node.value.elts])
    return found


DECLARED = declared_types()


def kind(source):
    """What one declared type is in the table's words: role and number."""
    if source in ("ctypes_byte_str",):
        return "text"
    if source in ("ctypes.c_char_p",):
        return "out text"
    if source in ("lib_importer.task_handle", "TaskHandle"):
        return "handle"
    if source == "ctypes.POINTER(lib_importer.task_handle)":
        return "out handle"
    pointer = re.fullmatch(r"ctypes\.POINTER\((.*)\)", source)
    if pointer:
        return f"out {C_NUMBERS[pointer[1]]}"
    array = re.fullmatch(r"wrapped_ndpointer\(dtype=(.*), flags=(.*)\)", source)
    if array:
        number = array[1].removeprefix("numpy.")
        return f"{'out ' if 'W' in array[2] else ''}array of {number}"
    return C_NUMBERS[source]


def expected(parameter):
    match parameter.role:
        case Role.TEXT:
            return "text"
        case Role.OUT_TEXT:
            return "out text"
        case Role.UNUSED:
            return "out uint32"
    number = "handle" if parameter.scalar is table.HANDLE else NUMBERS[parameter.scalar]
    number = {
        Role.ARRAY: f"array of {number}",
        Role.OUT_ARRAY: f"array of {number}",
    }.get(parameter.role, number)
    return f"out {number}" if parameter.goes_out else number


PAIRS = {"DAQmxSetDigitalPowerUpStates", "DAQmxGetDigitalPowerUpStates"}
"""Their types depend on how many pairs are passed: they are met in `test_library_client`."""


@pytest.mark.parametrize("name", sorted(set(ENTRY_POINTS) - PAIRS))
def test_parameters_are_those_that_nidaqmx_declares(name):
    assert name in DECLARED, "nidaqmx never calls this entry point: it does not belong into the table"
    entry = ENTRY_POINTS[name]
    for types in DECLARED[name]:
        found = [
            # The width of raw samples depends on the array that a caller brings.
            "out array of uint8" if source.startswith("wrapped_ndpointer(dtype=read_array") else kind(source)
            for source in types
        ]
        assert found == [expected(parameter) for parameter in entry.parameters]


@pytest.mark.parametrize("name", sorted(set(ENTRY_POINTS) - PAIRS))
def test_every_size_is_a_parameter(name):
    entry = ENTRY_POINTS[name]
    names = {parameter.name for parameter in entry.parameters}
    assert {parameter.size for parameter in entry.parameters if parameter.size} <= names


def attributes_of_nidaqmx():
    """By number: the families and value types under which the package reads or sets it."""
    found = {}
    call = re.compile(r"_interpreter\.(get|set)_(\w+?)_attribute_(\w+)\([^)]*?(0x[0-9a-fA-F]+)")
    for file in PACKAGE.rglob("*.py"):
        for verb, family, value_type, number in call.findall(file.read_text(encoding="utf-8")):
            found.setdefault(int(number, 16), set()).add((verb, family, value_type))
    return found


USED = attributes_of_nidaqmx()
VALUE_TYPES = {
    ("i", False): {"int32"},
    ("I", False): {"uint32", "bool"},
    ("d", False): {"double"},
    ("d", True): {"double_array"},
}


@pytest.mark.parametrize("attribute", ATTRIBUTES.values(), ids=lambda attribute: attribute.name)
def test_attributes_are_those_that_nidaqmx_asks_for(attribute):
    family = re.sub(r"(?<!^)([A-Z])", r"_\1", attribute.family).lower()
    used = {value_type for _, name, value_type in USED.get(attribute.number, ()) if name == family}
    if attribute.number in (0x1272, 0x1923, 0x2F22):
        # Asked for inside the package's own machinery, in the same way.
        used |= {"uint32"}
    wanted = {"string"}
    if attribute.scalar is not None:
        wanted = VALUE_TYPES[attribute.scalar.packed, attribute.is_array]
    assert used, "nidaqmx never asks for it"
    assert used <= wanted


def test_every_entry_is_answered_and_nothing_else():
    remote = {name for name, entry in ENTRY_POINTS.items() if not entry.local}
    assert sorted([*HANDLERS, *TASK_HANDLERS]) == sorted(remote)


def test_the_c_source_holds_every_entry_once():
    source = library_source("nidaqmx")
    for name, entry in TABLE.items():
        assert source.count(f"int32_t {name}(") == (entry.library == "nidaqmx")


def test_a_variadic_entry_ends_with_the_attribute():
    for entry in ENTRY_POINTS.values():
        if entry.tail in (Tail.GET_ATTRIBUTE, Tail.SET_ATTRIBUTE):
            assert entry.parameters[-1].name == "attribute"
        assert not any("..." in inspect.cleandoc(parameter.name) for parameter in entry.parameters)


@pytest.mark.parametrize("code", TEXTS)
def test_statuses_are_ni_s_numbers_with_texts_for_any_locale(code):
    from nidaqmx.error_codes import DAQmxErrors, DAQmxWarnings

    assert code in {member.value for member in (DAQmxErrors if code < 0 else DAQmxWarnings)}
    assert TEXTS[code].isascii()
