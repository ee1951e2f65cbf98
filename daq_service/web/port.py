"""Port of the web service, bound without loading the service."""

from __future__ import annotations

import errno
import socket

from daq_service.errors import BusyError, UsageError
from daq_service.settings.web import LOOPBACK


def bind_socket(host: str, port: int, *, locked: bool = False) -> socket.socket:
    """Open a non-blocking socket that listens on an address of this computer; port 0 selects a free one.

    Parameters
    ----------
    locked
        Others may connect: tokens and encryption are checked (`middleware.refuse_unprotected_service`).

    Raises
    ------
    UsageError
        The address is reachable from elsewhere without protection, or the system refuses to listen: it is
        none of this computer, or its port is reserved.
    BusyError
        Another process uses the port.
    """
    if host not in LOOPBACK and not locked:
        raise UsageError(
            f"web.host is {host!r}; without tokens and encryption only {', '.join(LOOPBACK)} are allowed"
        )
    address = LOOPBACK.get(host, host)
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    # Only where the protocol is named asyncio switches Nagle's algorithm off, which holds small answers back.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        if hasattr(socket, "SO_EXCLUSIVEADDRUSE"):
            # On Windows SO_REUSEADDR would let a second service steal the port.
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
        else:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((address, port))
        listener.listen(2048)
        listener.setblocking(False)
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRINUSE:
            raise BusyError(
                f"Port {port} is in use. Choose another with --port; 0 takes a free one."
            ) from error
        if error.errno in {errno.EACCES, errno.EPERM}:
            raise UsageError(
                f"port {port} of {address} is reserved; choose one above 1023 (`web.port`)"
            ) from error
        raise UsageError(f"cannot listen on {address}, port {port}: {error.strerror}") from error
    return listener
