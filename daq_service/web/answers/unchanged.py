"""Conditional requests for answers that a client already has (RFC 9110)."""

from __future__ import annotations

import hashlib
from importlib.metadata import version
from pathlib import Path

from fastapi import Request
from starlette.responses import Response

from daq_service.catalogue.connection import FILE_NAME
from daq_service.processes.freshness import Freshness

ENDED = ("finished", "stopped")
"""States of a recorder that stores nothing any more."""


def check_etag(request: Request, etag: str) -> tuple[dict[str, str], Response | None]:
    """Return caching headers with an ETag, and a 304 response if If-None-Match of the request has it.

    The second result is None otherwise. Weak tags count as equal.
    """
    headers = {"ETag": etag, "Cache-Control": "no-cache"}
    given = (part.strip().removeprefix("W/") for part in request.headers.get("if-none-match", "").split(","))
    return headers, Response(status_code=304, headers=headers) if etag.removeprefix("W/") in given else None


def check_ended_test(
    request: Request, folder: Path, fresh: Freshness, *, form: str = "", is_dated: bool
) -> tuple[dict[str, str], Response | None]:
    """Return the result of `check_etag` for an answer from a test that has ended; no headers before that.

    The tag is that of the request, the newest event, the catalogue's file and the version of solimon: it
    changes with each note, command, rebuild and upgrade.

    Parameters
    ----------
    form
        Chosen format, which the address does not always name.
    is_dated
        The answer also holds the present time; its tag is weak, since the bytes differ.

    Raises
    ------
    OSError
        The catalogue's file is gone.
    """
    if fresh.recorder.status not in ENDED:
        return {}, None
    file = (folder / FILE_NAME).stat()
    facts = request.url.path, request.url.query, form, fresh.last_event_id, file.st_mtime_ns, file.st_size
    digest = hashlib.sha256(repr((*facts, version("solimon"))).encode()).hexdigest()[:20]
    return check_etag(request, f'{"W/" if is_dated else ""}"{digest}"')
