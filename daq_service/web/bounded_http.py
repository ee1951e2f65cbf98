"""HTTP protocol with limits: time to the headers, their size, and the number of waiting connections."""

from __future__ import annotations

import asyncio
import time
from http import HTTPStatus
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

HEADERS_WITHIN_S = 10.0
LARGEST_HEADERS_BYTES = 32 * 1024
MOST_WAITING, MOST_WAITING_OF_ADDRESS = 256, 64
"""Connections without a complete request: in total, and per address, which users of a proxy share."""
LOOK_EVERY_S = 2.5
"""Excess connections are closed at the second check: a thousand simultaneous clients take seconds."""
SPARE_CONNECTIONS = 16
"""Connections above the limit, answered with an error. At the limit, the longest waiting one is closed."""


class BoundedHttp(HttpToolsProtocol):
    """Uvicorn's HTTP protocol with limits of time, headers and connections, which it does not have itself.

    Its own answers are plain text; a request with complete headers is answered by the application.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._headers_bytes, self._in_headers = 0, True
        self._since_s, self._n_checks = 0.0, 0
        self._waiting: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override] # as uvicorn's
        """Accept a connection and wait for its first request.

        At the limit of connections the longest waiting one is aborted; this one only if it is that one and
        all 16 spare connections are used.
        """
        super().connection_made(transport)
        self._start_waiting()
        most = self.limit_concurrency
        if most is not None and (over := len(self.connections) - most) >= 0:
            oldest = min(self._list_waiting(), key=lambda connection: connection._since_s)
            if oldest is not self or over >= SPARE_CONNECTIONS:
                oldest._stop_waiting()
                oldest.transport.abort()
                self.connections.discard(oldest)  # at once: this one's request is answered

    def connection_lost(self, exc: Exception | None) -> None:
        """Cancel the checks of a closed connection."""
        self._stop_waiting()
        super().connection_lost(exc)

    def on_message_begin(self) -> None:
        """Start the time limit for the headers of the next request of this connection."""
        super().on_message_begin()
        if self._waiting is None:
            self._start_waiting()

    def on_headers_complete(self) -> None:
        """End the time limit of the headers and hand the request to the application."""
        self._in_headers = False
        super().on_headers_complete()

    def on_message_complete(self) -> None:
        """Stop waiting: headers and body are complete."""
        self._stop_waiting()
        super().on_message_complete()

    def data_received(self, data: bytes) -> None:
        """Process received data; answer 431 and close if the headers exceed 32 KiB."""
        if self.transport.is_closing():
            return
        super().data_received(data)
        if self._waiting is not None and self._in_headers:
            self._headers_bytes += len(data)
            if self._headers_bytes > LARGEST_HEADERS_BYTES:
                self._refuse_request(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)

    def _start_waiting(self) -> None:
        """Reset the size of the headers and start the time limit of the next request of the connection."""
        self._headers_bytes, self._in_headers = 0, True
        self._since_s, self._n_checks = time.monotonic(), 0
        self._schedule_check()

    def _schedule_check(self) -> None:
        """Schedule the next check of the waiting request, in 2.5 s."""
        self._waiting = self.loop.call_later(min(LOOK_EVERY_S, HEADERS_WITHIN_S), self._check_waiting)

    def _stop_waiting(self) -> None:
        """Cancel the scheduled check: the connection no longer counts as waiting."""
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None

    def _is_answering(self) -> bool:
        """Return whether the application is answering a request of this connection."""
        return self.cycle is not None and not self.cycle.response_complete

    def _list_waiting(self) -> list[BoundedHttp]:
        """Return the connections of the server, this one included, that wait for a complete request."""
        return [
            connection
            for connection in self.connections
            if isinstance(connection, BoundedHttp) and connection._waiting is not None
        ]

    def _has_too_many_waiting(self) -> bool:
        """Return whether more than 256 connections wait for requests, or more than 64 from this address."""
        waiting = self._list_waiting()
        same_address = sum(
            (connection.client or ("",))[0] == (self.client or ("",))[0] for connection in waiting
        )
        return len(waiting) > MOST_WAITING or same_address > MOST_WAITING_OF_ADDRESS

    def _check_waiting(self) -> None:
        """Close a connection whose headers take over 10 s (408) or that is one of too many (503).

        Otherwise the next check is scheduled.
        """
        self._n_checks += 1
        if self._in_headers and self._is_answering():  # the next request may take until this one is answered
            self._schedule_check()
        elif self._in_headers and time.monotonic() - self._since_s >= HEADERS_WITHIN_S:
            self._refuse_request(HTTPStatus.REQUEST_TIMEOUT)
        # Between two checks the loop reads: data that have arrived are not discarded unread.
        elif self._n_checks > 1 and self._has_too_many_waiting():
            self._refuse_request(HTTPStatus.SERVICE_UNAVAILABLE)
        else:
            self._schedule_check()

    def _refuse_request(self, status: HTTPStatus) -> None:
        """Close the connection; first send an HTTP status as plain text, unless a response is being sent."""
        self._stop_waiting()
        message = (
            f"{status.phrase}: a request's headers must come within {HEADERS_WITHIN_S:g} s and take at most "
            f"{LARGEST_HEADERS_BYTES} bytes; {MOST_WAITING_OF_ADDRESS} connections of an address may wait\n"
        )
        if not self._is_answering():
            self.transport.write(
                f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: text/plain; charset=utf-8\r\n"
                f"Content-Length: {len(message)}\r\nConnection: close\r\n\r\n{message}".encode()
            )
        self.transport.close()
