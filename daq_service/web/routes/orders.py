"""`/api/v1/commands`: orders for the recorder. A row is written here; the recorder carries it out."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request
from pydantic import Field
from starlette.responses import Response

from daq_service.catalogue.rows import AlarmRow, values
from daq_service.errors import StorageError
from daq_service.orders.deadline import look_at_order
from daq_service.orders.kinds import (
    LARGEST_ID,
    AcknowledgeAlarm,
    AlarmArguments,
    AnyOrder,
    Author,
    Facts,
    Order,
    Strict,
)
from daq_service.web.answers.json_answer import JsonAnswer, with_utc
from daq_service.web.answers.models import CommandRow, problems
from daq_service.web.answers.problem import Problem, conflict, not_found
from daq_service.web.context import Context, ContextOf
from daq_service.web.doors.roles import ORDERS, Person
from daq_service.web.routes.admission import PersonOf, role_too_low, told
from hardware_drivers.methods import SOLITARY_WAVE

router = APIRouter(tags=["commands"])


class Acknowledgement(Strict):
    """Body of an acknowledgement."""

    author: Author = "operator"
    note: str = Field(default="", max_length=2000)


ACCEPTED = problems(400, 403, 404, 409, 413, 422, 503)


@router.post(
    "/commands", operation_id="create_command", status_code=202, response_model=CommandRow, responses=ACCEPTED
)
def create_command(command: AnyOrder, context: ContextOf, request: Request, person: PersonOf) -> Response:
    """Write an order; the recorder carries it out within 60 s, or it expires (see its `state`).

    With a token the author is the token's, whatever the body says.
    """
    return _audited(context, request, person, command)


@router.post(
    "/alarms/{alarm_id}/acknowledge",
    operation_id="acknowledge_alarm",
    status_code=202,
    response_model=CommandRow,
    responses=ACCEPTED,
)
def acknowledge_alarm(
    alarm_id: Annotated[int, Path(ge=1, le=LARGEST_ID)],
    body: Acknowledgement,
    context: ContextOf,
    request: Request,
    person: PersonOf,
) -> Response:
    """Say that an operator has seen an alarm; the same as the command `acknowledge_alarm`."""
    arguments = AlarmArguments(alarm_id=alarm_id, note=body.note)
    order = AcknowledgeAlarm(kind="acknowledge_alarm", author=body.author, arguments=arguments)
    return _audited(context, request, person, order)


@router.get(
    "/commands/{command_id}",
    operation_id="get_command",
    response_model=CommandRow,
    responses=problems(404, 422, 503),
)
def get_command(command_id: Annotated[int, Path(ge=1, le=LARGEST_ID)], context: ContextOf) -> JsonAnswer:
    """Tell what became of an order."""
    return JsonAnswer(_row(context, command_id))


def _audited(context: Context, request: Request, person: Person, order: Order) -> Response:
    """Write an order in the name of who gives it, and into the audit what came of it."""
    tell = partial(
        told, request, person, order.kind, claimed=order.author, arguments=order.arguments.model_dump()
    )
    try:
        if not person.may(ORDERS.get(order.kind, "admin")):
            raise role_too_low(person, order.kind, ORDERS.get(order.kind, "admin"))
        command_id = _written(context, order, person.name or order.author)
    except (Problem, StorageError) as refusal:
        tell("refused", str(refusal))
        raise
    tell("accepted", command_id=command_id)
    return JsonAnswer(
        _row(context, command_id), status_code=202, headers={"Location": f"/api/v1/commands/{command_id}"}
    )


def _written(context: Context, order: Order, author: str) -> int:
    """Write an order that nothing forbids."""
    catalogue = context.catalogue()
    facts = Facts(
        recorder=context.freshness().recorder.word,
        can_skip_time=context.settings.clock.is_paced,
        held=catalogue.held() or "",
        positions=context.settings.names_of(SOLITARY_WAVE),
        has_supply=context.settings.rig.driven is not None,
        alarms=catalogue.rows(AlarmRow),
    )
    refusal = order.forbidden(facts)
    if refusal is not None:
        raise (not_found if refusal.missing else conflict)(refusal.detail, refusal.hint)
    return catalogue.add_command(author, order.kind, order.arguments.model_dump())


def _row(context: Context, command_id: int) -> dict[str, Any]:
    found = look_at_order(context.catalogue(), command_id)
    if found is None:
        raise not_found(
            f"There is no command {command_id}.", "Ids come from the answer that accepted the command."
        )
    row, seconds_left = found
    expires_in_s = seconds_left if row.state == "pending" else None
    return with_utc({**values(row), "expires_in_s": expires_in_s}, 0)
