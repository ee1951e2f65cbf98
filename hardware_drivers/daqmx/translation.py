"""Translation of NI's errors into the four classes that leave the driver.

Every vendor call of this package runs inside `vendor_call`. A DAQmx status that no table below names
is a contradiction in the request: configuration. ``docs/reference/faults-daqmx.md`` lists the tables.
"""

from __future__ import annotations

import logging
import re
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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

MISSED: dict[int, str] = {
    -200284: "samples not yet available: no trigger came",
    -200560: "not done within the wait",
    -200474: "operation timed out",
    -200221: "timeout exceeded",
}
"""Nothing came in time: a missed strike."""

BUSY: dict[int, str] = {
    -50103: "resource reserved",
    -50106: "resource busy",
    -200022: "resource reserved by another task",
    -200043: "routing hardware busy",
    -200118: "port reserved for handshaking",
    -200225: "trigger line reserved",
    -200353: "resources in use for a property",
    -200365: "resources in use for an inversion",
    -200366: "resources in use for an inversion, inside the task",
    -200367: "resources in use for an exported signal",
    -200369: "resources in use for a route",
    -200370: "resources in use for a route, inside the task",
    -200587: "digital lines reserved",
    -200597: "lines reserved for output",
    -201105: "resource reserved with conflicting settings",
    -201273: "network device in use",
    -201352: "reservation conflict",
    -201420: "network device reserved by another host",
    -201476: "a watchdog task holds the board",
    -201477: "other tasks hold the board",
    -89123: "routing hardware busy",
    -89126: "trigger line reserved",
    -89132: "resources in use for a property",
    -89134: "resources in use for an inversion",
    -89135: "resources in use for an inversion, inside the task",
    -89137: "resources in use for a route",
    -89138: "resources in use for a route, inside the task",
}
"""Someone else holds what we need: name the owner, back off, reset nothing."""

LOST: dict[int, str] = {
    -200004: "data overwritten in the board's memory",
    -200006: "record overwritten",
    -200010: "input FIFO overflow",
    -200019: "ADC overrun",
    -200045: "device removed",
    -200088: "task invalid: the driver has forgotten it",
    -200089: "a task of this name is left over",
    -200175: "hardware not responding",
    -200194: "hardware lost its power",
    # Names come from a search by serial number, never from a file: a name that is none has moved on.
    -200220: "device name invalid: the board has gone or has another name",
    -200222: "acquisition stopped before its buffer was overwritten",
    -200246: "clock of the board unlocked",
    -200279: "samples no longer available",
    -200283: "acquisition stopped before its buffer overflowed",
    -200324: "device absent or unavailable",
    -200361: "input FIFO overflow",
    -200613: "acquisition stopped before its buffer was overwritten",
    # Our own sequence never asks for these: the task is not in the state we left it in.
    -200472: "task not running",
    -200473: "task not running",
    -200475: "task not running",
    -200478: "task has no channels",
    -200479: "task running",
    -200488: "channel not in the task",
    -200556: "task not committed",
    -200557: "task running",
    -200664: "task not reserved",
    -200983: "task not reserved",
    -200678: "watchdog expired: outputs are locked",
    -200681: "watchdog expired: routes are locked",
    -200712: "watchdog expired: inputs are locked",
    -201003: "device cannot be accessed",
    -201250: "network device timed out",
    -201251: "network device not found",
    -201252: "network device unreachable",
    -201253: "network device down",
    -201313: "counter did not respond and was reset",
    -201390: "network connection lost",
    -201423: "communication with the chassis interrupted",
    -201434: "watchdog expired: configuration locked",
    -201438: "device restarted itself",
    -201452: "operation aborted",
    -201478: "watchdog of the chassis expired",
    -201504: "reference clock lost",
    -209829: "input FIFO overflow",
    -209838: "synchronisation lost",
    -50101: "resource not available",
    -50150: "software fault below the driver",
    -50151: "firmware fault",
    -50152: "hardware fault",
    -50202: "operating system fault",
    -50300: "device not found",
    -50303: "device initialisation fault",
    -50400: "transfer timed out",
    -50401: "communication fault",
    -50404: "transfer stopped",
    -50405: "transfer aborted",
    -50410: "transfer overwritten",
    -50412: "retry limit exceeded",
    -50413: "bus error",
    -50550: "synchronisation timed out",
    -50800: "bus reset",
    -50801: "connection refused",
    -50802: "connection aborted",
    -50803: "connection reset",
    -50804: "invalid device state",
    -50808: "USB transaction error",
    -88705: "device not found by the router",
    -88708: "resource not in the pool",
    -88709: "task aborted by the driver",
    -88710: "task being aborted by the driver",
    -88717: "device name not found by the router",
    -88900: "driver's server does not answer",
    -88907: "driver's service not available",
    -89130: "device absent or unavailable",
}
"""The board, its driver or the way to it is gone: rebuild, by the bounded ladder."""

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


def class_of(status: int) -> type[InstrumentError]:
    """Return the error class of a DAQmx status below zero."""
    if status in MISSED:
        return AcquisitionTimeoutError
    if status in BUSY:
        return BusyError
    if status in LOST:
        return ConnectionLostError
    return UnknownStatusError


def owner_in(text: str) -> str:
    """Return the owner of a resource if the driver's text names one, else empty."""
    named = _OWNING_TASK.findall(text) or _OWNER.findall(text)
    # The driver's own sentence ("reserved by another process") is the shorter one.
    return max((owner.strip(" .'\"") for owner in named), key=len, default="")


def translated(error: Exception, doing: str) -> InstrumentError:
    """Return the instrument error that a vendor's exception means.

    Parameters
    ----------
    doing
        What was tried, as the beginning of a sentence: "starting the acquisition of B".
    """
    from nidaqmx import errors as vendor

    if isinstance(error, InstrumentError):
        return error
    if isinstance(error, vendor.DaqError):
        return _from_status(error, doing)
    if isinstance(error, vendor.RpcError):
        code = getattr(error.rpc_code, "name", str(error.rpc_code))
        texts = (str(error.description), _grpc_reason(error.__context__))
        return _from_rpc(code, ": ".join(filter(None, dict.fromkeys(texts))), doing)
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
        return ConfigurationError(f"{doing}: {_one_line(str(error))}; install a newer NI-DAQmx driver")
    if isinstance(error, vendor.Error | vendor.FeatureNotSupportedError):
        return ConfigurationError(f"{doing}: {_one_line(str(error))}; {_REMEDIES[ConfigurationError]}")
    if _is_bare_rpc_error(error):
        code = error.code() if hasattr(error, "code") else None
        return _from_rpc(getattr(code, "name", "UNKNOWN"), _grpc_reason(error) or str(error), doing)
    # nidaqmx turns codes into enumerations and texts as it reads them: an answer it cannot is nonsense.
    return ConnectionLostError(
        f"{doing}: the driver's answer makes no sense ({type(error).__name__}: {_one_line(str(error))}); "
        f"{_REMEDIES[ConnectionLostError]}"
    )


@contextmanager
def vendor_call(doing: str) -> Iterator[None]:
    """Translate what a vendor's call raises; log the driver's warnings instead of printing them."""
    caught: list[warnings.WarningMessage]
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield
    except InstrumentError:
        raise
    except Exception as error:
        raise translated(error, doing) from error
    for warning in caught:
        log.warning("%s: %s", doing, _one_line(str(warning.message)))


def metadata(read: Callable[[], T], unknown: T, subject: str) -> T:
    """Read optional metadata (date, temperature, version); unknown, with a warning, is enough.

    Raises
    ------
    ConnectionLostError
        The driver says that the board or itself is gone: that holds for every other call too.
    """
    from nidaqmx.errors import Error

    try:
        with vendor_call(f"reading {subject}"):
            return read()
    except InstrumentError as error:
        if isinstance(error, ConnectionLostError) and isinstance(error.__cause__, Error):
            raise
        log.warning("%s is unknown: %s", subject, error)
        return unknown


def _from_status(error: Exception, doing: str) -> InstrumentError:
    status = int(getattr(error, "error_code", 0))
    kind = class_of(status)
    name = getattr(getattr(error, "error_type", None), "name", "UNKNOWN")
    text = str(error)
    message = f"{doing}: {_one_line(text)} (DAQmx {status}, {name})"
    if kind is BusyError:
        message += f"; owner: {owner_in(text) or 'not named by the driver'}"
    return kind(f"{message}; {_REMEDIES[kind]}")


def _grpc_reason(error: BaseException | None) -> str:
    """Return gRPC's own words, which NI's package hides behind "Failed to connect to server"."""
    return str(getattr(error, "details", str)() or "")


def _from_rpc(code: str, text: str, doing: str) -> InstrumentError:
    kind = ConfigurationError if code in RPC_CONFIGURATION else ConnectionLostError
    remedy = (
        "check the address, version and rights of the gRPC device server"
        if kind is ConfigurationError
        else "check that the chassis computer and its gRPC device server run and are reachable"
    )
    return kind(f"{doing}: gRPC {code}: {_one_line(text)}; {remedy}")


def _is_bare_rpc_error(error: Exception) -> bool:
    grpc = sys.modules.get("grpc")
    return grpc is not None and isinstance(error, grpc.RpcError)


def _one_line(text: str) -> str:
    """Return text without line breaks, status line (reported apart) and the full stop at its end."""
    return " ".join(_NOISE.sub("", text).split()).rstrip(". ")
