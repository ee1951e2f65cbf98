"""Translation of NI's errors into the four classes that leave the driver.

Each vendor call of this package runs in `translate_errors`. A DAQmx status that ``status_classes.toml`` does
not name is a contradiction in the request: configuration. ``docs/reference/faults-daqmx.md`` lists them.
"""

from __future__ import annotations

import logging
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
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

CLASS_OF_STATUS: Mapping[int, type[InstrumentError]] = read_status_classes(
    Path(__file__).with_name("status_classes.toml"), (AcquisitionTimeoutError, BusyError, ConnectionLostError)
)
"""Class of each DAQmx status that is known; the file holds the meaning of each."""

RPC_CONFIGURATION = frozenset(
    {"UNAUTHENTICATED", "PERMISSION_DENIED", "UNIMPLEMENTED", "RESOURCE_EXHAUSTED", "INVALID_ARGUMENT"}
)
"""gRPC codes that asking again cannot cure; every other one means that the connection is lost."""

_REMEDIES: dict[type[InstrumentError], str] = {
    AcquisitionTimeoutError: "check the striker, its supply and the trigger level",
    BusyError: "end the other program or its task; nothing of it was touched",
    ConnectionLostError: "check power, seating and cable of board and chassis",
    ConfigurationError: "correct the settings of [rig.daqmx] or the wiring",
    UnknownStatusError: "compare the settings of [rig.daqmx] and the wiring with what the board can do",
}
_OWNER = re.compile(r"(?:in use by|reserved by|owned by|owner)\s*:?\s+([^\n]+)", re.IGNORECASE)
_OWNING_TASK = re.compile(r"in use by\s+task name:\s*([^\n]+)", re.IGNORECASE)
_NOISE = re.compile(r"status code: ?-?\d+\.?", re.IGNORECASE)


def find_resource_owner(text: str) -> str:
    """Return the owner of a resource that the driver's text names, the longest name if several; else empty.

    A task that uses the resource takes precedence over other owners.
    """
    named = _OWNING_TASK.findall(text) or _OWNER.findall(text)
    # The driver's own sentence ("reserved by another process") is the shorter one.
    return max((owner.strip(" .'\"") for owner in named), key=len, default="")


def translate_error(error: Exception, doing: str) -> InstrumentError:
    """Return the instrument error for an exception; an InstrumentError is returned as it is.

    An exception that is neither the vendor's nor gRPC's becomes a ConnectionLostError.

    Parameters
    ----------
    doing
        Operation, as the beginning of a sentence: "starting the acquisition of B".
    """
    from nidaqmx import errors as vendor

    if isinstance(error, InstrumentError):
        return error
    if isinstance(error, vendor.DaqError):
        return _build_status_error(error, doing)
    if isinstance(error, vendor.RpcError):
        code = getattr(error.rpc_code, "name", str(error.rpc_code))
        texts = (str(error.description), _get_rpc_reason(error.__context__))
        return _build_rpc_error(code, ": ".join(filter(None, dict.fromkeys(texts))), doing)
    if isinstance(error, vendor.DaqNotFoundError):
        return ConfigurationError(
            f"{doing}: NI-DAQmx is not installed on this computer; install NI's driver, or use a chassis "
            "elsewhere with transport = 'grpc'"
        )
    if isinstance(error, vendor.DaqNotSupportedError):
        return ConfigurationError(
            f"{doing}: NI-DAQmx does not exist for this platform ({sys.platform}); use Windows or Linux, or "
            "a chassis elsewhere with transport = 'grpc'"
        )
    if isinstance(error, vendor.DaqFunctionNotSupportedError):
        return ConfigurationError(f"{doing}: {_join_lines(str(error))}; install a newer NI-DAQmx driver")
    if isinstance(error, vendor.Error | vendor.FeatureNotSupportedError):
        return ConfigurationError(f"{doing}: {_join_lines(str(error))}; {_REMEDIES[ConfigurationError]}")
    if _is_untranslated_rpc_error(error):
        code = error.code() if hasattr(error, "code") else None
        return _build_rpc_error(getattr(code, "name", "UNKNOWN"), _get_rpc_reason(error) or str(error), doing)
    # nidaqmx turns codes into enumerations and texts as it reads them: an answer it cannot is nonsense.
    return ConnectionLostError(
        f"{doing}: the driver's answer makes no sense ({type(error).__name__}: {_join_lines(str(error))}); "
        f"{_REMEDIES[ConnectionLostError]}"
    )


@contextmanager
def translate_errors(doing: str) -> Iterator[None]:
    """Run a block of vendor calls; raise its exceptions as instrument errors, and log the driver's warnings.

    Warnings are caught for the whole process meanwhile, and are not logged after an error. ``doing`` is as in
    `translate_error`.
    """
    caught: list[warnings.WarningMessage]
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield
    except InstrumentError:
        raise
    except Exception as error:
        raise translate_error(error, doing) from error
    for warning in caught:
        log.warning("%s: %s", doing, _join_lines(str(warning.message)))


def read_metadata(read: Callable[[], T], unknown: T, subject: str) -> T:
    """Return optional metadata (date, version) from ``read``; ``unknown``, with a warning, if it fails.

    Raises
    ------
    ConnectionLostError
        The driver reports that the board or itself is gone: that holds for every other call too.
    """
    from nidaqmx.errors import Error

    try:
        with translate_errors(f"reading {subject}"):
            return read()
    except InstrumentError as error:
        if isinstance(error, ConnectionLostError) and isinstance(error.__cause__, Error):
            raise
        log.warning("%s is unknown: %s", subject, error)
        return unknown


def _build_status_error(error: Exception, doing: str) -> InstrumentError:
    """Build the error of a DAQmx status: ``doing``, the driver's text, the owner if busy, and the remedy.

    A status that is not in `CLASS_OF_STATUS` becomes an UnknownStatusError. Nothing is raised.
    """
    status = int(getattr(error, "error_code", 0))
    kind = CLASS_OF_STATUS.get(status, UnknownStatusError)
    name = getattr(getattr(error, "error_type", None), "name", "UNKNOWN")
    text = str(error)
    message = f"{doing}: {_join_lines(text)} (DAQmx {status}, {name})"
    if kind is BusyError:
        message += f"; owner: {find_resource_owner(text) or 'not named by the driver'}"
    return kind(f"{message}; {_REMEDIES[kind]}")


def _get_rpc_reason(error: BaseException | None) -> str:
    """Return the text of gRPC's own error, which NI's package hides; empty if the error has none."""
    return str(getattr(error, "details", str)() or "")


def _build_rpc_error(code: str, text: str, doing: str) -> InstrumentError:
    """Build the error of a gRPC code: ``doing``, code, text and remedy; nothing is raised.

    ConfigurationError for a code in `RPC_CONFIGURATION`, else ConnectionLostError.
    """
    kind = ConfigurationError if code in RPC_CONFIGURATION else ConnectionLostError
    remedy = (
        "check the address, version and rights of the gRPC device server"
        if kind is ConfigurationError
        else "check that the chassis computer and its gRPC device server run and are reachable"
    )
    return kind(f"{doing}: gRPC {code}: {_join_lines(text)}; {remedy}")


def _is_untranslated_rpc_error(error: Exception) -> bool:
    """Return whether an exception is gRPC's own error; False as long as gRPC is not imported."""
    grpc = sys.modules.get("grpc")
    return grpc is not None and isinstance(error, grpc.RpcError)


def _join_lines(text: str) -> str:
    """Return the text as one line, without the driver's status code and a full stop at its end."""
    return " ".join(_NOISE.sub("", text).split()).rstrip(". ")
