"""`/api/v1/verdicts` and `/api/v1/baselines`: distance, limits, outliers, and against what."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fastapi import APIRouter

from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import BaselineRow, EnvironmentRow, VerdictRow
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import BaselineList, VerdictPage, problems
from daq_service.web.context import Context, ContextOf, Freshness
from daq_service.web.routes.listing import HOURS, POSITION, PURPOSE, SET_INDEX, PositionFilter, add_listing
from daq_service.web.tables.quality import judged_qualities

router = APIRouter(tags=["verdicts"])


def with_quality(context: Context, fresh: Freshness, rows: Sequence[VerdictRow]) -> list[dict[str, Any]]:
    """Verdicts as they leave the service, with the quality of the feature or thickness that each judges."""
    methods = {name: place.method for name, place in context.settings.positions.items()}
    qualities = judged_qualities(context.catalogue(), methods, rows)
    return [fresh.row(row, quality=quality) for row, quality in zip(rows, qualities, strict=True)]


add_listing(
    router,
    "verdicts",
    VerdictRow,
    VerdictPage,
    "List verdicts with the quality of the feature that was judged.",
    POSITION | SET_INDEX | HOURS | PURPOSE,
    with_quality,
)


@router.get(
    "/baselines",
    operation_id="list_baselines",
    response_model=BaselineList,
    responses=problems(404, 422, 503),
)
def list_baselines(context: ContextOf, position: PositionFilter = None) -> JsonAnswer:
    """List each position's baselines, the newest last: life, statistics, limits, provenance."""
    if position is not None:
        context.known(position)
    fresh = context.freshness()
    catalogue = context.catalogue()
    items = [
        fresh.row(row, temperature_c=temperatures_c(catalogue, row))
        for row in catalogue.rows(BaselineRow, position=position)
    ]
    return JsonAnswer({"as_of": fresh.as_of(), "items": items})


def temperatures_c(catalogue: Catalogue, row: BaselineRow) -> list[float] | None:
    """Least and greatest temperature around the sets of a baseline; None: none was measured."""
    first, last = row.first_set_index, row.last_set_index
    around = catalogue.rows(EnvironmentRow, first_set=first, last_set=last)
    found = [one.temperature_c for one in around if one.temperature_c is not None]
    return [min(found), max(found)] if found else None
