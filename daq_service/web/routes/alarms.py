"""`/api/v1/alarms/{alarm_id}` and `/api/v1/guidance`: an alarm, its history, and what to do."""

from __future__ import annotations

from dataclasses import asdict

from fastapi import APIRouter

from daq_service.alarms.guidance import GUIDANCE, name_contact
from daq_service.alarms.transitions import build_transition
from daq_service.catalogue.rows import AlarmRow, EventRow
from daq_service.web.answers import models
from daq_service.web.answers.json_answer import JsonAnswer, add_utc
from daq_service.web.answers.problem import not_found
from daq_service.web.context import Context, ContextOf
from daq_service.web.routes.listing import RowId

router = APIRouter(tags=["alarms"])
ERRORS = models.describe_errors(404, 503)


@router.get("/alarms/{alarm_id}", response_model=models.AlarmRow, responses=ERRORS)
def get_alarm(alarm_id: RowId, context: ContextOf) -> JsonAnswer:
    """Return one alarm with its evidence, its age in h and its state at present; 404 without it."""
    return JsonAnswer(context.read_freshness().row(_read_alarm(context, alarm_id)))


@router.get("/alarms/{alarm_id}/history", response_model=models.AlarmHistory, responses=ERRORS)
def get_alarm_history(alarm_id: RowId, context: ContextOf) -> JsonAnswer:
    """Return every transition of an alarm, the oldest first, with time, person and reason; 404 without it."""
    row, fresh = _read_alarm(context, alarm_id), context.read_freshness()
    events = context.catalogue().rows(EventRow, topic="alarms", position=row.position)
    items = [
        add_utc(build_transition(event), fresh.epoch_utc_ns)
        for event in events
        if event.payload.get("alarm_id") == alarm_id
    ]
    return JsonAnswer({"as_of": fresh.as_of(), "items": items})


@router.get("/guidance", response_model=models.GuidanceList)
def list_guidance(context: ContextOf) -> JsonAnswer:
    """List for each kind of alarm its meaning, limitations, checks, action, consequence and contact."""
    contacts = context.settings.alarms.contacts
    items = [
        {"kind": kind, **asdict(guidance), "contact": name_contact(kind, contacts)}
        for kind, guidance in GUIDANCE.items()
    ]
    return JsonAnswer({"items": items})


def _read_alarm(context: Context, alarm_id: int) -> AlarmRow:
    """Read an alarm by its id; raise a Problem (404) if there is none."""
    row = context.catalogue().alarm(alarm_id)
    if row is None:
        raise not_found(f"There is no alarm {alarm_id}.", "/api/v1/alarms lists them.")
    return row
