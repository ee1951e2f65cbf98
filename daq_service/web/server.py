"""Uvicorn server that binds the port itself, and ends in limited time with open streams."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial

import uvicorn
from fastapi import FastAPI

from daq_service.settings.web import WebSettings
from daq_service.web.bounded_http import SPARE_CONNECTIONS, BoundedHttp
from daq_service.web.context import find_app_context
from daq_service.web.port import bind_socket

LONGEST_SHUTDOWN_S = 1
"""Streams close at once; this limits a request that hangs in a thread."""
HANDSHAKE_WITHIN_S = 10.0
"""Limit of the TLS handshake, as for headers; the default of asyncio is a minute."""
COLLECTED_AFTER = (50_000, 20, 50)
"""Thresholds of the garbage collector for its three generations."""
TICKS_OF_A_BEAT = 10
MOST_CONNECTIONS = 2500
"""Some hundreds more than the maximum of streams, for other requests."""
KEPT_HANDLES = 32
"""Handles of the process reserved for notifications."""
OWN_HANDLES = 160
"""Handles of the process for its files, databases and libraries."""


class _Server(uvicorn.Server):
    """Uvicorn server that leaves signals to a caller with a stop event."""

    def __init__(
        self, config: uvicorn.Config, close_streams: Callable[[], None], stop: threading.Event | None
    ) -> None:
        super().__init__(config)
        self._close_streams = close_streams
        self._stop = stop
        self.on_beat: Callable[[], None] = lambda: None

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Install uvicorn's signal handlers within the context, but none if there is a stop event."""
        with super().capture_signals() if self._stop is None else contextlib.nullcontext():
            yield

    async def on_tick(self, counter: int) -> bool:
        """Check the stop event, ten times a second, and call `on_beat` at each tenth check.

        Returns whether the server must exit.
        """
        if counter % TICKS_OF_A_BEAT == 0:
            self.on_beat()
        if self._stop is not None and self._stop.is_set():
            self.should_exit = True
        return await super().on_tick(counter)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Close the streams, then shut down; uvicorn waits up to 1 s for open responses."""
        self._close_streams()
        await super().shutdown(sockets)


def raise_connection_limit() -> int:
    """Raise the limit of open file handles of this process to its maximum, if the system allows it.

    Returns how many connections fit: 1 to 2500.
    """
    if sys.platform == "win32":  # no such limit
        return MOST_CONNECTIONS
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with contextlib.suppress(OSError, ValueError):  # macOS takes no "unlimited"
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
        soft = hard
    taken = KEPT_HANDLES + OWN_HANDLES + SPARE_CONNECTIONS
    fit = MOST_CONNECTIONS if soft == resource.RLIM_INFINITY else soft - taken
    return max(min(MOST_CONNECTIONS, fit), 1)


def reduce_garbage_collection() -> None:
    """Collect cyclic garbage less often, and never in objects that exist at this call.

    A thousand streams are half a million objects: each default collection blocks all requests for a
    quarter of a second. Applies to the whole process.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(*COLLECTED_AFTER)


def _create_event_loop(config: uvicorn.Config) -> asyncio.AbstractEventLoop:
    """Create an event loop (uvloop if available), which with TLS limits handshakes to 10 s."""
    factory = config.get_loop_factory()
    loop = asyncio.new_event_loop() if factory is None else factory()
    if config.is_ssl:  # uvicorn has no such option
        create_server = partial(loop.create_server, ssl_handshake_timeout=HANDSHAKE_WITHIN_S)
        loop.create_server = create_server  # type: ignore[method-assign] # narrower by a default
    return loop


def serve(
    app: FastAPI,
    host: str,
    port: int,
    *,
    on_bound: Callable[[str], None],
    stop: threading.Event | None = None,
    close_streams: Callable[[], None] | None = None,
    locks: WebSettings | None = None,
    on_beat: Callable[[], None] = lambda: None,
) -> None:
    """Serve until ``stop`` is set, or without it until SIGINT or SIGTERM; blocks.

    Open responses get 1 s at the end.

    Parameters
    ----------
    on_bound
        Called with the URL once the port is bound.
    close_streams
        Called before the last responses are awaited; None: that of the service.
    locks
        Certificate and proxy of a reachable service; None: this machine only, without encryption.
    on_beat
        Called by the event loop once a second, unless it stalls.

    Raises
    ------
    UsageError, BusyError
        The port cannot be opened (`bind_socket`).
    """
    locks = locks or WebSettings()
    listener = bind_socket(host, port, locked=locks.is_reachable)
    try:
        config = uvicorn.Config(
            app,
            loop="auto",  # uvloop, but on Windows
            http=BoundedHttp,
            ws="websockets-sansio",
            ws_ping_interval=20.0,
            log_config=None,
            access_log=False,
            limit_concurrency=raise_connection_limit(),
            server_header=False,
            timeout_graceful_shutdown=LONGEST_SHUTDOWN_S,
            lifespan="on",
            proxy_headers=bool(locks.proxy),
            forwarded_allow_ips=locks.proxy,
            ssl_certfile=locks.tls_certificate or None,
            ssl_keyfile=locks.tls_key or None,
        )
        address, bound_port = listener.getsockname()[:2]
        shown = f"[{address}]" if ":" in address else address
        if locks.has_tls and locks.host_names:  # what the certificate is for
            shown = locks.host_names[0]
        on_bound(f"http{'s' if locks.has_tls else ''}://{shown}:{bound_port}/")
        closing = close_streams or find_app_context(app).close_streams
        with asyncio.Runner(loop_factory=partial(_create_event_loop, config)) as runner:
            server = _Server(config, closing, stop)
            server.on_beat = on_beat
            runner.run(server.serve(sockets=[listener]))
    finally:
        listener.close()
