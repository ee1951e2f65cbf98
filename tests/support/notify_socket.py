"""A service manager that records the notifications of its services."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

END = b"end of the test"


@contextmanager
def notify_socket(folder: Path) -> Iterator[tuple[dict[str, str], list[list[str]]]]:
    """Yield the environment of a service, and the lines of each datagram, complete at the end."""
    address, heard = str(folder / "notify"), list[list[str]]()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        channel.bind(address)

        def listen() -> None:
            while (datagram := channel.recv(4096)) != END:
                heard.append(datagram.decode().split("\n"))

        listener = threading.Thread(target=listen, daemon=True)
        listener.start()
        try:
            yield {"NOTIFY_SOCKET": address}, heard
        finally:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as last:
                last.sendto(END, address)
            listener.join()
