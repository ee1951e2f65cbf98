"""`/api/v1/commands`: orders for the recorder. A row is written here; the recorder carries it out."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Request
from pydantic import BaseModel, Field
from starlette.responses import Response

from daq_service.alarms.states import retired_positions
from daq_service.catalogue.rows import AlarmRow, values
from daq_service.orders.kinds import (
    _STRICT,
    LARGEST_ID,
    AcknowledgeAlarm,
    Author,
    Command,
    FinishNow,
    Hold,
    Reinstate,
    Release,
    Retire,
    SupplyOff,
    SupplyOn,
)
from daq_service.web.answers.json_answer import JsonAnswer, with_utc
from daq_service.web.answers.models import CommandRow, problems
from daq_service.web.answers.problem import conflict, not_found
from daq_service.web.context import Context, ContextOf
from daq_service.web.routes.alarms import check_waiting
from daq_service.web.routes.info import is_paced

router = APIRouter(tags=["commands"])


class Acknowledgement(BaseModel):
    """Body of an acknowledgement."""

    model_config = _STRICT
    author: Author = "operator"
    note: str = Field(default="", max_length=2000)


ACCEPTED = problems(400, 403, 404, 409, 413, 422, 503)


@router.post(
    "/commands", operation_id="create_command", status_code=202, response_model=CommandRow, responses=ACCEPTED
)
def create_command(command: Command, context: ContextOf, request: Request) -> Response:
    """Write an order; it is carried out when the recorder reads it (see its `state`)."""
    if isinstance(command, FinishNow) and not is_paced(context.settings):
        raise conflict(
            "This test is not paced: it already runs as fast as its clock allows.",
            "finish_now belongs to a simulated clock with clock.pace_h_per_s, as in `solimon demo`.",
        )
    if isinstance(command, AcknowledgeAlarm):
        check_waiting(context, command.arguments.alarm_id)
    elif (state := context.freshness().recorder) in {"finished", "stopped"}:
        raise conflict(f"The recorder has {state}: nobody would carry this out.", "Start it again first.")
    if isinstance(command, Hold | Release):
        _check_hold(context, command)
    if isinstance(command, Retire | Reinstate):
        _check_transducer(context, command)
    if isinstance(command, SupplyOn | SupplyOff) and context.settings.rig.supply is None:
        raise conflict("This test has no supply.", "Configure [rig.supply] and start the test anew.")
    return _written(context, command.author, command.kind, command.arguments.model_dump())


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
    check_waiting(context, alarm_id)
    return _written(context, body.author, "acknowledge_alarm", {"alarm_id": alarm_id, "note": body.note})


@router.get(
    "/commands/{command_id}",
    operation_id="get_command",
    response_model=CommandRow,
    responses=problems(404, 422, 503),
)
def get_command(command_id: Annotated[int, Path(ge=1, le=LARGEST_ID)], context: ContextOf) -> JsonAnswer:
    """Tell what became of an order."""
    return JsonAnswer(_row(context, command_id))


def _check_hold(context: Context, command: Hold | Release) -> None:
    held = context.catalogue().held()
    if isinstance(command, Hold) and held:
        raise conflict(f"The test is already on hold: {held}.", "Release it first; a hold has one reason.")
    if isinstance(command, Release) and not held:
        raise conflict("The test is not on hold.", "Only a test on hold can be released.")


def _check_transducer(context: Context, command: Retire | Reinstate) -> None:
    position = command.arguments.position
    names = context.settings.names_of("solitary_wave")
    if position not in names:
        raise conflict(
            f"There is no solitary-wave transducer {position!r}.", f"There are: {', '.join(names) or 'none'}."
        )
    retired = retired_positions(context.catalogue().rows(AlarmRow, position=position, active=True)).get(
        position
    )
    if isinstance(command, Retire) and retired is not None:
        raise conflict(f"{position} is retired already: {retired}.", "Reinstate it when it is put right.")
    if isinstance(command, Reinstate) and retired is None:
        raise conflict(f"{position} is not retired.", "/api/v1/transducers tells which are, and why.")


def _written(context: Context, author: str, kind: str, arguments: dict[str, Any]) -> Response:
    command_id = context.catalogue().add_command(author, kind, arguments)
    return JsonAnswer(
        _row(context, command_id), status_code=202, headers={"Location": f"/api/v1/commands/{command_id}"}
    )


def _row(context: Context, command_id: int) -> dict[str, Any]:
    row = context.catalogue().command(command_id)
    if row is None:
        raise not_found(
            f"There is no command {command_id}.", "Ids come from the answer that accepted the command."
        )
    return with_utc(values(row), 0)
