"""The dashboard's files: a fixed list read once, so that no request names a path on disk."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from fastapi import APIRouter, Request
from starlette.responses import Response

from daq_service.shared_file import read_shared
from daq_service.web.answers.problem import not_found
from daq_service.web.answers.unchanged import unchanged

router = APIRouter(include_in_schema=False)
FOLDER = Path(__file__).parent / "dashboard"
# Not from `mimetypes`: on Windows the registry may call JavaScript plain text.
MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    "": "text/plain; charset=utf-8",
}


@dataclass(frozen=True, slots=True)
class Asset:
    """One file as it goes out."""

    content: bytes
    media_type: str
    etag: str


@cache
def assets() -> dict[str, Asset]:
    """All files of the dashboard by their path in the URL."""
    found = {}
    for path in sorted(FOLDER.rglob("*")):
        if path.is_file() and path.suffix in MEDIA_TYPES:
            content = read_shared(path)
            etag = f'"{hashlib.sha256(content).hexdigest()[:20]}"'
            found[path.relative_to(FOLDER).as_posix()] = Asset(content, MEDIA_TYPES[path.suffix], etag)
    return found


@router.get("/")
async def get_dashboard(request: Request) -> Response:
    """Serve the page."""
    return answer_asset("index.html", request)


@router.get("/static/{name:path}")
async def get_asset(name: str, request: Request) -> Response:
    """Serve a file of the dashboard; a browser revalidates by ETag."""
    return answer_asset(name, request)


def answer_asset(name: str, request: Request) -> Response:
    """Answer with one of the files, or with nothing where the browser has it already."""
    asset = assets().get(name)
    if asset is None:
        raise not_found(
            f"The dashboard has no file {name!r}.", "The dashboard is at /, the API at /api/v1/openapi.json."
        )
    headers, known = unchanged(request, asset.etag)
    return known or Response(asset.content, headers=headers, media_type=asset.media_type)
