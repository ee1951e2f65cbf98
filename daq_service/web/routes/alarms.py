"""`/api/v1/alarms`: alarms with state and evidence."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Query

from daq_service.alarms.transitions import transition
from daq_service.catalogue.rows import AlarmRow, AlarmState, EventRow, Priority
from daq_service.commands.kinds import LARGEST_ID
from daq_service.web.answers import models
from daq_service.web.answers.json_answer import JsonAnswer, with_utc
from daq_service.web.answers.problem import not_found
from daq_service.web.context import ContextOf
from daq_service.web.routes.listing import HOURS, POSITION, add_listing

router = APIRouter(tags=["alarms"])
ERRORS = models.problems(404, 503)
ACTIVE = Annotated[bool | None, Query(description="true: not closed; false: closed; absent: all")]
add_listing(
    router,
    "alarms",
    AlarmRow,
    models.AlarmPage,
    "List alarms in the order they were raised.",
    POSITION
    | HOURS
    | {
        "active": (ACTIVE, None),
        "state": (Annotated[AlarmState | None, Query(description="Only this state")], None),
        "priority": (Annotated[Priority | None, Query(description="Only this priority")], None),
        "kind": (Annotated[str | None, Query(max_length=50, description="Only this kind")], None),
    },
)


@router.get("/alarms/{alarm_id}", response_model=models.AlarmRow, responses=ERRORS)
def get_alarm(alarm_id: Annotated[int, Path(ge=1, le=LARGEST_ID)], context: ContextOf) -> JsonAnswer:
    """Return one alarm with its evidence."""
    row = context.catalogue().alarm(alarm_id)
    if row is None:
        raise not_found(f"There is no alarm {alarm_id}.", "/api/v1/alarms lists them.")
    return JsonAnswer(context.freshness().row(row))


@router.get("/alarms/{alarm_id}/history", response_model=models.AlarmHistory, responses=ERRORS)
def get_alarm_history(alarm_id: Annotated[int, Path(ge=1, le=LARGEST_ID)], context: ContextOf) -> JsonAnswer:
    """Return every transition of an alarm, the oldest first, with time, person and reason."""
    catalogue, fresh = context.catalogue(), context.freshness()
    row = catalogue.alarm(alarm_id)
    if row is None:
        raise not_found(f"There is no alarm {alarm_id}.", "/api/v1/alarms lists them.")
    events = catalogue.rows(EventRow, topic="alarms", position=row.position)
    items = [
        with_utc(transition(event), fresh.epoch_utc_ns)
        for event in events
        if event.payload.get("alarm_id") == alarm_id
    ]
    return JsonAnswer({"as_of": fresh.as_of(), "items": items})
