"""`/api/v1/assessments` and `/api/v1/baselines`: distances, limits, outliers, and their baselines."""

from __future__ import annotations

from collections.abc import Sequence

from fastapi import APIRouter

from daq_service.catalogue.rows import AssessmentRow
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import AssessmentPage, BaselineList, problems
from daq_service.web.context import Context, ContextOf, Freshness
from daq_service.web.routes.listing import HOURS, POSITION, PURPOSE, SET_INDEX, PositionFilter, add_listing
from daq_service.web.tables.baselines import published_baselines
from daq_service.web.tables.quality import assessed_qualities

router = APIRouter(tags=["assessments"])


def with_quality(
    context: Context, fresh: Freshness, rows: Sequence[AssessmentRow]
) -> list[dict[str, object]]:
    """Return assessments for an answer, each with the quality of its feature or thickness."""
    methods = {name: place.method for name, place in context.settings.positions.items()}
    qualities = assessed_qualities(context.catalogue(), methods, rows)
    return [fresh.row(row, quality=quality) for row, quality in zip(rows, qualities, strict=True)]


add_listing(
    router,
    "assessments",
    AssessmentRow,
    AssessmentPage,
    "List assessments with the quality of the feature that was judged.",
    POSITION | SET_INDEX | HOURS | PURPOSE,
    with_quality,
)


@router.get("/baselines", response_model=BaselineList, responses=problems(404, 503))
def list_baselines(context: ContextOf, position: PositionFilter = None) -> JsonAnswer:
    """List the baselines of each position, the newest last: lifecycle, statistics, limits, provenance."""
    if position is not None:
        context.checked_position(position)
    fresh = context.freshness()
    baselines = published_baselines(context.catalogue(), context.settings, fresh.epoch_utc_ns, position)
    return JsonAnswer(
        {
            "as_of": fresh.as_of(),
            "items": [fresh.row(row, **extra_columns) for row, extra_columns in baselines],
        }
    )
