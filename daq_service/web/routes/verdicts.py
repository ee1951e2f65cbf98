"""`/api/v1/verdicts` and `/api/v1/baselines`: distance, limits, outliers, and against what."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fastapi import APIRouter

from daq_service.catalogue.reader import Filters
from daq_service.catalogue.rows import BaselineRow, VerdictRow
from daq_service.judgement.methods import METHODS
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import BaselineList, VerdictPage, problems
from daq_service.web.context import Context, ContextOf, Freshness
from daq_service.web.routes.listing import HOURS, POSITION, SET_INDEX, PositionFilter, add_listing

router = APIRouter(tags=["verdicts"])


def with_quality(context: Context, fresh: Freshness, rows: Sequence[VerdictRow]) -> list[dict[str, Any]]:
    """Verdicts as they leave the service, with the quality of the feature or thickness that each judges."""
    hours, positions = [row.due_h for row in rows], {row.position for row in rows}
    qualities: dict[tuple[str, int], str] = {}
    for method in {context.settings.positions[position].method for position in positions}:
        judged = METHODS[method]
        filters: Filters = {
            "position": None if len(positions) > 1 else rows[0].position,
            "first_h": min(hours),
            "last_h": max(hours),
            **judged.of_sets,
        }
        columns = context.catalogue().columns(judged.row, ("position", "set_index", "quality"), **filters)
        keys = zip(columns["position"], columns["set_index"], strict=True)
        qualities |= zip(keys, columns["quality"], strict=True)
    return [fresh.row(row, quality=qualities.get((row.position, row.set_index))) for row in rows]


add_listing(
    router,
    "verdicts",
    VerdictRow,
    VerdictPage,
    "List verdicts with the quality of the feature that was judged.",
    POSITION | SET_INDEX | HOURS,
    with_quality,
)


@router.get(
    "/baselines",
    operation_id="list_baselines",
    response_model=BaselineList,
    responses=problems(404, 422, 503),
)
def list_baselines(context: ContextOf, position: PositionFilter = None) -> JsonAnswer:
    """List the frozen baselines with their statistics, limits and provenance."""
    if position is not None:
        context.known(position)
    fresh = context.freshness()
    rows = context.catalogue().rows(BaselineRow, position=position)
    return JsonAnswer({"as_of": fresh.as_of(), "items": [fresh.row(row) for row in rows]})
