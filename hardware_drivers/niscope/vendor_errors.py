"""Translation of NI-SCOPE's errors into the four classes of `hardware_drivers.errors`.

Codes are those of NI's header ``niScope.h`` (IVI base 0xBFFA0000, IVI class 0x2000, NI-SCOPE 0x4000).
Newer boards run on NI-DAQmx's kernel and wrap its status as ``Status Code: -nnn`` in the text: a wrapped
code is assessed by its own table. ``docs/reference/faults-niscope.md`` says what follows from each.
"""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType, ModuleType
from typing import TypeVar

from hardware_drivers.errors import (
    AcquisitionTimeoutError,
    BusyError,
    ConfigurationError,
    ConnectionLostError,
    InstrumentError,
    UnknownStatusError,
)

log = logging.getLogger(__name__)

T = TypeVar("T")

_IVI_ERROR = -0x40060000  # 0xBFFA0000 as a signed 32-bit number

RESOURCE_UNKNOWN = _IVI_ERROR + 0x0060
SYNCHRONISATION_TIMEOUT = -1074108967
"""An internal lock of the driver was not free in time (wraps -50550)."""

_NO_TRIGGER = (0x2003, 0x4015, 0x4016)  # waited too long, record not acquired, no trigger
_IN_USE = (0x402E,)
_GONE = (
    *(0x0000, 0x0001, 0x005D, 0x1190),  # cannot recover, instrument status, status not available, session
    *(0x4001, 0x4002, 0x4004),  # software, hardware, data invalid
    *(0x4009, 0x400A, 0x400E, 0x4018),  # acquisition in progress, no data, no thread, overwritten
    *(0x401B, 0x401C, 0x401D, 0x401E, 0x401F, 0x4020, 0x4023),  # transfers, PLL, converter, DMA, counter
    *(0x402A, 0x4030, 0x4031, 0x4039),  # not initiated, library, address, self-calibration
)


class BoardAbsentError(ConnectionLostError):
    """Error: the requested board is absent, or another one has its name."""


CLASS_OF_CODE: Mapping[int, type[InstrumentError]] = MappingProxyType(
    {
        **{_IVI_ERROR + offset: AcquisitionTimeoutError for offset in _NO_TRIGGER},
        **{_IVI_ERROR + offset: BusyError for offset in _IN_USE},
        **{_IVI_ERROR + offset: ConnectionLostError for offset in _GONE},
        RESOURCE_UNKNOWN: BoardAbsentError,
        SYNCHRONISATION_TIMEOUT: ConnectionLostError,
    }
)
"""Class of each code of NI-SCOPE; every other negative code is an `UnknownStatusError`."""

_KERNEL_GONE = (
    *(-50101, -50150, -50151, -50152, -50202, -50300, -50303),  # not available, software, firmware, hardware
    *(-50400, -50401, -50404, -50405, -50410, -50412, -50413, -50550),  # transfers, bus, synchronisation
    *(-50800, -50801, -50802, -50803, -50804, -50808),  # bus reset, connection, device state, USB
    *(-88705, -88708, -88709, -88710, -88717, -89130),  # not found, not in the pool, aborted, absent
    *(-200010, -200019, -200088, -200279, -200324, -200361, -201003),  # overflow, invalid task, absent
)

CLASS_OF_KERNEL_CODE: Mapping[int, type[InstrumentError]] = MappingProxyType(
    {
        **dict.fromkeys((-200284, -200560), AcquisitionTimeoutError),
        **dict.fromkeys((-50103, -50106, -89137, -200022, -201105, -201352), BusyError),
        **dict.fromkeys(_KERNEL_GONE, ConnectionLostError),
    }
)
"""Class of a code of the kernel below NI-SCOPE, wrapped in the text or handed through."""

_WRAPPED = re.compile(r"Status Code:\s*(-?\d+)")

_NONSENSE = (ValueError, TypeError, AssertionError, ArithmeticError, LookupError)
"""What the package raises of its own on answers that it cannot make sense of."""

_REMEDY: Mapping[type[InstrumentError], str] = {
    AcquisitionTimeoutError: "check that the pulser fires and that its sync reaches the trigger input",
    BusyError: "close the other program that uses the board (a soft front panel?)",
    BoardAbsentError: "compare its name and serial number with NI MAX or `nilsdev`",
    ConnectionLostError: "the board is opened again at the next record",
    ConfigurationError: "compare [rig.niscope] with what the board can do",
}


class DriverWarnings:
    """Warnings of the driver during vendor calls: an overload, an unlocked clock."""

    def __init__(self) -> None:
        self.messages: list[str] = []

    def text(self) -> str:
        """Return all warnings on one line, each once."""
        return "; ".join(dict.fromkeys(" ".join(message.split()) for message in self.messages))


def class_of(code: int, description: str) -> type[InstrumentError]:
    """Return the class of a driver's error."""
    codes = (code, *map(int, _WRAPPED.findall(description)))
    known = (CLASS_OF_CODE.get(number) or CLASS_OF_KERNEL_CODE.get(number) for number in codes)
    return next((kind for kind in known if kind is not None), UnknownStatusError)


def translated(niscope: ModuleType, error: Exception, doing: str) -> InstrumentError:
    """Translate an exception of the `niscope` package.

    Parameters
    ----------
    doing
        What was tried, beginning a sentence: "opening 'PXI1Slot4'".
    """
    if isinstance(error, niscope.errors.DriverError):
        kind = class_of(error.code, error.description)
        detail = " ".join(error.description.split()) or "no description"
        remedy = next(text for base, text in _REMEDY.items() if issubclass(kind, base))
        return kind(f"{doing}: NI-SCOPE error {error.code}: {detail}; {remedy}")
    if isinstance(error, niscope.errors.DriverTooOldError | niscope.errors.UnsupportedConfigurationError):
        return ConfigurationError(f"{doing}: {error}")
    # What is left are answers that the package itself cannot make sense of: an unknown value, no waveform.
    return ConnectionLostError(
        f"{doing}: NI-SCOPE answered nonsense ({type(error).__name__}: {error}); "
        f"{_REMEDY[ConnectionLostError]}"
    )


@contextmanager
def vendor_calls(niscope: ModuleType, doing: str) -> Iterator[DriverWarnings]:
    """Translate errors of the calls inside and collect the driver's warnings.

    The warnings filter of the process is changed meanwhile: the driver is used by one thread.

    Raises
    ------
    InstrumentError
        One of the four classes, from the vendor's exception.
    """
    driver_warnings = DriverWarnings()
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always", niscope.errors.DriverWarning)
        try:
            yield driver_warnings
        except InstrumentError:
            raise
        except (niscope.errors.Error, *_NONSENSE) as error:
            raise translated(niscope, error, doing) from error
        finally:
            for warning in seen:
                if issubclass(warning.category, niscope.errors.DriverWarning):
                    driver_warnings.messages.append(str(warning.message))
    for warning in seen:
        if not issubclass(warning.category, niscope.errors.DriverWarning):
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)


def metadata(niscope: ModuleType, read: Callable[[], T], unknown: T, subject: str) -> T:
    """Read optional metadata (date, temperature); unknown, with a warning, is enough.

    Raises
    ------
    ConnectionLostError
        The driver says that the board is gone: that holds for every other call too.
    """
    try:
        with vendor_calls(niscope, f"reading {subject}"):
            return read()
    except InstrumentError as error:
        if isinstance(error, ConnectionLostError) and isinstance(error.__cause__, niscope.errors.Error):
            raise
        log.warning("%s is unknown: %s", subject, error)
        return unknown
