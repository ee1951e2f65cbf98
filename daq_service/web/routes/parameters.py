"""Check for unknown query parameters, so that a misspelt filter does not give a wrong result."""

from __future__ import annotations

import difflib

from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from starlette.requests import HTTPConnection


async def refuse_unknown_parameters(connection: HTTPConnection) -> None:
    """Raise a problem for unknown query parameters; a dependency of every route of the API.

    As a coroutine it needs no thread. WebSockets are not checked.

    Raises
    ------
    RequestValidationError
        422: each unknown name, with the nearest known one.
    """
    route = connection.scope.get("route")
    if not isinstance(route, APIRoute):
        return  # a WebSocket: its route checks itself
    known = sorted(field.alias for field in route.dependant.query_params)
    unknown = [name for name in connection.query_params if name not in known]
    if unknown:
        raise RequestValidationError(
            [{"loc": ("query", name), "msg": _suggest_remedy(name, known)} for name in dict.fromkeys(unknown)]
        )


def _suggest_remedy(name: str, known: list[str]) -> str:
    """Return a message about an unknown parameter: the similar one, or else all known ones."""
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    if near:
        return f"unknown parameter; did you mean {near[0]}?"
    return f"unknown parameter; there are {', '.join(known)}" if known else "this resource has no parameters"
