"""`/api/v1/features`: solitary-wave features of sets or of single shots."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query

from daq_service.web.answers import cursors
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import FeaturePage, problems
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

router = APIRouter(tags=["features"])


@router.get(
    "/features",
    operation_id="list_features",
    response_model=FeaturePage,
    responses=problems(404, 422, 503),
)
def list_features(
    context: ContextOf,
    position: PositionFilter = None,
    scope: Annotated[Literal["set", "shot"], Query(description="Means of sets, or single shots")] = "set",
    set_index: Annotated[int | None, Query(ge=0, le=LARGEST_INDEX)] = None,
    from_h: FromHour = None,
    to_h: ToHour = None,
    cursor: CursorText = None,
    limit: Limit = 100,
) -> JsonAnswer:
    """List features with their quality and age."""
    if position is not None:
        context.known(position)
    last_h = last_hour(from_h, to_h)
    name = listing_name(
        "features", position=position, scope=scope, set_index=set_index, from_h=from_h, to_h=to_h
    )
    after = cursors.decode(name, cursor)
    rows = context.catalogue().list_features(
        position=position,
        scope=scope,
        first_h=from_h,
        last_h=last_h,
        after_id=after or 0,
        limit=limit + 1,
        set_index=set_index,
    )
    return page(context.freshness(), name, rows, limit)
