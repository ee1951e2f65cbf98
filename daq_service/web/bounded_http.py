"""HTTP connections that end by themselves: a request must come soon, have few headers, and few may wait."""

from __future__ import annotations

import asyncio
import time
from http import HTTPStatus
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

HEADERS_WITHIN_S = 10.0
LARGEST_HEADERS_BYTES = 32 * 1024
MOST_WAITING, MOST_WAITING_OF_ADDRESS = 256, 64
"""Connections without a complete request: in all, and of one address, which all users of a proxy share."""
LOOK_EVERY_S = 2.5
"""Closed for their number at the second look: a thousand programs that connect together take seconds."""
SPARE_CONNECTIONS = 16
"""Beyond the limit, answered that there are too many. At the limit, the one that waits longest must go."""


class BoundedHttp(HttpToolsProtocol):
    """Uvicorn's protocol, which by itself waits for ever and takes any number of headers and connections.

    What it answers itself is plain text; a request with complete headers is answered by the application.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._headers_bytes, self._in_headers = 0, True
        self._since_s, self._looks = 0.0, 0
        self._waiting: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override] # as uvicorn's
        """Wait for the first request."""
        super().connection_made(transport)
        self._await_request()
        most = self.limit_concurrency
        if most is not None and (over := len(self.connections) - most) >= 0:
            oldest = min(self._all_waiting(), key=lambda one: one._since_s)
            if oldest is not self or over >= SPARE_CONNECTIONS:
                oldest._request_has_come()
                oldest.transport.abort()
                self.connections.discard(oldest)  # at once: this one's request is answered

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting."""
        self._request_has_come()
        super().connection_lost(exc)

    def on_message_begin(self) -> None:
        """Wait for the next request of this connection."""
        super().on_message_begin()
        if self._waiting is None:
            self._await_request()

    def on_headers_complete(self) -> None:
        """Hand the request to the application."""
        self._in_headers = False
        super().on_headers_complete()

    def on_message_complete(self) -> None:
        """Wait no longer: the body is complete, too."""
        self._request_has_come()
        super().on_message_complete()

    def data_received(self, data: bytes) -> None:
        """Read on, unless the headers grow without end."""
        if self.transport.is_closing():
            return
        super().data_received(data)
        if self._waiting is not None and self._in_headers:
            self._headers_bytes += len(data)
            if self._headers_bytes > LARGEST_HEADERS_BYTES:
                self._refuse(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)

    def _await_request(self) -> None:
        self._headers_bytes, self._in_headers = 0, True
        self._since_s, self._looks = time.monotonic(), 0
        self._look_later()

    def _look_later(self) -> None:
        self._waiting = self.loop.call_later(min(LOOK_EVERY_S, HEADERS_WITHIN_S), self._waited)

    def _request_has_come(self) -> None:
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None

    def _answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _all_waiting(self) -> list[BoundedHttp]:
        return [one for one in self.connections if isinstance(one, BoundedHttp) and one._waiting is not None]

    def _others_wait(self) -> bool:
        """Whether more wait than may; a proxy sends complete requests, so its many users count little."""
        waiting = self._all_waiting()
        own = sum((one.client or ("",))[0] == (self.client or ("",))[0] for one in waiting)
        return len(waiting) > MOST_WAITING or own > MOST_WAITING_OF_ADDRESS

    def _waited(self) -> None:
        self._looks += 1
        if self._in_headers and self._answering():  # the next request may take until this one is answered
            self._look_later()
        elif self._in_headers and time.monotonic() - self._since_s >= HEADERS_WITHIN_S:
            self._refuse(HTTPStatus.REQUEST_TIMEOUT)
        # Between two looks the loop reads: what has arrived by then is not closed unread.
        elif self._looks > 1 and self._others_wait():
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE)
        else:
            self._look_later()

    def _refuse(self, status: HTTPStatus) -> None:
        self._request_has_come()
        told = (
            f"{status.phrase}: a request's headers must come within {HEADERS_WITHIN_S:g} s and take at most "
            f"{LARGEST_HEADERS_BYTES} bytes; {MOST_WAITING_OF_ADDRESS} connections of an address may wait\n"
        )
        if not self._answering():
            self.transport.write(
                f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: text/plain; charset=utf-8\r\n"
                f"Content-Length: {len(told)}\r\nConnection: close\r\n\r\n{told}".encode()
            )
        self.transport.close()
