"""`/api/v1/session`: the page trades a token for a cookie that no script can read."""

from __future__ import annotations

from asyncio import to_thread

from fastapi import APIRouter, Request
from pydantic import Field
from starlette.responses import Response

from daq_service.commands.kinds import Strict
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import Session, problems
from daq_service.web.answers.problem import Problem
from daq_service.web.auth.middleware import LONGEST_TOKEN, address_of, is_encrypted
from daq_service.web.auth.roles import CLAIMED, Person
from daq_service.web.context import ContextOf
from daq_service.web.routes.admission import told

router = APIRouter(tags=["session"])
COOKIE_S = 30 * 86_400
"""Then the page asks again, whatever the token's own end."""


class LogIn(Strict):
    """A token as `solimon token create` told it."""

    token: str = Field(min_length=1, max_length=LONGEST_TOKEN)


@router.get("/session", operation_id="get_session", response_model=Session)
async def get_session(request: Request) -> JsonAnswer:
    """Tell who asks, and what that person may do; without a token, whether one is needed."""
    return JsonAnswer(_told(request.state.person))


@router.post(
    "/session", operation_id="log_in", response_model=Session, responses=problems(400, 403, 413, 422)
)
async def log_in(body: LogIn, request: Request, context: ContextOf) -> Response:
    """Log the page in: sets a cookie (HttpOnly, SameSite=Strict, over TLS Secure)."""
    try:
        person = context.doors.enter(body.token, address_of(request.scope))
    except Problem as problem:
        if problem.status == 429:
            context.doors.audit.leave_out()
        else:
            await to_thread(told, request, Person(name="", role=""), "log_in", "refused", problem.detail)
        raise
    await to_thread(told, request, person, "log_in", "done")
    response = JsonAnswer(_told(person))
    response.set_cookie(
        context.doors.cookie_name(request.scope),
        body.token,
        max_age=COOKIE_S,
        secure=is_encrypted(request.scope),
        httponly=True,
        samesite="strict",
    )
    return response


@router.delete("/session", operation_id="log_out", response_model=Session, responses=problems(403))
async def log_out(request: Request, context: ContextOf) -> Response:
    """Log the page out: takes the cookie away. The token itself stays valid until it is revoked."""
    person = request.state.person
    if person is not None and person.role != CLAIMED:
        await to_thread(told, request, person, "log_out", "done")
    response = JsonAnswer(_told(person if person is not None and person.role == CLAIMED else None))
    response.delete_cookie(
        context.doors.cookie_name(request.scope),
        secure=is_encrypted(request.scope),
        httponly=True,
        samesite="strict",
    )
    return response


def _told(person: Person | None) -> dict[str, object]:
    if person is None:
        return {"token_needed": True, "name": None, "role": None, "may": []}
    return {
        "token_needed": person.role != CLAIMED,
        "name": person.name or None,
        "role": person.role,
        "may": person.may_do(),
    }
