"""`/api/v1/sets`: planned and unscheduled sets with their results; the shots of a set."""

from __future__ import annotations

from fastapi import APIRouter

from daq_service.catalogue.rows import SetRow, SetState, ShotRow
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import SetPage, ShotPage, problems
from daq_service.web.answers.problem import not_found
from daq_service.web.context import ContextOf
from daq_service.web.routes.listing import HOURS, POSITION, PURPOSE, SET_INDEX, SetOfPath, add_listing
from hardware_drivers.measurement import SetKey

router = APIRouter(tags=["sets"])
add_listing(
    router,
    "sets",
    SetRow,
    SetPage,
    "List one row a set and position, in the order in which they were stored.",
    POSITION | {"state": (SetState | None, None)} | SET_INDEX | HOURS | PURPOSE,
)


@router.get(
    "/sets/{position}/{set_index}/shots",
    operation_id="list_shots",
    response_model=ShotPage,
    responses=problems(404, 422, 503),
)
def list_shots(context: ContextOf, position: str, set_index: SetOfPath) -> JsonAnswer:
    """List the stored shots of one set, in one page."""
    context.checked_position(position)
    fresh = context.freshness()
    rows = context.catalogue().rows(ShotRow, position=position, **SetKey.parse(set_index)._asdict())
    if not rows:
        raise not_found(
            f"No shot of position {position}, set {set_index} is stored.", "/api/v1/sets lists the sets."
        )
    items = [fresh.row(row) for row in rows]
    return JsonAnswer({"as_of": fresh.as_of(), "next_cursor": None, "items": items})
