"""Translation of NI-SCOPE's errors into the four classes of `hardware_drivers.errors`.

``status_classes.toml`` holds the class of each status. Newer boards run on NI-DAQmx's kernel and wrap its
status as ``Status Code: -nnn`` in the text: a wrapped status has a class of its own.
``docs/reference/faults-niscope.md`` describes the consequence of each.
"""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from hardware_drivers.errors import (
    AcquisitionTimeoutError,
    BusyError,
    ConfigurationError,
    ConnectionLostError,
    InstrumentError,
    UnknownStatusError,
)
from hardware_drivers.status_classes import read_status_classes

log = logging.getLogger(__name__)

T = TypeVar("T")


class BoardAbsentError(ConnectionLostError):
    """Error: the requested board is absent, or another one has its name."""


CLASS_OF_CODE: Mapping[int, type[InstrumentError]] = read_status_classes(
    Path(__file__).with_name("status_classes.toml"),
    (AcquisitionTimeoutError, BusyError, BoardAbsentError, ConnectionLostError),
)
"""Class of each status of NI-SCOPE and of the kernel below; every other one is an `UnknownStatusError`."""

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


def find_error_class(code: int, description: str) -> type[InstrumentError]:
    """Return the error class of NI-SCOPE's status code, else that of a status wrapped in its description.

    `UnknownStatusError` if none of them is in `CLASS_OF_CODE`.
    """
    codes = (code, *map(int, _WRAPPED.findall(description)))
    return next((CLASS_OF_CODE[number] for number in codes if number in CLASS_OF_CODE), UnknownStatusError)


def translate_error(niscope: ModuleType, error: Exception, doing: str) -> InstrumentError:
    """Return the instrument error for an exception; it is not raised here.

    An exception that is not one of the `niscope` package's becomes a ConnectionLostError.

    Parameters
    ----------
    doing
        Operation, as the beginning of a sentence: "opening 'PXI1Slot4'".
    """
    if isinstance(error, niscope.errors.DriverError):
        kind = find_error_class(error.code, error.description)
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
def translate_errors(niscope: ModuleType, doing: str) -> Iterator[list[str]]:
    """Run a block of vendor calls and raise their errors as instrument errors.

    Yield a list that has the driver's warnings, each once, after the block. The warnings filter of the
    process is changed meanwhile: the driver is used by one thread.

    Raises
    ------
    InstrumentError
        One of the four classes, from the vendor's exception.
    """
    driver_warnings: list[str] = []
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always", niscope.errors.DriverWarning)
        try:
            yield driver_warnings
        except InstrumentError:
            raise
        except (niscope.errors.Error, *_NONSENSE) as error:
            raise translate_error(niscope, error, doing) from error
        finally:
            for warning in seen:
                message = " ".join(str(warning.message).split())
                if (
                    issubclass(warning.category, niscope.errors.DriverWarning)
                    and message not in driver_warnings
                ):
                    driver_warnings.append(message)
    for warning in seen:
        if not issubclass(warning.category, niscope.errors.DriverWarning):
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)


def read_metadata(niscope: ModuleType, read: Callable[[], T], unknown: T, subject: str) -> T:
    """Return optional metadata (date, temperature) from ``read``; ``unknown``, with a warning, if it fails.

    Raises
    ------
    ConnectionLostError
        The driver reports that the board is gone: that holds for every other call too.
    """
    try:
        with translate_errors(niscope, f"reading {subject}"):
            return read()
    except InstrumentError as error:
        if isinstance(error, ConnectionLostError) and isinstance(error.__cause__, niscope.errors.Error):
            raise
        log.warning("%s is unknown: %s", subject, error)
        return unknown
