"""Conditional requests for answers that a client already has (RFC 9110)."""

from __future__ import annotations

from fastapi import Request
from starlette.responses import Response


def check_etag(request: Request, etag: str) -> tuple[dict[str, str], Response | None]:
    """Return caching headers with an ETag, and a 304 response if If-None-Match of the request has it.

    The second result is None otherwise. Weak tags count as equal.
    """
    headers = {"ETag": etag, "Cache-Control": "no-cache"}
    given = (part.strip().removeprefix("W/") for part in request.headers.get("if-none-match", "").split(","))
    return headers, Response(status_code=304, headers=headers) if etag in given else None
