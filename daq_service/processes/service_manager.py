"""Notifications of a service manager (systemd's protocol): ready, alive, present activity, stopping.

Only the recording thread feeds the watchdog: only a beat of its heartbeat is passed on.
"""

from __future__ import annotations

import logging
import os
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

log = logging.getLogger(__name__)

Notifier = Callable[..., None]


def notify_manager(*assignments: str) -> None:
    """Send ``KEY=value`` lines to the service manager of this process without waiting.

    Nothing is sent on Windows, without a manager, or in a child of the service; errors are logged only.
    """
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address or sys.platform == "win32":
        return
    if os.environ.get("SYSTEMD_EXEC_PID", str(os.getpid())) != str(os.getpid()):
        return  # inherited: this process is not the service
    # A leading @ stands for the zero byte of an abstract socket.
    name = f"\0{address[1:]}" if address.startswith("@") else address
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
            channel.setblocking(False)
            channel.sendto("\n".join(assignments).encode(), name)
    except OSError as error:
        log.debug("the service manager is not notified of %s: %s", assignments[0], error)


@contextmanager
def forward_to_service_manager(
    on_event: Notifier, send: Callable[..., None] = notify_manager
) -> Iterator[Notifier]:
    """Yield a callback that passes recorder events to ``on_event`` and the service manager.

    The start event sends READY; each ``beat`` feeds the watchdog and extends the time limit by its deadline,
    also while the service starts or stops. On exit sends STOPPING.
    """
    is_ready = False

    def forward_event(event: str, **values: object) -> None:
        """Pass an event on, and report start and heartbeats to the service manager."""
        nonlocal is_ready
        on_event(event, **values)
        if event == "begun":
            is_ready = True
            send("READY=1")
        if event == "beat":
            extend_us = round(float(str(values["deadline_s"])) * 1e6)
            doing = " ".join(str(values["doing"]).split())
            ready = ["READY=1"] if is_ready else []  # repeated: a datagram may be lost
            send(*ready, "WATCHDOG=1", f"EXTEND_TIMEOUT_USEC={extend_us}", f"STATUS={doing}")

    try:
        yield forward_event
    finally:
        send("STOPPING=1", "STATUS=stopping")
