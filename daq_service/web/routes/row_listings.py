"""Listings of tables in limited pages, in the order in which rows were stored: sets, features, alarms, ..."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from inspect import Parameter, Signature
from typing import Annotated, Any, Literal, cast

from fastapi import APIRouter, Query
from pydantic import BaseModel

from daq_service.catalogue import rows
from daq_service.catalogue.reader import Filters
from daq_service.web.answers import cursors, models
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import problems
from daq_service.web.answers.problem import not_found
from daq_service.web.context import Context, ContextOf, Freshness
from daq_service.web.routes import listing
from daq_service.web.tables.baselines import published_baselines
from daq_service.web.tables.quality import assessed_qualities

router = APIRouter()
Parameters = dict[str, tuple[object, object]]
"""Type and default of query parameters by name."""
HOURS: Parameters = {"from_h": (listing.FromHour, None), "to_h": (listing.ToHour, None)}
POSITION: Parameters = {"position": (listing.PositionFilter, None)}
SET_INDEX: Parameters = {"set_index": (Annotated[int | None, Query(ge=0, le=listing.LARGEST_INDEX)], None)}
PURPOSE: Parameters = {"purpose": (listing.PurposeFilter, "planned")}


def add_listing(
    resource: str,
    kind: type[rows.Row],
    page: type[BaseModel],
    description: str,
    filters: Parameters,
    render_rows: Callable[[Context, Freshness, Sequence[Any]], list[dict[str, object]]] | None = None,
) -> None:
    """Add a route ``/{resource}`` that lists a table in limited pages in the order of `Catalogue.rows`.

    Parameters
    ----------
    kind, page
        Rows of the table, and model of the answer.
    description
        Description of the listing in OpenAPI.
    filters
        Query parameters in addition to ``cursor`` and ``limit``, by the names of `Filters` but for the hours
        ``from_h`` and ``to_h``: type and default of each.
    render_rows
        Converts rows to JSON; None: the row with its age.
    """

    def page_of(context: Context, cursor: str | None, limit: int, **query: Any) -> JsonAnswer:
        if query.get("position") is not None:
            context.checked_position(query["position"])
        name = listing.listing_name(resource, **query)
        chosen = {key: value for key, value in query.items() if key not in HOURS}
        chosen["first_h"] = query.get("from_h")
        chosen["last_h"] = listing.last_hour(query.get("from_h"), query.get("to_h"))
        chosen["after_id"] = cursors.decode(name, cursor)
        catalogue, fresh = context.catalogue(), context.freshness()
        found: Sequence[Any] = catalogue.rows(kind, limit=limit + 1, **cast(Filters, chosen))
        page_rows = found[:limit]
        items = (
            render_rows(context, fresh, page_rows) if render_rows else [fresh.row(row) for row in page_rows]
        )
        next_cursor = cursors.encode(name, page_rows[-1].id) if len(found) > limit else None
        return JsonAnswer({"as_of": fresh.as_of(), "next_cursor": next_cursor, "items": items})

    parameters = {**filters, "cursor": (listing.CursorText, None), "limit": (listing.Limit, 100)}
    # FastAPI reads from the signature which parameters there are.
    page_of.__signature__ = Signature(  # type: ignore[attr-defined]  # `inspect` documents it, mypy lacks it
        [
            Parameter("context", Parameter.KEYWORD_ONLY, annotation=ContextOf),
            *(
                Parameter(name, Parameter.KEYWORD_ONLY, annotation=annotation, default=default)
                for name, (annotation, default) in parameters.items()
            ),
        ]
    )
    page_of.__doc__ = description
    router.get(
        f"/{resource}",
        tags=[resource],
        name=f"list_{resource}",
        response_model=page,
        responses=problems(404, 503) if "position" in filters else problems(503),
    )(page_of)


def with_quality(
    context: Context, fresh: Freshness, assessments: Sequence[rows.AssessmentRow]
) -> list[dict[str, object]]:
    """Return assessments for an answer, each with the quality of its feature or thickness."""
    methods = {name: place.method for name, place in context.settings.positions.items()}
    qualities = assessed_qualities(context.catalogue(), methods, assessments)
    return [fresh.row(row, quality=quality) for row, quality in zip(assessments, qualities, strict=True)]


add_listing(
    "sets",
    rows.SetRow,
    models.SetPage,
    "List one row a set and position, in the order in which they were stored.",
    POSITION | {"state": (rows.SetState | None, None)} | SET_INDEX | HOURS | PURPOSE,
)
SCOPE = Annotated[Literal["set", "shot"], Query(description="Means of sets, or single shots")]
add_listing(
    "features",
    rows.FeatureRow,
    models.FeaturePage,
    "List features with their quality and age.",
    POSITION | {"scope": (SCOPE, "set")} | SET_INDEX | HOURS | PURPOSE,
)
add_listing(
    "thickness",
    rows.ThicknessRow,
    models.ThicknessPage,
    "List pulse-echo results with their quality and age.",
    POSITION | SET_INDEX | HOURS,
)
add_listing(
    "assessments",
    rows.AssessmentRow,
    models.AssessmentPage,
    "List assessments with the quality of the feature that was judged.",
    POSITION | SET_INDEX | HOURS | PURPOSE,
    with_quality,
)
add_listing(
    "environment",
    rows.EnvironmentRow,
    models.EnvironmentPage,
    "List supply and climate, one row a set; no rows where neither is configured.",
    HOURS,
)
ACTIVE = Annotated[bool | None, Query(description="true: not closed; false: closed; absent: all")]
add_listing(
    "alarms",
    rows.AlarmRow,
    models.AlarmPage,
    "List alarms in the order they were raised.",
    POSITION
    | HOURS
    | {
        "active": (ACTIVE, None),
        "state": (Annotated[rows.AlarmState | None, Query(description="Only this state")], None),
        "priority": (Annotated[rows.Priority | None, Query(description="Only this priority")], None),
        "kind": (Annotated[str | None, Query(max_length=50, description="Only this kind")], None),
    },
)


WITHDRAWN = Annotated[bool | None, Query(description="true: those withdrawn; false: the others; absent: all")]
add_listing(
    "annotations",
    rows.AnnotationRow,
    models.AnnotationPage,
    "List annotations of any hour of a range, in the order they were written.",
    POSITION | HOURS | {"withdrawn": (WITHDRAWN, None)},
)


@router.get(
    "/sets/{position}/{set_index}/shots",
    tags=["sets"],
    response_model=models.ShotPage,
    responses=problems(404, 503),
)
def list_shots(context: ContextOf, position: str, set_index: listing.Index) -> JsonAnswer:
    """List the stored shots of one set, in one page."""
    context.checked_position(position)
    fresh = context.freshness()
    shots = context.catalogue().rows(rows.ShotRow, position=position, set_index=set_index)
    if not shots:
        raise not_found(
            f"No shot of position {position}, set {set_index} is stored.", "/api/v1/sets lists the sets."
        )
    items = [fresh.row(row) for row in shots]
    return JsonAnswer({"as_of": fresh.as_of(), "next_cursor": None, "items": items})


@router.get(
    "/baselines", tags=["assessments"], response_model=models.BaselineList, responses=problems(404, 503)
)
def list_baselines(context: ContextOf, position: listing.PositionFilter = None) -> JsonAnswer:
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
