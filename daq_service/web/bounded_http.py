"""HTTP connections that end by themselves: a request's headers must come soon, and be few."""

from __future__ import annotations

import asyncio
from http import HTTPStatus
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

HEADERS_WITHIN_S = 10.0
LARGEST_HEADERS_BYTES = 32 * 1024


class BoundedHttp(HttpToolsProtocol):
    """Uvicorn's protocol, which by itself waits for ever and takes any number of headers.

    What it answers itself is plain text; a request with whole headers is answered by the application.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._headers_bytes = 0
        self._waiting: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override] # as uvicorn's
        """Wait for the first request."""
        super().connection_made(transport)
        self._await_headers()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no more."""
        self._headers_have_come()
        super().connection_lost(exc)

    def on_message_begin(self) -> None:
        """Wait for the headers of the next request of this connection."""
        super().on_message_begin()
        if self._waiting is None:
            self._await_headers()

    def on_headers_complete(self) -> None:
        """Hand the request to the application."""
        self._headers_have_come()
        super().on_headers_complete()

    def data_received(self, data: bytes) -> None:
        """Read on, unless the headers grow without end."""
        if self.transport.is_closing():
            return
        super().data_received(data)
        if self._waiting is not None:
            self._headers_bytes += len(data)
            if self._headers_bytes > LARGEST_HEADERS_BYTES:
                self._refuse(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)

    def _await_headers(self) -> None:
        self._headers_bytes = 0
        self._waiting = self.loop.call_later(HEADERS_WITHIN_S, self._waited)

    def _headers_have_come(self) -> None:
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None

    def _answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _waited(self) -> None:
        if self._answering():  # the next request may take until this one is answered
            self._waiting = self.loop.call_later(HEADERS_WITHIN_S, self._waited)
        else:
            self._refuse(HTTPStatus.REQUEST_TIMEOUT)

    def _refuse(self, status: HTTPStatus) -> None:
        self._headers_have_come()
        told = (
            f"{status.phrase}: a request's headers must come within {HEADERS_WITHIN_S:g} s and take at most "
            f"{LARGEST_HEADERS_BYTES} bytes\n"
        )
        if not self._answering():
            self.transport.write(
                f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: text/plain; charset=utf-8\r\n"
                f"Content-Length: {len(told)}\r\nConnection: close\r\n\r\n{told}".encode()
            )
        self.transport.close()
