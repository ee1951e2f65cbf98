"""`/api/v1/sets`: planned sets and what became of them; the shots of one."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Path

from daq_service.web.answers import cursors
from daq_service.web.answers.json_answer import NS_PER_H, JsonAnswer, with_utc
from daq_service.web.answers.models import SetPage, ShotPage, problems
from daq_service.web.answers.problem import not_found
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

router = APIRouter(tags=["sets"])
ERRORS = problems(404, 422, 503)


@router.get("/sets", operation_id="list_sets", response_model=SetPage, responses=ERRORS)
def list_sets(
    context: ContextOf,
    position: PositionFilter = None,
    state: Literal["done", "partial", "missed", "retired"] | None = None,
    from_h: FromHour = None,
    to_h: ToHour = None,
    cursor: CursorText = None,
    limit: Limit = 100,
) -> JsonAnswer:
    """List one row a planned set and position, in the order in which they were stored."""
    if position is not None:
        context.known(position)
    last_hour(from_h, to_h)
    name = listing_name("sets", position=position, state=state, from_h=from_h, to_h=to_h)
    after = cursors.decode(name, cursor)
    fresh = context.freshness()
    rows = context.catalogue().list_sets(
        position=position,
        state=state,
        after_id=after or 0,
        limit=limit + 1,
        since_utc_ns=None if from_h is None else fresh.epoch_utc_ns + round(from_h * NS_PER_H),
        until_utc_ns=None if to_h is None else fresh.epoch_utc_ns + round(to_h * NS_PER_H),
    )
    return page(fresh, name, rows, limit)


@router.get(
    "/sets/{position}/{set_index}/shots", operation_id="list_shots", response_model=ShotPage, responses=ERRORS
)
def list_shots(
    context: ContextOf, position: str, set_index: Annotated[int, Path(ge=0, le=LARGEST_INDEX)]
) -> JsonAnswer:
    """List the stored shots of one set; there are never many, so there is one page."""
    context.known(position)
    fresh = context.freshness()
    rows = context.catalogue().list_shots(position, set_index)
    if not rows:
        raise not_found(
            f"No shot of position {position}, set {set_index} is stored.", "/api/v1/sets lists the sets."
        )
    items = [with_utc(row, fresh.epoch_utc_ns) for row in rows]
    return JsonAnswer({"as_of": fresh.as_of(), "next_cursor": None, "items": items})
