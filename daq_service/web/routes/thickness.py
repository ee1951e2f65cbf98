"""`/api/v1/thickness`: what the ultrasonic probe says of the wall."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from daq_service.web.answers import cursors
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import ThicknessPage, problems
from daq_service.web.context import ContextOf
from daq_service.web.routes.listing import (
    LARGEST_INDEX,
    CursorText,
    FromHour,
    Limit,
    PositionFilter,
    ToHour,
    last_hour,
    listing_name,
    page,
)

router = APIRouter(tags=["thickness"])


@router.get(
    "/thickness",
    operation_id="list_thickness",
    response_model=ThicknessPage,
    responses=problems(404, 422, 503),
)
def list_thickness(
    context: ContextOf,
    position: PositionFilter = None,
    set_index: Annotated[int | None, Query(ge=0, le=LARGEST_INDEX)] = None,
    from_h: FromHour = None,
    to_h: ToHour = None,
    cursor: CursorText = None,
    limit: Limit = 100,
) -> JsonAnswer:
    """List pulse-echo results with their quality and age."""
    if position is not None:
        context.known(position)
    last_h = last_hour(from_h, to_h)
    name = listing_name("thickness", position=position, set_index=set_index, from_h=from_h, to_h=to_h)
    after = cursors.decode(name, cursor)
    rows = context.catalogue().list_thickness(
        position=position,
        first_h=from_h,
        last_h=last_h,
        after_id=after or 0,
        limit=limit + 1,
        set_index=set_index,
    )
    return page(context.freshness(), name, rows, limit)
