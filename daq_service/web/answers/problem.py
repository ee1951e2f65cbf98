"""Problem details (RFC 9457): every error answer of the service has one shape.

::

    Problem (raised by the routes)
    ├── type      urn:solimon:problem:<name>, stable
    ├── title, status, detail, hint
    ├── instance  the requested path
    ├── request_id, also in the header X-Request-ID and in the log
    └── errors    of a 422: [{in, pointer (RFC 6901), detail}]
"""

from __future__ import annotations

import logging
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

import orjson
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import Match
from starlette.types import Scope

from daq_service.errors import SolimonError, StorageError

MEDIA_TYPE = "application/problem+json"
RETRY_AFTER_S = {429: "6", 503: "1"}
TYPE_PREFIX = "urn:solimon:problem:"
METHODS = ("DELETE", "GET", "HEAD", "PATCH", "POST", "PUT")
log = logging.getLogger(__name__)


class InvalidPart(BaseModel):
    """Invalid part of a request."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True)
    location: str = Field(alias="in", description="path, query, header or body")
    pointer: str = Field(description="JSON pointer (RFC 6901) to the value inside that part")
    detail: str


class ProblemDetails(BaseModel):
    """Body of every error answer."""

    model_config = ConfigDict(extra="forbid")
    type: str
    title: str
    status: int
    detail: str
    hint: str
    instance: str
    request_id: str
    errors: list[InvalidPart] | None = None


class ProblemType(BaseModel, frozen=True, extra="forbid"):
    """Type of a problem (RFC 9457); a problem may state a title or a hint of its own."""

    status: int
    title: str
    hint: str = ""


PROBLEM_TYPES = TypeAdapter(Mapping[str, ProblemType]).validate_python(
    tomllib.loads(Path(__file__).with_name("problems.toml").read_text(encoding="utf-8"))
)


class Problem(Exception):  # noqa: N818 - the RFC's word
    """Error that is answered as problem details; ``name`` is one of `PROBLEM_TYPES`."""

    def __init__(self, name: str, detail: str, hint: str = "", *, title: str = "", status: int = 0) -> None:
        super().__init__(detail)
        kind = PROBLEM_TYPES[name]
        self.name, self.detail = name, detail
        self.status, self.title, self.hint = status or kind.status, title or kind.title, hint or kind.hint


def create_no_data_error() -> Problem:
    """Create, without raising it, the error that nothing is recorded yet (503)."""
    return Problem("no-data-yet", "No record has been stored in this data folder so far.")


def create_catalogue_lost(detail: str) -> Problem:
    """Create, without raising it, the error that the catalogue is lost and must be rebuilt (503).

    ``detail`` describes the loss and its remedy (`describe_loss`); it must not be empty.
    """
    return Problem("catalogue-lost", f"{detail[0].upper()}{detail[1:]}.")


def not_found(what: str, hint: str) -> Problem:
    """Create, without raising it, the error (404) that a resource does not exist: ``what`` states it."""
    return Problem("not-found", what, hint)


def conflict(detail: str, hint: str) -> Problem:
    """Create, without raising it, the error that a request conflicts with the present state (409)."""
    return Problem("conflict", detail, hint)


def invalid(title: str, detail: str, hint: str) -> Problem:
    """Create, without raising it, the error of an invalid request (422)."""
    return Problem("invalid-request", detail, hint, title=title)


def read_request_id(scope: Scope) -> str:
    """Return the id that `guards.RequestGuard` assigned to a request; empty without one."""
    return str(scope.get("state", {}).get("request_id", ""))


def build_problem_response(
    scope: Scope, problem: Problem, errors: Sequence[Mapping[str, str]] | None = None
) -> Response:
    """Build the response of an error as problem details (RFC 9457), with its status and headers.

    ``errors`` are the invalid parts of a request. Depending on the status it has Retry-After (429, 503),
    WWW-Authenticate (401) or Connection: close (408).
    """
    body: dict[str, object] = {
        "type": TYPE_PREFIX + problem.name,
        "title": problem.title,
        "status": problem.status,
        "detail": problem.detail,
        "hint": problem.hint,
        "instance": scope.get("path", ""),
        "request_id": read_request_id(scope),
    }
    if errors is not None:
        body["errors"] = list(errors)
    # A fault is answered outside of the guard, which sets these on every other response.
    headers = {
        "Cache-Control": "no-store",
        "X-Content-Type-Options": "nosniff",
        "X-Request-ID": read_request_id(scope),
    }
    if problem.status in RETRY_AFTER_S:
        headers["Retry-After"] = RETRY_AFTER_S[problem.status]
    if problem.status == 401:
        headers["WWW-Authenticate"] = "Bearer"
    if problem.status == 408:
        headers["Connection"] = "close"
    return Response(orjson.dumps(body), problem.status, headers, MEDIA_TYPE)


def to_pointer(parts: Sequence[str | int]) -> str:
    """Format a path of keys and indices as JSON pointer (RFC 6901); empty for an empty path."""
    return "".join("/" + str(part).replace("~", "~0").replace("/", "~1") for part in parts)


def _list_allowed_methods(app: FastAPI, of_request: Scope) -> list[str]:
    """List the HTTP methods of all routes that match a request's path; Starlette lists those of one route."""
    scopes = [
        {name: of_request[name] for name in ("type", "path", "root_path", "headers")} | {"method": method}
        for method in METHODS
    ]
    return [
        str(scope["method"])
        for scope in scopes
        if any(route.matches(scope)[0] == Match.FULL for route in app.router.routes)
    ]


def install_error_handlers(app: FastAPI) -> None:
    """Install the handlers that answer every error of the application with problem details.

    Problem and HTTPException: their own status; invalid parameters: 422; StorageError: 503; any other
    exception: 500. The last two are logged.
    """

    async def answer_problem(request: Request, error: Exception) -> Response:
        """Answer a Problem with its own status and details."""
        assert isinstance(error, Problem)
        return build_problem_response(request.scope, error)

    async def answer_invalid_request(request: Request, error: Exception) -> Response:
        """Answer a request that fails validation with all its invalid parts (422)."""
        assert isinstance(error, RequestValidationError)
        errors = [
            {"in": str(part["loc"][0]), "pointer": to_pointer(part["loc"][1:]), "detail": part["msg"]}
            for part in error.errors()
        ]
        problem = invalid(
            "The request is not valid",
            "; ".join(f"{part['in']} {part['pointer']}: {part['detail']}" for part in errors),
            "Correct the parts listed in `errors`; /api/v1/openapi.json describes them.",
        )
        return build_problem_response(request.scope, problem, errors)

    async def answer_http_error(request: Request, error: Exception) -> Response:
        """Answer an error of the router: unknown path (404), method (405, with Allow), bad request (400)."""
        assert isinstance(error, HTTPException)
        names = {404: "not-found", 405: "method-not-allowed", 400: "bad-request"}
        problem = Problem(
            names.get(error.status_code, "http-error"),
            f"{request.method} {request.url.path}: {error.detail}.",
            "/api/v1/openapi.json lists the paths and methods.",
            title=str(error.detail),
            status=error.status_code,
        )
        response = build_problem_response(request.scope, problem)
        response.headers.update(error.headers or {})
        if error.status_code == 405:
            response.headers["Allow"] = ", ".join(_list_allowed_methods(app, request.scope))
        return response

    async def answer_storage_error(request: Request, error: Exception) -> Response:
        """Log and answer an error of the storage (503)."""
        assert isinstance(error, SolimonError)
        log.error("request %s %s: %s", read_request_id(request.scope), request.url.path, error)
        problem = Problem("storage-unavailable", str(error))
        return build_problem_response(request.scope, problem)

    async def answer_internal_error(request: Request, error: Exception) -> Response:
        # The server logs the traceback directly after this line.
        """Log and answer an unexpected exception (500)."""
        log.error("request %s %s failed: %r", read_request_id(request.scope), request.url.path, error)
        problem = Problem(
            "internal-error",
            f"{type(error).__name__} while answering; the log has the cause.",
            f"Look for request {read_request_id(request.scope)} in logs/web.log and report it.",
        )
        return build_problem_response(request.scope, problem)

    app.add_exception_handler(Problem, answer_problem)
    app.add_exception_handler(RequestValidationError, answer_invalid_request)
    app.add_exception_handler(HTTPException, answer_http_error)
    app.add_exception_handler(StorageError, answer_storage_error)
    app.add_exception_handler(Exception, answer_internal_error)
