"""Files of the dashboard: a fixed list read once, so that no request names a path on disk."""

from __future__ import annotations

import gzip
import hashlib
import posixpath
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from fastapi import APIRouter, Request
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from daq_service.shared_file import read_shared
from daq_service.web.answers.problem import not_found
from daq_service.web.answers.unchanged import check_etag

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
PLACE = "/static/"
PAGE, FIRST, SCRIPT = "index.html", "startup.js", "main.js"
LATER = b'<template id="later">'
IMPORTED = re.compile(rb'^(?:import|export)\b[^;"]*"(\.[^"]+)";', re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Asset:
    """File of the dashboard, also compressed."""

    content: bytes
    compressed: bytes
    media_type: str
    etag: str


@cache
def load_assets() -> dict[str, Asset]:
    """Read and compress all files of the dashboard once; return them by their path in the URL. Cached.

    The page gets links that preload the imported scripts. Raises OSError if a file cannot be read.
    """
    contents = {}
    for path in sorted(FOLDER.rglob("*")):
        if path.is_file() and path.suffix in MEDIA_TYPES:
            contents[path.relative_to(FOLDER).as_posix()] = read_shared(path)
    # Modules named in the page are requested at once, not each after its importer. Only those of the first
    # view are preloaded: the others wait in a template, which a browser does not read.
    preloaded = [FIRST, *find_imported_modules(contents, FIRST)]
    deferred = [SCRIPT, *(name for name in find_imported_modules(contents, SCRIPT) if name not in preloaded)]
    contents[PAGE] = contents[PAGE].replace(b"</head>", _build_preload_links(preloaded) + b"</head>")
    contents[PAGE] = contents[PAGE].replace(LATER, LATER + _build_preload_links(deferred))
    return {
        name: Asset(
            content,
            gzip.compress(content, mtime=0),
            MEDIA_TYPES[Path(name).suffix],
            f'"{hashlib.sha256(content).hexdigest()[:20]}"',
        )
        for name, content in contents.items()
    }


def _build_preload_links(names: Iterable[str]) -> bytes:
    """Build the HTML ``modulepreload`` links with which a browser loads scripts early."""
    return "".join(f'<link rel="modulepreload" href="{PLACE}{name}">' for name in names).encode()


def find_imported_modules(files: Mapping[str, bytes], script: str) -> list[str]:
    """Return the paths of all modules that a script imports, directly or through other modules.

    Raises KeyError if an imported file is missing.
    """
    names, waiting = {script: None}, [script]
    while waiting:
        name = waiting.pop()
        for match in IMPORTED.findall(files[name]):
            imported = posixpath.normpath(posixpath.join(posixpath.dirname(name), match.decode()))
            if imported not in names:
                names[imported] = None
                waiting.append(imported)
    return list(names)[1:]


@router.get("/static/{name:path}")
async def get_asset(name: str, request: Request) -> Response:
    """Serve a file of the dashboard, or 304 if the browser has it (ETag); 404 if there is no such file."""
    return build_asset_response(name, request)


def build_asset_response(name: str, request: Request) -> Response:
    """Build the response for a file, compressed if accepted, or 304 if the browser has it.

    Raises a Problem (404) if there is no such file.
    """
    asset = load_assets().get(name)
    if asset is None:
        raise not_found(
            f"The dashboard has no file {name!r}.", "The dashboard is at /, the API at /api/v1/openapi.json."
        )
    headers, known = check_etag(request, asset.etag)
    if known:
        return known
    headers["Vary"] = "Accept-Encoding"
    if "gzip" not in request.headers.get("accept-encoding", ""):
        return Response(asset.content, headers=headers, media_type=asset.media_type)
    headers["Content-Encoding"] = "gzip"
    return Response(asset.compressed, headers=headers, media_type=asset.media_type)


class AssetsFirst:
    """Middleware that serves the files of the dashboard before routing: a page requests sixty at once."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a GET of an existing dashboard file, or pass the request on."""
        answer: ASGIApp = self._app
        if scope["type"] == "http" and scope["method"] == "GET" and scope["path"].startswith(PLACE):
            name = scope["path"].removeprefix(PLACE)
            answer = build_asset_response(name, Request(scope)) if name in load_assets() else answer
        await answer(scope, receive, send)
