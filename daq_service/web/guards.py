"""Guard before every route: checks host, origin and size of a request, sets headers of the response.

Plain ASGI, because Starlette's `BaseHTTPMiddleware` would buffer the streams.
"""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Awaitable, Callable
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from daq_service.settings.web import LOOPBACK
from daq_service.web.answers.problem import Problem, build_problem_response
from daq_service.web.bounded_http import LARGEST_HEADERS_BYTES
from daq_service.web.embedding import SAFE_METHODS, Embedding

LARGEST_BODY_BYTES = 64 * 1024
BODY_WITHIN_S = 10.0
FOREIGN = frozenset({"foreign-host", "foreign-origin"})
"""Refusals that are audited, since they come from a foreign page."""
RejectionAuditor = Callable[[Scope, str], Awaitable[None]]
EVENTS = "/api/v1/stream"
"""Event stream of each test. A foreign page cannot read it, but would occupy one of the streams."""
STREAMS_AT_ONCE = 8
"""Streams started before other requests get a turn: a thousand clients reconnect after a restart."""


class RequestGuard:
    """Middleware that refuses foreign hosts, foreign origins and large bodies, and sets headers.

    A browser page of another site can send requests to this machine. `Host` stops DNS rebinding,
    `Origin` and `Sec-Fetch-Site` stop cross-site writes and WebSockets, which no browser keeps
    within its origin by itself. Programs that are no browser send no Origin and pass: from other
    machines they need a token (`auth.middleware`), and on this one they could write the data folder anyway.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        names_elsewhere: frozenset[str] = frozenset(),
        embedding: Embedding | None = None,
        audit_rejection: RejectionAuditor | None = None,
    ) -> None:
        self._app, self._audit_rejection = app, audit_rejection
        self._names = names_elsewhere | LOOPBACK.keys()
        self._embedding = embedding or Embedding()
        self._streams_entering = asyncio.Semaphore(STREAMS_AT_ONCE)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a valid request on with a new request id, and answer an invalid one with a problem.

        Bodies of writes are read completely first, within 10 s and 64 KiB (else 408, 413). Rejected foreign
        hosts and origins are audited; every response gets the security headers.
        """
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        if scope["path"].endswith(EVENTS):
            async with self._streams_entering:
                await asyncio.sleep(0)
        name = uuid.uuid4().hex
        scope.setdefault("state", {})["request_id"] = name
        headers = Headers(scope=scope)
        problem = _find_request_problem(scope, headers, self._names, self._embedding)

        async def send_with_headers(message: Message) -> None:
            """Send a message; add the security headers and the request id to the start of a response."""
            if message["type"] in {"http.response.start", "websocket.http.response.start"}:
                answer = MutableHeaders(scope=message)
                for key, value in self._embedding.choose_headers(scope, headers).items():
                    answer.setdefault(key, value)
                if self._embedding.origins:
                    answer.add_vary_header("Origin")
                answer.setdefault("Cache-Control", "no-store")
                answer["X-Request-ID"] = name
            await send(message)

        if problem is None and scope["type"] == "http" and scope["method"] not in SAFE_METHODS:
            try:
                async with asyncio.timeout(BODY_WITHIN_S):
                    body = await _read_body(receive)
            except TimeoutError:
                problem = Problem("body-too-slow", f"The body was not complete within {BODY_WITHIN_S:g} s.")
            else:
                if body is None:
                    problem = _create_body_too_large(f"more than {LARGEST_BODY_BYTES}")
                else:
                    receive = _replay_body(body, receive)
        if problem is not None and problem.name in FOREIGN and self._audit_rejection is not None:
            await self._audit_rejection(scope, problem.detail)
        application = self._app if problem is None else build_problem_response(scope, problem)
        await application(scope, receive, send_with_headers)


async def _read_body(receive: Receive) -> bytes | None:
    """Read the complete body of a write; None once it exceeds 64 KiB, independent of Content-Length.

    A disconnected client ends it with the part received.
    """
    body = b""
    while True:
        message = await receive()
        part: bytes = message.get("body", b"")
        body += part
        if len(body) > LARGEST_BODY_BYTES:
            return None
        if message["type"] != "http.request" or not message.get("more_body", False):
            return body


def _replay_body(body: bytes, receive: Receive) -> Receive:
    """Build a ``receive`` function that returns a body once, and then the messages of the server."""
    unread = [body]

    async def receive_replayed() -> Message:
        """Return the body at the first call, and later messages of the server."""
        if unread:
            return {"type": "http.request", "body": unread.pop(), "more_body": False}
        return await receive()

    return receive_replayed


def _create_body_too_large(size: str) -> Problem:
    """Create, without raising it, the error of a request body that exceeds the limit (413)."""
    return Problem("body-too-large", f"The body has {size} bytes; the limit is {LARGEST_BODY_BYTES}.")


def _find_request_problem(
    scope: Scope, headers: Headers, names: frozenset[str], embedding: Embedding
) -> Problem | None:
    """Check header size, host, origin and stated body size of a request; return the first problem or None.

    ``names`` are the host names of this service.
    """
    if (header_bytes := sum(len(name) + len(value) for name, value in headers.raw)) > LARGEST_HEADERS_BYTES:
        return Problem(
            "headers-too-large",
            f"The headers have {header_bytes} bytes; the limit is {LARGEST_HEADERS_BYTES}.",
        )
    host = _join_header(headers, "host")
    if _parse_hostname(f"//{host}") not in names:
        return Problem(
            "foreign-host", f"Host is {host!r}; this service answers to {', '.join(sorted(names))} only."
        )
    streams = scope["type"] == "websocket" or scope["path"].endswith(EVENTS)
    origin = _join_header(headers, "origin")
    is_foreign = (
        "cross-site" in _join_header(headers, "sec-fetch-site") and _parse_hostname(origin) not in names
    ) and not embedding.allows_reading(scope, headers)
    reads_across = "/api/" in scope["path"] and is_foreign
    if reads_across or ((streams or scope["method"] not in SAFE_METHODS) and not is_same_origin(headers)):
        return Problem("foreign-origin", f"Origin is {origin!r}, but the request went to {host!r}.")
    if problem := embedding.find_problem(scope, headers):
        return problem
    size = headers.get("content-length", "0")
    if scope["type"] == "http" and (not size.isdecimal() or int(size[:9]) > LARGEST_BODY_BYTES):
        return _create_body_too_large(size)
    return None


def _parse_hostname(address: str) -> str | None:
    """Parse the host name of a URL, in lower case; None if it is malformed or missing."""
    try:
        return urlsplit(address).hostname
    except ValueError:
        return None


def _join_header(headers: Headers, name: str) -> str:
    """Return all headers of a name joined with commas; empty without one.

    A proxy and this service might otherwise use different ones.
    """
    return ", ".join(headers.getlist(name))


def is_same_origin(headers: Headers) -> bool:
    """Return whether Origin and Sec-Fetch-Site are absent (no browser) or those of the requested host."""
    host = _join_header(headers, "host")
    return _join_header(headers, "sec-fetch-site") in {"", "same-origin", "none"} and _join_header(
        headers, "origin"
    ) in {"", f"http://{host}", f"https://{host}"}
