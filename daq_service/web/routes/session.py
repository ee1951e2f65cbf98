"""`/api/v1/session`: login with a token, which sets a cookie that no script can read."""

from __future__ import annotations

from asyncio import to_thread

from fastapi import APIRouter, Request
from pydantic import Field
from starlette.responses import Response

from daq_service.commands.kinds import Strict
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import Session, describe_errors
from daq_service.web.answers.problem import Problem
from daq_service.web.auth.middleware import LONGEST_TOKEN, find_client_address, is_encrypted
from daq_service.web.auth.roles import CLAIMED, Person
from daq_service.web.context import ContextOf
from daq_service.web.routes.admission import write_audit_entry

router = APIRouter(tags=["session"])
COOKIE_S = 30 * 86_400
"""Lifetime of the cookie, independent of the end of the token."""


class LogIn(Strict):
    """Body of a login: a token of `solimon token create`."""

    token: str = Field(min_length=1, max_length=LONGEST_TOKEN)


@router.get("/session", response_model=Session)
async def get_session(request: Request) -> JsonAnswer:
    """Return the person of the request and their permissions, or that a token is needed; never 401."""
    return JsonAnswer(_build_session(request.state.person))


@router.post("/session", response_model=Session, responses=describe_errors(400, 403, 413))
async def log_in(body: LogIn, request: Request, context: ContextOf) -> Response:
    """Log the page in: sets a cookie (HttpOnly, SameSite=Strict, over TLS Secure) for 30 days.

    A wrong token is answered with 401, too many wrong ones with 429. Logins and wrong tokens are audited;
    those answered with 429 are only counted.
    """
    try:
        person = context.access_policy.authenticate_token(body.token, find_client_address(request.scope))
    except Problem as problem:
        if problem.status == 429:
            context.access_policy.audit.count_omitted_rejection()
        else:
            await to_thread(
                write_audit_entry, request, Person(name="", role=""), "log_in", "rejected", problem.detail
            )
        raise
    await to_thread(write_audit_entry, request, person, "log_in", "done")
    response = JsonAnswer(_build_session(person))
    response.set_cookie(
        context.access_policy.choose_cookie_name(request.scope),
        body.token,
        max_age=COOKIE_S,
        secure=is_encrypted(request.scope),
        httponly=True,
        samesite="strict",
    )
    return response


@router.delete("/session", response_model=Session, responses=describe_errors(403))
async def log_out(request: Request, context: ContextOf) -> Response:
    """Log the page out by deleting its cookie; the token stays valid until it is revoked.

    The logout of a person with a token is audited.
    """
    person = request.state.person
    if person is not None and person.role != CLAIMED:
        await to_thread(write_audit_entry, request, person, "log_out", "done")
    response = JsonAnswer(_build_session(person if person is not None and person.role == CLAIMED else None))
    response.delete_cookie(
        context.access_policy.choose_cookie_name(request.scope),
        secure=is_encrypted(request.scope),
        httponly=True,
        samesite="strict",
    )
    return response


def _build_session(person: Person | None) -> dict[str, object]:
    """Build the answer of a session: name, role and permissions; for None that a token is needed."""
    if person is None:
        return {"token_needed": True, "name": None, "role": None, "may": []}
    return {
        "token_needed": person.role != CLAIMED,
        "name": person.name or None,
        "role": person.role,
        "may": person.list_permissions(),
    }
