"""`/api/v1/environment`: what supply and climate probe said around the sets."""

from __future__ import annotations

from fastapi import APIRouter

from daq_service.web.answers import cursors
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import EnvironmentNow, EnvironmentPage, problems
from daq_service.web.context import ContextOf
from daq_service.web.routes.listing import CursorText, FromHour, Limit, ToHour, last_hour, listing_name, page

router = APIRouter(tags=["environment"])


@router.get(
    "/environment",
    operation_id="list_environment",
    response_model=EnvironmentPage,
    responses=problems(422, 503),
)
def list_environment(
    context: ContextOf,
    from_h: FromHour = None,
    to_h: ToHour = None,
    cursor: CursorText = None,
    limit: Limit = 100,
) -> JsonAnswer:
    """List supply and climate, one row a set; no rows where neither is configured."""
    last_h = last_hour(from_h, to_h)
    name = listing_name("environment", from_h=from_h, to_h=to_h)
    after = cursors.decode(name, cursor)
    rows = context.catalogue().list_environment(
        after_id=after or 0, limit=limit + 1, first_h=from_h, last_h=last_h
    )
    return page(context.freshness(), name, rows, limit)


@router.get(
    "/environment/latest",
    operation_id="get_latest_environment",
    response_model=EnvironmentNow,
    responses=problems(503),
)
def get_latest_environment(context: ContextOf) -> JsonAnswer:
    """Tell the newest row; null where there is none."""
    fresh = context.freshness()
    row = context.catalogue().last_environment()
    return JsonAnswer({"as_of": fresh.as_of(), "latest": None if row is None else fresh.row(row)})
