"""`/api/v1/verdicts` and `/api/v1/baselines`: distance, limits, outliers, and against what."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Query

from daq_service.web.answers import cursors
from daq_service.web.answers.json_answer import JsonAnswer, with_utc
from daq_service.web.answers.models import BaselineList, VerdictPage, problems
from daq_service.web.context import Context, ContextOf
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

router = APIRouter(tags=["verdicts"])
ERRORS = problems(404, 422, 503)


@router.get("/verdicts", operation_id="list_verdicts", response_model=VerdictPage, responses=ERRORS)
def list_verdicts(
    context: ContextOf,
    position: PositionFilter = None,
    set_index: Annotated[int | None, Query(ge=0, le=LARGEST_INDEX)] = None,
    from_h: FromHour = None,
    to_h: ToHour = None,
    cursor: CursorText = None,
    limit: Limit = 100,
) -> JsonAnswer:
    """List verdicts with the quality of the feature that was judged."""
    if position is not None:
        context.known(position)
    last_h = last_hour(from_h, to_h)
    name = listing_name("verdicts", position=position, set_index=set_index, from_h=from_h, to_h=to_h)
    after = cursors.decode(name, cursor)
    rows = context.catalogue().list_verdicts(
        position=position,
        first_h=from_h,
        last_h=last_h,
        after_id=after or 0,
        limit=limit + 1,
        set_index=set_index,
    )
    return page(context.freshness(), name, with_quality(context, rows), limit)


def with_quality(context: Context, rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Verdicts with the quality of the feature or thickness that each judges."""
    qualities: dict[tuple[str, int], str] = {}
    names = ("set_index", "quality")
    for position in {row["position"] for row in rows}:
        hours = [row["due_h"] for row in rows if row["position"] == position]
        catalogue = context.catalogue()
        pulse_echo = context.settings.positions[position].method == "pulse_echo"
        read = catalogue.thickness_columns if pulse_echo else catalogue.feature_columns
        columns = read(position, names, first_h=min(hours), last_h=max(hours))
        for index, quality in zip(*(columns[name] for name in names), strict=True):
            qualities[position, index] = quality
    return [{**row, "quality": qualities.get((row["position"], row["set_index"]))} for row in rows]


@router.get("/baselines", operation_id="list_baselines", response_model=BaselineList, responses=ERRORS)
def list_baselines(context: ContextOf, position: PositionFilter = None) -> JsonAnswer:
    """List the frozen baselines with their statistics, limits and provenance."""
    if position is not None:
        context.known(position)
    fresh = context.freshness()
    items = [with_utc(row, fresh.epoch_utc_ns) for row in context.catalogue().list_baselines(position)]
    return JsonAnswer({"as_of": fresh.as_of(), "items": items})
