"""Base of threads that follow a source, with a wake-up for waiting streams."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable


class Followed:
    """Thread that follows a source, and wakes up streams that wait for the next change.

    Everything but `_follow` runs on the event loop, so nothing needs a lock. ``closed``: `close` was called,
    and clients must end.
    """

    def __init__(self, thread_name: str) -> None:
        self._thread_name = thread_name
        self.closed = False
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._waiting: list[asyncio.Future[None]] = []
        self.clients = 0

    async def start(self) -> None:
        """Start the daemon thread that follows the source; called on the event loop that clients use."""
        self._loop = asyncio.get_running_loop()
        self._thread = threading.Thread(target=self._follow, name=self._thread_name, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Request the end of the thread and wake every client, without waiting; may be called again."""
        self.closed = True
        self._stop.set()
        self._wake_clients()

    async def join(self) -> None:
        """Wait for the end of the thread after `close`; return at once if it was never started."""
        if self._thread is not None:
            await asyncio.to_thread(self._thread.join)

    async def changed(self) -> None:
        """Wait until the data change or the source closes; return at once if it is closed.

        Called on the event loop. A change before the call is not noticed.
        """
        if not self.closed:
            # One future per waiter: cancelling a shared one would cancel it for all.
            waiter = self._loop.create_future()
            self._waiting.append(waiter)
            await waiter

    def _wake_clients(self) -> None:
        """Wake all clients that wait for a change; called on the event loop."""
        woken, self._waiting = self._waiting, []
        for waiter in woken:
            if not waiter.done():
                waiter.set_result(None)

    def _follow(self) -> None:
        """Follow the source in this thread until `_stop` is set; subclasses implement it."""
        raise NotImplementedError

    def _call_on_event_loop(self, function: Callable[..., None], *arguments: object) -> None:
        """Schedule a call on the event loop from the thread; stop the thread if the loop is closed."""
        try:
            self._loop.call_soon_threadsafe(function, *arguments)
        except RuntimeError:
            # The loop is gone: the service ends.
            self._stop.set()
