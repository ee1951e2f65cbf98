"""`/api/v1/commands`: commands, executed by the recorder; without a recorder, some are executed here."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Depends, Request
from pydantic import Field
from starlette.responses import Response

from daq_service.alarms.states import Moment
from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import AlarmRow, AnnotationRow, as_dict
from daq_service.commands import kinds
from daq_service.commands.audit import Result
from daq_service.commands.deadline import read_command_state
from daq_service.commands.registry import AnyCommand
from daq_service.commands.without_recorder import execute_without_recorder
from daq_service.errors import BusyError, StorageError
from daq_service.processes.data_folder import is_held
from daq_service.web.answers.json_answer import JsonAnswer, add_utc
from daq_service.web.answers.models import CommandRow, describe_errors
from daq_service.web.answers.problem import Problem, conflict, not_found
from daq_service.web.auth.roles import ORDERS, Person
from daq_service.web.context import Context, ContextOf
from daq_service.web.routes.admission import PersonOf, create_role_too_low, write_audit_entry
from daq_service.web.routes.listing import RowId
from hardware_drivers.methods import SOLITARY_WAVE

router = APIRouter(tags=["commands"])


class Acknowledgement(kinds.Strict):
    """Body of an acknowledgement."""

    author: kinds.Author = "operator"
    note: str = Field(default="", max_length=2000)


ExecuteCommand = Callable[[kinds.Command], Response]
"""Stores a command in the name of its author, or executes it, and returns the response with its row."""


async def _provide_execute(context: ContextOf, request: Request, person: PersonOf) -> ExecuteCommand:
    """Return a function that executes a command for the person of the request, as dependency of routes."""
    return partial(_execute_audited, context, request, person)


ExecuteOf = Annotated[ExecuteCommand, Depends(_provide_execute)]
_accepts = partial(
    router.post,
    status_code=202,
    response_model=CommandRow,
    responses=describe_errors(400, 403, 404, 409, 413, 503),
)


@_accepts("/commands")
def create_command(command: AnyCommand, execute: ExecuteOf) -> Response:
    """Store a command; the recorder executes it within 60 s, or it expires (see its `state`).

    Without a recorder, a command that only changes stored data (an acknowledgement) is executed before the
    response; any other is refused (409). With a token, the author is that of the token. Each is audited.
    """
    return execute(command)


@_accepts("/alarms/{alarm_id}/acknowledge")
def acknowledge_alarm(alarm_id: RowId, body: Acknowledgement, execute: ExecuteOf) -> Response:
    """Acknowledge an alarm; the same as the command `acknowledge_alarm` (404 for an unknown alarm)."""
    arguments = kinds.AlarmArguments(alarm_id=alarm_id, note=body.note)
    return execute(kinds.AcknowledgeAlarm(kind="acknowledge_alarm", author=body.author, arguments=arguments))


@router.get("/commands/{command_id}", response_model=CommandRow, responses=describe_errors(404, 503))
def get_command(command_id: RowId, context: ContextOf) -> JsonAnswer:
    """Return a command with its state, its result and, while pending, the time in s until it expires.

    Answered with 404 if it does not exist.
    """
    return JsonAnswer(_read_command_row(context, command_id))


def _execute_audited(context: Context, request: Request, person: Person, command: kinds.Command) -> Response:
    """Check the role, store or execute a command in the name of its author, and audit the result.

    Returns status 202 with the command. Raises a Problem (403, 404, 409, 503) or StorageError, which are
    audited, too.
    """
    audit = partial(
        write_audit_entry,
        request,
        person,
        command.kind,
        claimed=command.author,
        arguments=command.arguments.model_dump(),
    )
    try:
        if not person.may(ORDERS.get(command.kind, "admin")):
            raise create_role_too_low(person, command.kind, ORDERS.get(command.kind, "admin"))
        command = command.model_copy(update={"author": person.name or command.author})
        command_id, result = _store_or_execute(context, command)
    except (Problem, StorageError) as refusal:
        audit("rejected", str(refusal))
        raise
    audit(result, command_id=command_id)
    return JsonAnswer(
        _read_command_row(context, command_id),
        status_code=202,
        headers={"Location": f"/api/v1/commands/{command_id}"},
    )


def _store_or_execute(context: Context, command: kinds.Command) -> tuple[int, Result]:
    """Store a command for the recorder, or execute one that only changes data if no recorder runs.

    Returns its id, and ``accepted`` or ``done``. Raises a Problem (404, 409) if it is not possible now, and
    StorageError if the catalogue cannot be written.
    """
    catalogue = context.catalogue()
    try:
        if isinstance(command, kinds.StoredCommand) and is_held(context.data_folder) is False:
            with suppress(BusyError):  # a recorder has started meanwhile: it gets the command
                return _execute_without_recorder(context, command), "done"
        command.require_allowed(_collect_facts(context, catalogue))
    except kinds.CommandRejectedError as error:
        refusal = error.refusal
        raise (not_found if refusal.missing else conflict)(refusal.detail, refusal.hint) from None
    return catalogue.add_command(command.author, command.kind, command.arguments.model_dump()), "accepted"


def _execute_without_recorder(context: Context, command: kinds.StoredCommand) -> int:
    """Execute a command in the web service, without a recorder; return its id.

    Raises BusyError if a recorder has started meanwhile, and CommandRejectedError if it is not possible now.
    """

    def read_moment() -> Moment:
        """Return the present time (UTC) and hour of the test."""
        now = context.read_freshness()
        return Moment(utc_ns=now.now_utc_ns, due_h=now.now_h, set_index=None)

    facts = partial(_collect_facts, context)
    return execute_without_recorder(context.data_folder, command, facts=facts, moment=read_moment)


def _collect_facts(context: Context, catalogue: Catalogue) -> kinds.Facts:
    """Read the state of test, recorder, alarms and baselines that decides whether a command is possible.

    Expired shelves are removed from the alarms. Raises a Problem (503) or StorageError if the catalogue
    cannot be read.
    """
    return kinds.Facts(
        recorder=context.read_freshness().recorder.status,
        recorded=is_held(context.data_folder) is not False,
        can_skip_time=context.settings.clock.is_paced,
        paused=catalogue.paused() or "",
        positions=context.settings.list_positions(SOLITARY_WAVE),
        has_supply=context.settings.rig.driven is not None,
        alarms=list(map(context.read_freshness().expire_shelf, catalogue.rows(AlarmRow))),
        places=catalogue.list_position_names(),
        annotations=catalogue.rows(AnnotationRow),
        baselines=catalogue.read_newest_baselines(),
    )


def _read_command_row(context: Context, command_id: int) -> dict[str, object]:
    """Read a command for an answer, with the time in s until it expires (None unless pending).

    Raises a Problem (404) if it does not exist, or (503) without data.
    """
    state_and_time = read_command_state(context.catalogue(), command_id)
    if state_and_time is None:
        raise not_found(
            f"There is no command {command_id}.", "Ids come from the answer that accepted the command."
        )
    row, seconds_left = state_and_time
    expires_in_s = seconds_left if row.state == "pending" else None
    return add_utc({**as_dict(row), "expires_in_s": expires_in_s}, 0)
