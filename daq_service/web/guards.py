"""What stands before every route: host, origin and size of a request, headers of an answer.

Plain ASGI, because Starlette's `BaseHTTPMiddleware` would buffer the streams.
"""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Awaitable, Callable, Mapping
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from daq_service.settings.web import LOOPBACK
from daq_service.web.answers.problem import Problem, problem_response
from daq_service.web.bounded_http import LARGEST_HEADERS_BYTES

LARGEST_BODY_BYTES = 64 * 1024
BODY_WITHIN_S = 10.0
FOREIGN = frozenset({"foreign-host", "foreign-origin"})
"""Refusals that are audited: somebody else's page has tried."""
Tell = Callable[[Scope, str], Awaitable[None]]
EVENTS = "/api/v1/stream"
"""Of each test. No browser shows a foreign page what it reads there, but it would take one of the streams."""
STREAMS_AT_ONCE = 8
"""Begun before everybody else has been looked at: a thousand come back together when the service is there."""
SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
ANSWER_HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": CONTENT_SECURITY_POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class RequestGuard:
    """Refuses foreign hosts and origins and oversized bodies; names the request; sets the headers.

    A browser page of another site can send requests to this machine. `Host` stops DNS rebinding,
    `Origin` and `Sec-Fetch-Site` stop cross-site writes and WebSockets, which no browser keeps
    within its origin by itself. Programs that are no browser send no Origin and are let through: others
    than this machine's need a token (`doors.entry`), and whoever runs on it as this user could write the
    data folder anyway.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        names_elsewhere: frozenset[str] = frozenset(),
        audit_rejection: Tell | None = None,
    ) -> None:
        self._app, self._tell_refused = app, audit_rejection
        self._names = names_elsewhere | LOOPBACK.keys()
        self._streams_entering = asyncio.Semaphore(STREAMS_AT_ONCE)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a good request on, answer a bad one."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        if scope["path"].endswith(EVENTS):
            async with self._streams_entering:
                await asyncio.sleep(0)
        name = uuid.uuid4().hex
        scope.setdefault("state", {})["request_id"] = name
        headers = Headers(scope=scope)
        problem = _refusal(scope, headers, self._names)

        async def send_with_headers(message: Message) -> None:
            if message["type"] in {"http.response.start", "websocket.http.response.start"}:
                answer = MutableHeaders(scope=message)
                for key, value in ANSWER_HEADERS.items():
                    answer.setdefault(key, value)
                answer.setdefault("Cache-Control", "no-store")
                answer["X-Request-ID"] = name
            await send(message)

        if problem is None and scope["type"] == "http" and scope["method"] not in SAFE_METHODS:
            try:
                async with asyncio.timeout(BODY_WITHIN_S):
                    body = await _read_body(receive)
            except TimeoutError:
                problem = _too_slow()
            else:
                if body is None:
                    problem = _too_large(f"more than {LARGEST_BODY_BYTES}")
                else:
                    receive = _replayed(body, receive)
        if problem is not None and problem.name in FOREIGN and self._tell_refused is not None:
            await self._tell_refused(scope, problem.detail)
        answering = self._app if problem is None else problem_response(scope, problem)
        await answering(scope, receive, send_with_headers)


async def _read_body(receive: Receive) -> bytes | None:
    """Whole body of a write; None once it passes the limit, whatever Content-Length said."""
    body = b""
    while True:
        message = await receive()
        part: bytes = message.get("body", b"")
        body += part
        if len(body) > LARGEST_BODY_BYTES:
            return None
        if message["type"] != "http.request" or not message.get("more_body", False):
            return body


def _replayed(body: bytes, receive: Receive) -> Receive:
    """`receive` that hands out the body once, then what the server says."""
    waiting = [body]

    async def replay() -> Message:
        if waiting:
            return {"type": "http.request", "body": waiting.pop(), "more_body": False}
        return await receive()

    return replay


def _too_large(size: str) -> Problem:
    return Problem(
        413,
        "body-too-large",
        "The request body is too large",
        f"The body has {size} bytes; the limit is {LARGEST_BODY_BYTES}.",
        "Commands are small: shorten the note.",
    )


def _too_slow() -> Problem:
    return Problem(
        408,
        "body-too-slow",
        "The request body did not come",
        f"The body was not whole within {BODY_WITHIN_S:g} s.",
        "Send it again at once.",
    )


def _refusal(scope: Scope, headers: Headers, names: frozenset[str]) -> Problem | None:
    if (header_bytes := sum(len(name) + len(value) for name, value in headers.raw)) > LARGEST_HEADERS_BYTES:
        return Problem(
            431,
            "headers-too-large",
            "The request headers are too large",
            f"The headers have {header_bytes} bytes; the limit is {LARGEST_HEADERS_BYTES}.",
            "Clear the cookies of this address.",
        )
    host = _all_of(headers, "host")
    if _hostname(f"//{host}") not in names:
        return Problem(
            400,
            "foreign-host",
            "Unknown host name",
            f"Host is {host!r}; this service answers to {', '.join(sorted(names))} only.",
            "Open the address that the service printed, or name this one in web.host_names.",
        )
    streams = scope["type"] == "websocket" or scope["path"].endswith(EVENTS)
    origin = _all_of(headers, "origin")
    is_foreign = "cross-site" in _all_of(headers, "sec-fetch-site") and _hostname(origin) not in names
    reads_across = "/api/" in scope["path"] and is_foreign
    if reads_across or ((streams or scope["method"] not in SAFE_METHODS) and not same_origin(headers)):
        return Problem(
            403,
            "foreign-origin",
            "Request from another origin",
            f"Origin is {origin!r}, but the request went to {host!r}.",
            "Only the service's own dashboard and programs without a browser may ask; name another host "
            "that serves pages of this service in web.host_names.",
        )
    size = headers.get("content-length", "0")
    if scope["type"] == "http" and (not size.isdecimal() or int(size[:9]) > LARGEST_BODY_BYTES):
        return _too_large(size)
    return None


def _hostname(address: str) -> str | None:
    try:
        return urlsplit(address).hostname
    except ValueError:
        return None


def _all_of(headers: Headers, name: str) -> str:
    """Every header of a name in one text: a proxy and this service might believe different ones."""
    return ", ".join(headers.getlist(name))


def same_origin(headers: Headers) -> bool:
    """Tell that no browser of another origin sent this request."""
    host = _all_of(headers, "host")
    return _all_of(headers, "sec-fetch-site") in {"", "same-origin", "none"} and _all_of(
        headers, "origin"
    ) in {"", f"http://{host}", f"https://{host}"}
