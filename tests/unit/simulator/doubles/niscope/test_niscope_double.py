"""The table of NI-SCOPE entry points against what the `niscope` package itself calls."""

import ctypes
import inspect
import struct

import pytest

from simulator.doubles.niscope.device_model import ANSWERED
from simulator.doubles.niscope.pulsers import WAVEFORM_INFO
from simulator.doubles.vendor_api.entry_points import ENTRY_POINTS, Role

niscope = pytest.importorskip("niscope", reason='needs the extra "solimon[niscope]"')
from niscope import _library, waveform_info  # noqa: E402

C_TYPES = {
    "int16_t": ctypes.c_int16,
    "uint16_t": ctypes.c_uint16,
    "int32_t": ctypes.c_int32,
    "uint32_t": ctypes.c_uint32,
    "double": ctypes.c_double,
}
TEXT = ctypes.POINTER(ctypes.c_char)
NISCOPE_ENTRY_POINTS = [entry for entry in ENTRY_POINTS.values() if entry.library == "niScope"]
INFO = ctypes.POINTER(waveform_info.struct_niScope_wfmInfo)


class Function:
    """Substitute for a C function that takes the declared arguments."""

    argtypes: list
    restype: type

    def __call__(self, *_):
        return 0


class Exports:
    """Substitute for the shared library with every function."""

    def __init__(self):
        self.functions = {}

    def __getattr__(self, name):
        return self.functions.setdefault(name, Function())


@pytest.fixture(scope="module")
def declared():
    """Argument types by function, as the package declares them to ctypes."""
    exports = Exports()
    library = _library.Library(exports)
    for name, method in inspect.getmembers(library, inspect.ismethod):
        if name.startswith("niScope_"):
            method(*[None] * len(inspect.signature(method).parameters))
    return {name: (function.argtypes, function.restype) for name, function in exports.functions.items()}


def c_type(parameter):
    match parameter.role:
        case Role.VALUE:
            return C_TYPES[parameter.c_type]
        case Role.TEXT | Role.OUT_TEXT:
            return TEXT
        case Role.OUT | Role.OUT_ARRAY if parameter.c_type in C_TYPES:
            return ctypes.POINTER(C_TYPES[parameter.c_type])
        case Role.OUT_ARRAY:
            return INFO
    return ctypes.POINTER(ctypes.c_uint16)


@pytest.mark.parametrize("entry", NISCOPE_ENTRY_POINTS, ids=lambda entry: entry.name)
def test_parameters_are_those_that_the_package_declares(declared, entry):
    types, restype = declared[entry.name]
    assert [c_type(parameter) for parameter in entry.parameters] == types
    assert restype is ctypes.c_int32


@pytest.mark.parametrize("entry", NISCOPE_ENTRY_POINTS, ids=lambda entry: entry.name)
def test_names_of_parameters_are_the_package_s(entry):
    method = getattr(_library.Library, entry.name)
    names = list(inspect.signature(method).parameters)[1:]
    assert [parameter.name for parameter in entry.parameters] == names


def test_one_waveform_info_is_the_package_s_structure():
    structure = waveform_info.struct_niScope_wfmInfo
    assert struct.calcsize(WAVEFORM_INFO) == ctypes.sizeof(structure)
    packed = struct.pack(WAVEFORM_INFO, 1.0, 2.0, 3.0, 4, 5.0, 6.0, 7.0, 8.0)
    info = structure.from_buffer_copy(packed)
    assert [getattr(info, name) for name, _ in structure._fields_] == [1.0, 2.0, 3.0, 4, 5.0, 6.0, 7.0, 8.0]


def test_every_entry_of_the_table_is_answered():
    assert {entry.name for entry in NISCOPE_ENTRY_POINTS} == ANSWERED
