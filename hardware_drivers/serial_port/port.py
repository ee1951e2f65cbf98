"""Ports of an instrument: serial ports, TCP sockets and VISA resources behind the calls of pyserial.

A serial port is found by its path or by its adapter's USB serial number and opened for one owner; its errors
are explained.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import sys
from pathlib import Path
from typing import Protocol

import serial
from serial.tools import list_ports

from hardware_drivers.errors import BusyError, ConfigurationError, ConnectionLostError, InstrumentError
from hardware_drivers.serial_port.parameters import (
    POLL_S,
    TCP_PREFIX,
    USB_SERIAL_PREFIX,
    VISA_PREFIX,
    SerialLineParameters,
)

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


class Port(Protocol):
    """Port as needed by a line, as in `serial.Serial`; all its errors are among `PORT_ERRORS`."""

    @property
    def in_waiting(self) -> int:
        """Return the number of bytes that can be read at once; an upper bound where that is unknown."""

    def read(self, size: int, /) -> bytes:
        """Wait up to `POLL_S` for data; return up to ``size`` bytes, empty if none came.

        Raise one of `PORT_ERRORS` if the port is gone.
        """

    def write(self, data: bytes, /) -> int | None:
        """Write all of the data; raise one of `PORT_ERRORS` at the write timeout or if the port is gone."""

    def reset_input_buffer(self) -> None:
        """Discard the received data without waiting; raise one of `PORT_ERRORS` if the port is gone."""

    def reset_output_buffer(self) -> None:
        """Discard the data that was not sent yet; raise one of `PORT_ERRORS` if the port is gone."""

    def close(self) -> None:
        """Close the port; raise one of `PORT_ERRORS` if that fails."""


class TcpPort:
    """Socket of an instrument on the network. TCP does not exclude other programs."""

    in_waiting = 65_536
    """A socket gives what there is."""

    def __init__(self, address: tuple[str, int], timeout_s: float) -> None:
        """Connect within ``timeout_s`` (s), which also limits each write; OSError if that fails."""
        self._timeout_s = timeout_s
        self._socket = socket.create_connection(address, timeout_s)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def read(self, size: int) -> bytes:
        """Return up to ``size`` bytes received within `POLL_S`, empty if none came.

        Raise ConnectionResetError if the instrument has closed the connection, OSError if it is lost.
        """
        self._socket.settimeout(POLL_S)
        try:
            return self._receive(size)
        except TimeoutError:
            return b""

    def write(self, data: bytes) -> None:
        """Write all of the data; TimeoutError after the reply timeout, OSError if the connection is lost."""
        self._socket.settimeout(self._timeout_s)
        self._socket.sendall(data)

    def reset_input_buffer(self) -> None:
        """Discard the received data without waiting; ConnectionResetError if the connection was closed."""
        self._socket.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                self._receive(self.in_waiting)

    def reset_output_buffer(self) -> None:
        """Do nothing: data is never queued here."""

    def close(self) -> None:
        """Close the connection; repeated calls have no effect."""
        self._socket.close()

    def _receive(self, size: int) -> bytes:
        """Receive up to ``size`` bytes within the socket's timeout.

        Raise ConnectionResetError if the instrument has closed the connection, other OSErrors as the socket
        does.
        """
        if not (data := self._socket.recv(size)):
            raise ConnectionResetError(errno.ECONNRESET, "the instrument hung up")
        return data


def open_port(parameters: SerialLineParameters) -> Port:
    """Open the serial port, TCP socket or VISA resource that the parameters name, and return it.

    A TCP connection is waited for up to the reply timeout.

    Raises
    ------
    BusyError
        Another program owns it.
    ConfigurationError
        No right to open it, nothing of the kind, a package that is not installed, or parameters it cannot do.
    ConnectionLostError
        It is not there now.
    """
    if parameters.port.startswith(VISA_PREFIX):
        from hardware_drivers.serial_port.visa_port import VisaPort  # only where one is asked for

        return VisaPort(parameters.port.removeprefix(VISA_PREFIX), parameters)
    if parameters.port.startswith(TCP_PREFIX):
        try:
            return TcpPort(parameters.address, parameters.reply_timeout_s)
        except OSError as error:
            raise ConnectionLostError(
                f"{parameters.port} takes no connection ({error}); check that the instrument is on, its "
                "address and port, and the network between"
            ) from error
    return _open_serial_port(parameters)


def _open_serial_port(parameters: SerialLineParameters) -> Port:
    """Open a serial port for this process alone; reads on it wait up to `POLL_S`.

    Raises
    ------
    BusyError
        Another program owns it.
    ConfigurationError
        No right to open it, no serial port, or parameters it cannot do.
    ConnectionLostError
        It is not there now.
    """
    path = _find_port_path(parameters.port)
    try:
        port: Port = serial.Serial(
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
        return port
    except ValueError as error:
        raise ConfigurationError(
            f"{path} cannot be opened as configured: {error}; correct the line's parameters"
        ) from error
    except PORT_ERRORS as error:
        raise _explain_open_error(path, error) from error


def list_serial_ports() -> dict[str, str]:
    """List the serial ports of this computer, sorted by device: name, and device with description.

    The name is ``serial:`` with the adapter's serial number, else that of the device.
    """
    ports = {}
    for info in sorted(list_ports.comports()):
        name = f"{USB_SERIAL_PREFIX}{info.serial_number}" if info.serial_number else info.device
        ports[name] = f"{info.device}: {info.description}"
    return ports


def _find_port_path(port: str) -> str:
    """Return the path of a configured port; one named ``serial:NUMBER`` is searched at every call.

    Raise ConnectionLostError if no adapter has that serial number, ConfigurationError if several have.
    """
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
        ports = ", ".join(f"{info.device} ({info.serial_number})" for info in found if info.serial_number)
        raise ConnectionLostError(
            f"no serial port has the USB serial number {wanted}; found: {ports or 'none'}; check the plug"
        )
    return str(paths[0])


def _explain_open_error(path: str, error: Exception) -> InstrumentError:
    """Build the instrument error that explains why a serial port could not be opened; it is not raised.

    BusyError if it is in use, ConfigurationError without the right or for no serial port, else
    ConnectionLostError, as the reason may be temporary.
    """
    code = getattr(error, "errno", None)
    if code is None and error.__context__ is not None and error.__context__.args:
        code = error.__context__.args[0]  # pyserial raises again without the number
    reason = os.strerror(code) if isinstance(code, int) else str(error)
    # On Windows pyserial gives only the text of the system's error.
    if code in _BUSY or (sys.platform == "win32" and "PermissionError" in reason):
        return BusyError(f"{path} is in use by {_find_port_owners(path)}; stop it, or give another port")
    if code in _FORBIDDEN:
        return ConfigurationError(
            f"no right to open {path} ({reason}); add this user to the group that owns it (often dialout), "
            "then log in again"
        )
    if code in _NO_PORT or Path(path).is_file():
        return ConfigurationError(
            f"{path} is no serial port, or not one for these parameters ({reason}); correct them"
        )
    ports = ", ".join(info.device for info in list_ports.comports())
    return ConnectionLostError(
        f"{path} cannot be opened ({reason}); ports there: {ports or 'none'}; check plug and port"
    )


def _find_port_owners(path: str) -> str:
    """Return command and process number of the programs that have the port open, as one text.

    They are read from `/proc`: ``another program`` where that is missing, or they are another user's.
    """
    owners = []
    device = os.path.realpath(path)
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it ended meanwhile, or is another user's
            if any(os.path.realpath(fd) == device for fd in (process / "fd").iterdir()):
                command = (process / "comm").read_text(encoding="utf-8", errors="replace").strip()
                owners.append(f"{command} (process {process.name})")
    return ", ".join(sorted(owners)) or "another program"
