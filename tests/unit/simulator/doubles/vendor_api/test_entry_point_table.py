"""The table of entry points against what `nidaqmx` itself calls."""

import ast
import inspect
import re
from pathlib import Path

import pytest

from simulator import doubles
from simulator.doubles.device_model import HANDLERS, TASK_HANDLERS
from simulator.doubles.transports.c_source import generate_library_source
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.attributes import ATTRIBUTES
from simulator.doubles.vendor_api.entry_points import ENTRY_POINTS, HANDLE, Role, Tail

nidaqmx = pytest.importorskip("nidaqmx")
PACKAGE = Path(nidaqmx.__file__).parent

OF_DAQMX = {name: entry for name, entry in ENTRY_POINTS.items() if entry.library == "nidaqmx"}
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
    c_type = parameter.c_type.removesuffix("_t")
    number = {HANDLE: "handle", "double": "float64"}.get(c_type, c_type)
    if parameter.role in (Role.ARRAY, Role.OUT_ARRAY):
        number = f"array of {number}"
    return f"out {number}" if parameter.goes_out else number


PAIRS = {"DAQmxSetDigitalPowerUpStates", "DAQmxGetDigitalPowerUpStates"}
"""Their types depend on how many pairs are passed: they are met in `test_library_client`."""


@pytest.mark.parametrize("name", sorted(set(OF_DAQMX) - PAIRS))
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


@pytest.mark.parametrize("name", sorted(set(OF_DAQMX) - PAIRS))
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
    ("int32_t", False): {"int32"},
    ("uint32_t", False): {"uint32", "bool"},
    ("double", False): {"double"},
    ("double", True): {"double_array"},
    ("char", False): {"string"},
}


@pytest.mark.parametrize("attribute", ATTRIBUTES.values(), ids=lambda attribute: attribute.name)
def test_attributes_are_those_that_nidaqmx_asks_for(attribute):
    family = re.sub(r"(?<!^)([A-Z])", r"_\1", attribute.family).lower()
    used = {value_type for _, name, value_type in USED.get(attribute.number, ()) if name == family}
    if attribute.number in (0x1272, 0x1923, 0x2F22):
        # Asked for inside the package's own machinery, in the same way.
        used |= {"uint32"}
    assert used, "nidaqmx never asks for it"
    assert used <= VALUE_TYPES[attribute.c_type, attribute.is_array]


def test_every_entry_is_answered_and_nothing_else():
    assert sorted([*HANDLERS, *TASK_HANDLERS]) == sorted(OF_DAQMX)


def test_the_c_source_holds_every_entry_once():
    source = generate_library_source("nidaqmx")
    for name, entry in ENTRY_POINTS.items():
        assert source.count(f"int32_t {name}(") == (entry.library == "nidaqmx")


def test_a_variadic_entry_ends_with_the_attribute():
    for entry in ENTRY_POINTS.values():
        if entry.tail in (Tail.GET_ATTRIBUTE, Tail.SET_ATTRIBUTE):
            assert entry.parameters[-1].name == "attribute"
        assert not any("..." in inspect.cleandoc(parameter.name) for parameter in entry.parameters)


def test_every_entry_of_the_headers_is_read():
    headers = "".join(path.read_text("utf-8") for path in Path(statuses.__file__).parent.glob("*.h"))
    assert len(ENTRY_POINTS) == headers.count(");")
    for entry in ENTRY_POINTS.values():
        assert len(entry.parameters) == entry.declared.count(",") + (entry.tail is Tail.NONE), entry.name


@pytest.mark.parametrize("name", statuses.CODES)
def test_statuses_are_ni_s_numbers_with_texts_for_any_locale(name):
    from nidaqmx.error_codes import DAQmxErrors, DAQmxWarnings

    code = statuses.CODES[name]
    known = {member.value for member in (DAQmxErrors if code < 0 else DAQmxWarnings)}
    assert name.startswith("SCOPE_") or code in known
    assert statuses.TEXTS[code].isascii()


def test_every_status_in_the_code_is_in_the_table():
    source = "".join(path.read_text("utf-8") for path in Path(doubles.__file__).parent.rglob("*.py"))
    used = set(re.findall(r"\bstatuses\.([A-Z_]{3,})", source)) - {"TEXTS", "CODES"}
    assert used == set(statuses.CODES)
    with pytest.raises(AttributeError, match="has no status 'UNKNOWN'"):
        statuses.UNKNOWN  # noqa: B018
