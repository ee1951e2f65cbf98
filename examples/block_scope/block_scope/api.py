"""The maker's C library: its functions, status codes and constants, as its manual gives them.

Each function takes the handle of an open unit and returns a status; what it returns it writes where a pointer
points. Samples are 16 bit whatever the resolution: fewer bits stand in the upper ones.
"""

from __future__ import annotations

import ctypes
import ctypes.util
from ctypes import POINTER, c_char, c_char_p, c_int16, c_int32, c_uint32
from enum import IntEnum
from typing import Any

from hardware_drivers.errors import ConfigurationError


class Status(IntEnum):
    """Status of a call."""

    OK = 0x00
    NOT_FOUND = 0x03
    NOT_RESPONDING = 0x07
    INVALID_HANDLE = 0x0C
    INVALID_PARAMETER = 0x0D
    INVALID_TIMEBASE = 0x0E
    NO_SAMPLES_AVAILABLE = 0x25
    BUSY = 0x27
    OPENED_ELSEWHERE = 0x2D


RANGES_MV = (500, 1000, 2000, 5000, 10000, 20000)
"""Input ranges, by their number."""
CHANNELS = ("A", "B", "C", "D")
"""Inputs, by their number."""
RISING, FALLING = 2, 3
NEVER = 0
"""Milliseconds after which a block triggers itself."""
SERIAL, MODEL, LIBRARY_VERSION, CALIBRATION_DATE = range(4)
"""What `bs_get_unit_info` can be asked."""

PROTOTYPES: dict[str, tuple[Any, ...]] = {
    "bs_open_unit": (POINTER(c_int16), c_char_p, c_int32),
    "bs_close_unit": (c_int16,),
    "bs_get_unit_info": (c_int16, POINTER(c_char), c_int16, c_uint32),
    "bs_maximum_value": (c_int16, POINTER(c_int16)),
    "bs_get_timebase": (c_int16, c_uint32, POINTER(c_int32)),
    "bs_set_channel": (c_int16, c_int32, c_int16, c_int32),
    "bs_set_simple_trigger": (c_int16, c_int32, c_int16, c_int32, c_int16),
    "bs_run_block": (c_int16, c_int32, c_int32, c_uint32),
    "bs_is_ready": (c_int16, POINTER(c_int16)),
    "bs_get_values": (c_int16, POINTER(c_int16), POINTER(c_uint32), POINTER(c_int16)),
    "bs_stop": (c_int16,),
}
"""Arguments of each function; every one returns a status."""


def load(name: str) -> Any:
    """Load the library.

    Raises
    ------
    ConfigurationError
        It is not installed.
    """
    path = ctypes.util.find_library(name) or name
    try:
        library = ctypes.CDLL(path)
        for function, arguments in PROTOTYPES.items():
            entry = getattr(library, function)
            entry.argtypes, entry.restype = arguments, c_uint32
    except (OSError, AttributeError) as error:
        raise ConfigurationError(
            f"the oscilloscope's library {name!r} cannot be used ({error}); install its maker's driver, or "
            "give the library's path"
        ) from error
    return library
