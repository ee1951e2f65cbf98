"""`/api/v1/tokens`: an administrator makes and revokes access tokens, as `solimon token` does."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Request
from pydantic import Field
from starlette.responses import Response

from daq_service.commands.kinds import Strict
from daq_service.errors import UsageError
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import NewToken, TokenEntry, TokenList, problems
from daq_service.web.answers.problem import conflict
from daq_service.web.auth.roles import CLAIMED, Role
from daq_service.web.auth.tokens import Token, create_token, read_tokens, revoke_token
from daq_service.web.context import ContextOf
from daq_service.web.routes.admission import PersonOf, told

router = APIRouter(tags=["tokens"])


class TokenWanted(Strict):
    """For whom, and what it shall allow."""

    name: str = Field(min_length=1, max_length=40, description="Who will use it; orders bear this name")
    role: Role
    days: float | None = Field(default=None, gt=0.0, le=36_500.0, description="Until it expires; null: never")


@router.get("/tokens", operation_id="list_tokens", response_model=TokenList, responses=problems(503))
def list_tokens(context: ContextOf) -> JsonAnswer:
    """List all tokens, revoked and expired ones too; what opens is stored nowhere."""
    return JsonAnswer({"items": [token_row(token) for token in read_tokens(context.doors.tokens_path)]})


@router.post(
    "/tokens",
    operation_id="create_token",
    status_code=201,
    response_model=NewToken,
    responses=problems(400, 403, 409, 413, 422, 503),
)
def make_token(wanted: TokenWanted, request: Request, person: PersonOf, context: ContextOf) -> Response:
    """Make a token; its text is told in this answer and never again."""
    if person.role == CLAIMED:
        raise conflict(
            "The first token decides who may come in, and is not made over the network.",
            "Make it on the computer itself: `solimon token create NAME --role admin`.",
        )
    try:
        token, text = create_token(context.doors.tokens_path, wanted.name, wanted.role, days=wanted.days)
    except UsageError as error:
        told(request, person, "create_token", "refused", str(error), arguments=wanted.model_dump())
        raise conflict(f"{error}.", "Choose another name, or revoke the one there is.") from None
    told(request, person, "create_token", "done", arguments=wanted.model_dump())
    return JsonAnswer({**token_row(token), "token": text}, status_code=201)


@router.delete(
    "/tokens/{name}",
    operation_id="revoke_token",
    response_model=TokenEntry,
    responses=problems(403, 409, 422, 503),
)
def take_token(
    name: Annotated[str, Path(max_length=40)], request: Request, person: PersonOf, context: ContextOf
) -> Response:
    """Let a token open nothing any more; streams that it opened end within seconds."""
    try:
        token = revoke_token(context.doors.tokens_path, name)
    except UsageError as error:
        told(request, person, "revoke_token", "refused", str(error), arguments={"name": name})
        raise conflict(f"{error}.", "/api/v1/tokens lists them.") from None
    told(request, person, "revoke_token", "done", arguments={"name": name})
    return JsonAnswer(token_row(token))


def token_row(token: Token) -> dict[str, Any]:
    """Return what may be told of a token."""
    return {
        name: getattr(token, name)
        for name in ("name", "role", "state", "created_utc", "expires_utc", "revoked_utc")
    }
