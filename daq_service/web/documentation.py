"""`/docs`: the documentation site, as `zensical build --strict` writes it into this package."""

from __future__ import annotations

import base64
import hashlib
import os
import re
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from daq_service.shared_file import read_shared
from daq_service.web.answers.problem import not_found
from daq_service.web.assets import MEDIA_TYPES

SITE = Path(__file__).parent / "site"
_MEDIA_TYPES = {**MEDIA_TYPES, ".json": "application/json", ".png": "image/png", ".xml": "application/xml"}
_INLINE_SCRIPT = re.compile(rb"<script>(.*?)</script>", re.DOTALL)
_STYLE_SHEET = re.compile(rb"='([^'\\]{1000,}\}\s*)'")
"""Literal of the site's script that it adds as the style sheet of the search dialog."""


class Documentation(StaticFiles):
    """Files of the site; the policy of a page allows its own inline scripts only."""

    def __init__(self) -> None:
        super().__init__(directory=SITE, html=True, check_dir=False)

    async def check_config(self) -> None:
        """Raise a Problem (404) with the remedy if there is no site; called until there is one."""
        if not SITE.is_dir():
            raise not_found(
                "The documentation site is not built.",
                'Run `python -m pip install -e ".[docs]"` and `zensical build --strict` in the repository.',
            )

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return a file, or the index of a folder; raise HTTPException (404) if there is none."""
        response = await super().get_response(path, scope)
        if response.status_code == 404:  # the site's own page for it expects to be at the root of a host
            raise HTTPException(404)
        return response

    def file_response(
        self,
        full_path: str | os.PathLike[str],
        stat_result: os.stat_result,
        scope: Scope,
        status_code: int = 200,
    ) -> Response:
        """Return a file with its type, or 304 if the browser has it; a page has its policy in both cases."""
        response = super().file_response(full_path, stat_result, scope, status_code)
        path = Path(full_path)
        response.headers["Cache-Control"] = "no-cache"
        if path.suffix in _MEDIA_TYPES and response.status_code == 200:
            response.headers["Content-Type"] = _MEDIA_TYPES[path.suffix]
        if path.suffix == ".html":
            response.headers["Content-Security-Policy"] = _build_policy(path, stat_result.st_mtime_ns)
        return response


@lru_cache(maxsize=512)
def _build_policy(page: Path, mtime_ns: int) -> str:
    """Build the policy of a page: files of this host, inline scripts and styles by their SHA-256. Cached.

    ``mtime_ns`` is the time at which the page was written: the policy of a new build is another one.
    """
    scripts = _INLINE_SCRIPT.findall(read_shared(page))
    styles = [
        style
        for script in (SITE / "assets/javascripts").glob("*.js")
        for style in _STYLE_SHEET.findall(read_shared(script))
    ]
    return (
        f"default-src 'none'; script-src 'self' {_hash(scripts)}; style-src 'self' {_hash(styles)}; "
        "img-src 'self' data:; connect-src 'self'; worker-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


def _hash(texts: Iterable[bytes]) -> str:
    """Return the source expressions (CSP level 3) that allow these texts inline."""
    return " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(one).digest()).decode()}'" for one in texts)
