"""`/api/v1/tokens`: administration of access tokens, as with `solimon token`."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Request
from pydantic import Field
from starlette.responses import Response

from daq_service.commands.kinds import Strict
from daq_service.errors import UsageError
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import NewToken, TokenEntry, TokenList, describe_errors
from daq_service.web.answers.problem import conflict
from daq_service.web.auth.roles import CLAIMED, Role
from daq_service.web.auth.tokens import Token, create_token, read_tokens, revoke_token
from daq_service.web.context import ContextOf
from daq_service.web.routes.admission import PersonOf, write_audit_entry

router = APIRouter(tags=["tokens"])


class TokenRequest(Strict):
    """Body of a request for a new token: name, role and lifetime."""

    name: str = Field(min_length=1, max_length=40, description="Who will use it; commands bear this name")
    role: Role
    days: float | None = Field(default=None, gt=0.0, le=36_500.0, description="Until it expires; null: never")


@router.get("/tokens", response_model=TokenList, responses=describe_errors(503))
def list_tokens(context: ContextOf) -> JsonAnswer:
    """List all tokens in the order of creation, also revoked and expired ones, without their secret text."""
    return JsonAnswer(
        {"items": [build_token_row(token) for token in read_tokens(context.access_policy.tokens_path)]}
    )


@router.post(
    "/tokens",
    name="create_token",
    status_code=201,
    response_model=NewToken,
    responses=describe_errors(400, 403, 409, 413, 503),
)
def create_access_token(
    token_request: TokenRequest, request: Request, person: PersonOf, context: ContextOf
) -> Response:
    """Create a token, and audit the request; its secret text is only in this response.

    Answered with 409 for an invalid name or one with a valid token, and (not audited) before a first token
    exists.
    """
    if person.role == CLAIMED:
        raise conflict(
            "The first token decides who may come in, and is not made over the network.",
            "Make it on the computer itself: `solimon token create NAME --role admin`.",
        )
    try:
        token, text = create_token(
            context.access_policy.tokens_path, token_request.name, token_request.role, days=token_request.days
        )
    except UsageError as error:
        write_audit_entry(
            request, person, "create_token", "rejected", str(error), arguments=token_request.model_dump()
        )
        raise conflict(f"{error}.", "Choose another name, or revoke the one there is.") from None
    write_audit_entry(request, person, "create_token", "done", arguments=token_request.model_dump())
    return JsonAnswer({**build_token_row(token), "token": text}, status_code=201)


@router.delete(
    "/tokens/{name}", name="revoke_token", response_model=TokenEntry, responses=describe_errors(403, 409, 503)
)
def revoke_access_token(
    name: Annotated[str, Path(max_length=40)], request: Request, person: PersonOf, context: ContextOf
) -> Response:
    """Revoke a token, and audit the request; its open streams end within seconds.

    Answered with 409 if there is no unrevoked token of this name.
    """
    try:
        token = revoke_token(context.access_policy.tokens_path, name)
    except UsageError as error:
        write_audit_entry(request, person, "revoke_token", "rejected", str(error), arguments={"name": name})
        raise conflict(f"{error}.", "/api/v1/tokens lists them.") from None
    write_audit_entry(request, person, "revoke_token", "done", arguments={"name": name})
    return JsonAnswer(build_token_row(token))


def build_token_row(token: Token) -> dict[str, object]:
    """Return name, role, state and times of a token for an answer, without the hash of its text."""
    return {name: getattr(token, name) for name in TokenEntry.model_fields}
