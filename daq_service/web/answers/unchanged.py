"""Answers that a client has already (RFC 9110, conditional requests)."""

from __future__ import annotations

from fastapi import Request
from starlette.responses import Response


def unchanged(request: Request, etag: str) -> tuple[dict[str, str], Response | None]:
    """Headers by which a client asks again, and the answer where it has this content."""
    headers = {"ETag": etag, "Cache-Control": "no-cache"}
    given = (part.strip().removeprefix("W/") for part in request.headers.get("if-none-match", "").split(","))
    return headers, Response(status_code=304, headers=headers) if etag in given else None
