"""`/api/v1/commands`: orders. The recorder carries them out; where nobody records, some are done here."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Request
from pydantic import Field
from starlette.responses import Response

from daq_service.alarms.states import Moment
from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import AlarmRow, AnnotationRow, values
from daq_service.commands.audit import Result
from daq_service.commands.deadline import command_state
from daq_service.commands.kinds import (
    LARGEST_ID,
    AcknowledgeAlarm,
    AlarmArguments,
    Author,
    DeskOrder,
    Facts,
    Order,
    OrderRefusedError,
    Strict,
)
from daq_service.commands.registry import AnyOrder
from daq_service.commands.without_recorder import carry_out_unattended
from daq_service.errors import BusyError, StorageError
from daq_service.processes.data_folder import is_owned
from daq_service.web.answers.json_answer import JsonAnswer, with_utc
from daq_service.web.answers.models import CommandRow, problems
from daq_service.web.answers.problem import Problem, conflict, not_found
from daq_service.web.auth.roles import ORDERS, Person
from daq_service.web.context import Context, ContextOf
from daq_service.web.routes.admission import PersonOf, role_too_low, told
from hardware_drivers.methods import SOLITARY_WAVE

router = APIRouter(tags=["commands"])


class Acknowledgement(Strict):
    """Body of an acknowledgement."""

    author: Author = "operator"
    note: str = Field(default="", max_length=2000)


Give = Callable[[Order], Response]
"""Writes an order in the name of who gives it, or carries it out, and answers with its row."""


async def _give_of(context: ContextOf, request: Request, person: PersonOf) -> Give:
    return partial(_audited, context, request, person)


GiveOf = Annotated[Give, Depends(_give_of)]
ACCEPTS: Any = {
    "status_code": 202,
    "response_model": CommandRow,
    "responses": problems(400, 403, 404, 409, 413, 422, 503),
}


@router.post("/commands", operation_id="create_command", **ACCEPTS)
def create_command(command: AnyOrder, give: GiveOf) -> Response:
    """Write an order; the recorder carries it out within 60 s, or it expires (see its `state`).

    Where nobody records the test, an order that changes no more than what is stored (an acknowledgement) is
    done when this answers; any other is refused (409).
    With a token the author is the token's, whatever the body says.
    """
    return give(command)


@router.post("/alarms/{alarm_id}/acknowledge", operation_id="acknowledge_alarm", **ACCEPTS)
def acknowledge_alarm(
    alarm_id: Annotated[int, Path(ge=1, le=LARGEST_ID)], body: Acknowledgement, give: GiveOf
) -> Response:
    """Say that an operator has seen an alarm; the same as the command `acknowledge_alarm`."""
    arguments = AlarmArguments(alarm_id=alarm_id, note=body.note)
    return give(AcknowledgeAlarm(kind="acknowledge_alarm", author=body.author, arguments=arguments))


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
        order = order.model_copy(update={"author": person.name or order.author})
        command_id, result = _given(context, order)
    except (Problem, StorageError) as refusal:
        tell("refused", str(refusal))
        raise
    tell(result, command_id=command_id)
    return JsonAnswer(
        _row(context, command_id), status_code=202, headers={"Location": f"/api/v1/commands/{command_id}"}
    )


def _given(context: Context, order: Order) -> tuple[int, Result]:
    """Write an order that nothing forbids, or carry it out where nobody records; its id, and which."""
    catalogue = context.catalogue()
    try:
        if isinstance(order, DeskOrder) and is_owned(context.data_folder) is False:
            with suppress(BusyError):  # a recorder has come meanwhile: it is given the order
                return _carried_out(context, order), "done"
        order.refuse_forbidden(_facts(context, catalogue))
    except OrderRefusedError as error:
        refusal = error.refusal
        raise (not_found if refusal.missing else conflict)(refusal.detail, refusal.hint) from None
    return catalogue.add_command(order.author, order.kind, order.arguments.model_dump()), "accepted"


def _carried_out(context: Context, order: DeskOrder) -> int:
    def moment() -> Moment:
        now = context.freshness()
        return Moment(utc_ns=now.now_utc_ns, due_h=now.now_h, set_index=None)

    facts = partial(_facts, context)
    return carry_out_unattended(context.data_folder, order, facts=facts, moment=moment)


def _facts(context: Context, catalogue: Catalogue) -> Facts:
    return Facts(
        recorder=context.freshness().recorder.status,
        recorded=is_owned(context.data_folder) is not False,
        can_skip_time=context.settings.clock.is_paced,
        held=catalogue.held() or "",
        positions=context.settings.names_of(SOLITARY_WAVE),
        has_supply=context.settings.rig.driven is not None,
        alarms=list(map(context.freshness().standing, catalogue.rows(AlarmRow))),
        places=catalogue.position_names(),
        annotations=catalogue.rows(AnnotationRow),
        baselines=catalogue.newest_baselines(),
    )


def _row(context: Context, command_id: int) -> dict[str, Any]:
    found = command_state(context.catalogue(), command_id)
    if found is None:
        raise not_found(
            f"There is no command {command_id}.", "Ids come from the answer that accepted the command."
        )
    row, seconds_left = found
    expires_in_s = seconds_left if row.state == "pending" else None
    return with_utc({**values(row), "expires_in_s": expires_in_s}, 0)
