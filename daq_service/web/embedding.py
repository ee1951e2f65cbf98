"""Headers of answers: by default no page of another origin embeds or reads them.

`web.embed_origins` lists the exceptions: their pages may embed the dashboard with ``embed=1`` in its address
and read the API by GET. The other headers of the dashboard and all other pages stay as they are.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from urllib.parse import parse_qs

from starlette.datastructures import Headers
from starlette.types import Scope

from daq_service.web.answers.problem import Problem

SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors "
)
CROSS_ORIGIN_POLICY = "Cross-Origin-Resource-Policy"
ANSWER_HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": f"{CONTENT_SECURITY_POLICY}'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    CROSS_ORIGIN_POLICY: "same-origin",
}
DASHBOARD = re.compile(r"(/tests/[^/]+)?/")


@dataclass(frozen=True, slots=True)
class Embedding:
    """Origins whose pages may embed the dashboard and read the API; ``is_open``: no token is required."""

    origins: frozenset[str] = frozenset()
    is_open: Callable[[], bool] = lambda: True

    def allows_reading(self, scope: Scope, headers: Headers) -> bool:
        """Return whether a request reads the API for a page of one of the origins."""
        is_read = "/api/" in scope["path"] and scope.get("method") in SAFE_METHODS
        return is_read and headers.get("origin") in self.origins

    def choose_headers(self, scope: Scope, headers: Headers) -> dict[str, str]:
        """Return the security headers of the answer to a request, also of a refusal."""
        chosen = dict(ANSWER_HEADERS)
        if self._shows_panel(scope):
            del chosen["X-Frame-Options"]
            chosen[CROSS_ORIGIN_POLICY] = "cross-origin"
            chosen["Content-Security-Policy"] = CONTENT_SECURITY_POLICY + " ".join(sorted(self.origins))
        elif self.allows_reading(scope, headers):
            chosen[CROSS_ORIGIN_POLICY] = "cross-origin"
            chosen["Access-Control-Allow-Origin"] = headers["origin"]
            chosen["Access-Control-Allow-Credentials"] = "true"
        return chosen

    def find_problem(self, scope: Scope, headers: Headers) -> Problem | None:
        """Return the problem of an embedding across sites where tokens are required; None without one.

        The cookie of the login is sent within its site only.
        """
        is_embedding = self._shows_panel(scope) or self.allows_reading(scope, headers)
        if self.is_open() or not is_embedding or "cross-site" not in headers.get("sec-fetch-site", ""):
            return None
        return Problem(
            "cross-site-embedding", "This service asks for a token, which other sites cannot send."
        )

    def _shows_panel(self, scope: Scope) -> bool:
        """Return whether a request is for the dashboard with ``embed=1``, and embedding is configured."""
        if not self.origins or DASHBOARD.fullmatch(scope["path"]) is None:
            return False
        return parse_qs(scope["query_string"].decode("latin-1")).get("embed") == ["1"]
