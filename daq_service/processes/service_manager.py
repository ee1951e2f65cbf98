"""What a service manager is told (systemd's protocol): ready, alive, what is being done, stopping.

The recording line alone feeds the watchdog: a beat of its heartbeat is passed on, nothing else is.
"""

from __future__ import annotations

import logging
import os
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

log = logging.getLogger(__name__)

Teller = Callable[..., None]


def notify(*assignments: str) -> None:
    """Send ``KEY=value`` lines to the manager that started this process, if one did; never wait for it."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address or sys.platform == "win32":
        return
    if os.environ.get("SYSTEMD_EXEC_PID", str(os.getpid())) != str(os.getpid()):
        return  # inherited: the service is another program's
    # A leading @ stands for the zero byte of an abstract socket.
    name = f"\0{address[1:]}" if address.startswith("@") else address
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
            channel.setblocking(False)
            channel.sendto("\n".join(assignments).encode(), name)
    except OSError as error:
        log.debug("the service manager is not told %s: %s", assignments[0], error)


@contextmanager
def service_manager_notifications(tell: Teller, send: Callable[..., None] = notify) -> Iterator[Teller]:
    """Let a service manager hear, too, what a recorder tells; at the end that it stops.

    Each beat is good for its deadline, also while the service starts or stops.
    """
    begun = False

    def pass_on(event: str, **values: object) -> None:
        nonlocal begun
        tell(event, **values)
        if event == "begun":
            begun = True
            send("READY=1")
        if event == "beat":
            lasts_us = round(float(str(values["deadline_s"])) * 1e6)
            doing = " ".join(str(values["doing"]).split())
            ready = ["READY=1"] if begun else []  # again: a datagram may be lost
            send(*ready, "WATCHDOG=1", f"EXTEND_TIMEOUT_USEC={lasts_us}", f"STATUS={doing}")

    try:
        yield pass_on
    finally:
        send("STOPPING=1", "STATUS=stopping")
