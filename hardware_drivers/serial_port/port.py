"""Serial ports: found by path or by USB serial number, opened for one owner, their errors explained."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from pathlib import Path

import serial
from serial.tools import list_ports

from hardware_drivers.errors import BusyError, ConfigurationError, ConnectionLostError, InstrumentError
from hardware_drivers.serial_port.parameters import USB_SERIAL_PREFIX, SerialLineParameters

POLL_S = 0.05
"""Granularity of a reply's deadline; a reply that has come is read at once."""

try:
    import termios

    PORT_ERRORS: tuple[type[Exception], ...] = (OSError, termios.error)
except ImportError:  # Windows has no termios
    PORT_ERRORS = (OSError,)
"""What a port raises when it is gone, depending on the call: serial.SerialException is an OSError,
termios.error is not."""

_PARITY = {"none": serial.PARITY_NONE, "even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD}
_BUSY = {errno.EAGAIN, errno.EWOULDBLOCK, errno.EBUSY}
_FORBIDDEN = {errno.EACCES, errno.EPERM}
_NO_PORT = {errno.ENOTTY, errno.EISDIR, errno.EINVAL, errno.ELOOP}


def open_port(parameters: SerialLineParameters) -> serial.Serial:
    """Open a port for this process alone.

    Raises
    ------
    BusyError
        Another program owns it.
    ConfigurationError
        No right to open it, no serial port, or parameters it cannot do.
    ConnectionLostError
        It is not there now.
    """
    path = _path_of(parameters.port)
    try:
        return serial.Serial(
            port=path,
            baudrate=parameters.baud_rate,
            bytesize=parameters.data_bits,
            parity=_PARITY[parameters.parity],
            stopbits=parameters.stop_bits,
            xonxoff=parameters.flow_control == "xon_xoff",
            rtscts=parameters.flow_control == "rts_cts",
            dsrdtr=parameters.flow_control == "dsr_dtr",
            timeout=POLL_S,
            write_timeout=parameters.reply_timeout_s,
            exclusive=True,
        )
    except ValueError as error:
        raise ConfigurationError(
            f"{path} cannot be opened as configured: {error}; correct the line's parameters"
        ) from error
    except PORT_ERRORS as error:
        raise _explained(path, error) from error


def _path_of(port: str) -> str:
    """Path of a port; one named by its adapter's serial number is looked for every time."""
    if not port.startswith(USB_SERIAL_PREFIX):
        return port
    wanted = port.removeprefix(USB_SERIAL_PREFIX)
    found = list(list_ports.comports())
    paths = [info.device for info in found if info.serial_number == wanted]
    if len(paths) > 1:
        raise ConfigurationError(
            f"{len(paths)} ports have the USB serial number {wanted}: {', '.join(paths)}; give a path instead"
        )
    if not paths:
        there = ", ".join(f"{info.device} ({info.serial_number})" for info in found if info.serial_number)
        raise ConnectionLostError(
            f"no serial port has the USB serial number {wanted}; found: {there or 'none'}; check the plug"
        )
    return str(paths[0])


def _explained(path: str, error: Exception) -> InstrumentError:
    """Say why a port could not be opened; what may pass by itself is no configuration error."""
    code = getattr(error, "errno", None)
    if code is None and error.__context__ is not None and error.__context__.args:
        code = error.__context__.args[0]  # pyserial raises again without the number
    reason = os.strerror(code) if isinstance(code, int) else str(error)
    # On Windows pyserial gives only the text of the system's error.
    if code in _BUSY or (sys.platform == "win32" and "PermissionError" in reason):
        return BusyError(f"{path} is in use by {_owners(path)}; stop it, or give another port")
    if code in _FORBIDDEN:
        return ConfigurationError(
            f"no right to open {path} ({reason}); add this user to the group that owns it (often dialout), "
            "then log in again"
        )
    if code in _NO_PORT or Path(path).is_file():
        return ConfigurationError(
            f"{path} is no serial port, or not one for these parameters ({reason}); correct them"
        )
    there = ", ".join(info.device for info in list_ports.comports())
    return ConnectionLostError(
        f"{path} cannot be opened ({reason}); ports there: {there or 'none'}; check plug and port"
    )


def _owners(path: str) -> str:
    """Programs that have the port open, as far as this system tells."""
    owners = []
    device = os.path.realpath(path)
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it ended meanwhile, or is another user's
            if any(os.path.realpath(fd) == device for fd in (process / "fd").iterdir()):
                command = (process / "comm").read_text(encoding="utf-8", errors="replace").strip()
                owners.append(f"{command} (process {process.name})")
    return ", ".join(sorted(owners)) or "another program"
