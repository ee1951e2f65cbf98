"""A VISA resource as a port: USB-TMC, GPIB and LAN, through pyvisa.

pyvisa takes the vendor's VISA library where there is one, and else pyvisa-py, which needs none. Only a
socket (``TCPIP::...::SOCKET``) has been tried, against a double; USB-TMC, GPIB, VXI-11 and HiSLIP have not.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from hardware_drivers.errors import BusyError, ConfigurationError, ConnectionLostError
from hardware_drivers.serial_port.parameters import POLL_S, SerialLineParameters

try:
    import pyvisa
    from pyvisa.constants import ResourceAttribute, StatusCode
    from pyvisa.resources import MessageBasedResource
except ImportError as error:
    raise ConfigurationError(
        f'a visa: line needs {error.name}, which is not installed: python -m pip install "solimon[visa]"'
    ) from error


class VisaPort:
    """Open VISA resource.

    A socket is a stream like a serial line, read in pieces of `POLL_S`. The other kinds send whole messages,
    and a read that is given up costs more there: they are read with the whole of the reply's time, which
    may pass the caller's deadline once by as much, and cleared after a reply that did not come.

    Raises
    ------
    BusyError
        Another program has locked it.
    ConfigurationError
        There is no such kind of resource, or a part of its way is not installed.
    ConnectionLostError
        It is not there now.
    """

    in_waiting = 65_536
    """A resource gives what there is."""

    def __init__(self, name: str, parameters: SerialLineParameters) -> None:
        """Open the resource within the reply timeout; raise as the class describes."""
        self._streams = name.upper().endswith("::SOCKET")
        self._wait_ms = 1e3 * (POLL_S if self._streams else parameters.reply_timeout_s)
        self._write_ms = 1e3 * parameters.reply_timeout_s
        self._owes_an_answer = False
        try:
            manager = pyvisa.ResourceManager()
        except (OSError, ValueError) as error:
            raise ConfigurationError(
                f"{name}: the VISA library cannot be loaded ({' '.join(str(error).split())}); install one, "
                "or correct the variable PYVISA_LIBRARY"
            ) from error
        try:
            resource = manager.open_resource(name, open_timeout=round(self._write_ms))
        except pyvisa.VisaIOError as error:
            if error.error_code in {StatusCode.error_resource_busy, StatusCode.error_resource_locked}:
                raise BusyError(f"{name} is in use by another program ({error}); stop it") from error
            if error.error_code in {StatusCode.error_resource_not_found, StatusCode.error_timeout}:
                raise ConnectionLostError(f"{name} is not there ({error}); check cable and power") from error
            raise ConfigurationError(f"{name} cannot be opened: {error}") from error
        except ValueError as error:
            raise ConfigurationError(f"{name} cannot be opened: {error}; give a VISA resource") from error
        except Exception as error:
            # pyvisa-py raises Exception itself where a connection fails.
            raise ConnectionLostError(f"{name} cannot be opened: {error}; check cable and power") from error
        if not isinstance(resource, MessageBasedResource):
            resource.close()
            raise ConfigurationError(f"{name} takes no text; give the resource of an instrument")
        self._resource = resource
        if parameters.terminator:
            resource.read_termination = parameters.terminator[-1]
        if self._streams:
            # Otherwise what has come without its terminator would be lost with the time.
            resource.set_visa_attribute(ResourceAttribute.suppress_end_enabled, False)

    def read(self, size: int) -> bytes:
        """Return up to ``size`` bytes received within `POLL_S` (socket) or the reply timeout; maybe none.

        OSError if the resource fails.
        """
        return self._read_bytes(size, self._wait_ms)

    def write(self, data: bytes) -> None:
        """Write all of the data within the reply timeout; OSError if that fails."""
        with _translate_to_os_error():
            self._resource.timeout = self._write_ms
            self._resource.write_raw(data)

    def reset_input_buffer(self) -> None:
        """Discard the data received by a socket; clear another resource that still owes a response.

        OSError if that fails.
        """
        if self._streams:
            while self._read_bytes(self.in_waiting, 0.0):
                pass
        elif self._owes_an_answer:
            with _translate_to_os_error():
                self._resource.clear()
            self._owes_an_answer = False

    def reset_output_buffer(self) -> None:
        """Do nothing: data is never queued here."""

    def close(self) -> None:
        """Close the resource; OSError if that fails."""
        with _translate_to_os_error():
            self._resource.close()

    def _read_bytes(self, size: int, wait_ms: float) -> bytes:
        """Read up to ``size`` bytes within ``wait_ms``; empty after that time: a response is then owed.

        Any other error is an OSError.
        """
        with _translate_to_os_error():
            self._resource.timeout = wait_ms
            try:
                return bytes(self._resource.visalib.read(self._resource.session, size)[0])
            except pyvisa.VisaIOError as error:
                if error.error_code != StatusCode.error_timeout:
                    raise
                self._owes_an_answer = True
                return b""


@contextlib.contextmanager
def _translate_to_os_error() -> Iterator[None]:
    """Run a block; raise its pyvisa errors as OSError, which the line handles."""
    try:
        yield
    except pyvisa.Error as error:
        raise OSError(str(error)) from error
