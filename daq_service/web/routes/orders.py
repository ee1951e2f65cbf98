"""`/api/v1/commands`: orders for the recorder. A row is written here; the recorder carries it out."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Request
from pydantic import Field
from starlette.responses import Response

from daq_service.catalogue.rows import AlarmRow, values
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
from daq_service.web.answers.problem import conflict, not_found
from daq_service.web.context import Context, ContextOf
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
def create_command(command: AnyOrder, context: ContextOf, request: Request) -> Response:
    """Write an order; the recorder carries it out within 60 s, or it expires (see its `state`)."""
    return _written(context, command)


@router.post(
    "/alarms/{alarm_id}/acknowledge",
    operation_id="acknowledge_alarm",
    status_code=202,
    response_model=CommandRow,
    responses=ACCEPTED,
)
def acknowledge_alarm(
    alarm_id: Annotated[int, Path(ge=1, le=LARGEST_ID)], body: Acknowledgement, context: ContextOf
) -> Response:
    """Say that an operator has seen an alarm; the same as the command `acknowledge_alarm`."""
    arguments = AlarmArguments(alarm_id=alarm_id, note=body.note)
    return _written(
        context, AcknowledgeAlarm(kind="acknowledge_alarm", author=body.author, arguments=arguments)
    )


@router.get(
    "/commands/{command_id}",
    operation_id="get_command",
    response_model=CommandRow,
    responses=problems(404, 422, 503),
)
def get_command(command_id: Annotated[int, Path(ge=1, le=LARGEST_ID)], context: ContextOf) -> JsonAnswer:
    """Tell what became of an order."""
    return JsonAnswer(_row(context, command_id))


def _written(context: Context, order: Order) -> Response:
    """Write an order that nothing forbids, and answer with its row."""
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
    command_id = catalogue.add_command(order.author, order.kind, order.arguments.model_dump())
    return JsonAnswer(
        _row(context, command_id), status_code=202, headers={"Location": f"/api/v1/commands/{command_id}"}
    )


def _row(context: Context, command_id: int) -> dict[str, Any]:
    found = look_at_order(context.catalogue(), command_id)
    if found is None:
        raise not_found(
            f"There is no command {command_id}.", "Ids come from the answer that accepted the command."
        )
    row, seconds_left = found
    expires_in_s = seconds_left if row.state == "pending" else None
    return with_utc({**values(row), "expires_in_s": expires_in_s}, 0)
