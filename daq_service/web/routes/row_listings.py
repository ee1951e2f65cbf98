"""Listings of tables in limited pages, in the order in which rows were stored: sets, features, alarms, ..."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from inspect import Parameter, Signature
from typing import Annotated, Any, Literal, cast

from fastapi import APIRouter, Query
from pydantic import BaseModel

from daq_service.catalogue import rows
from daq_service.catalogue.reader import Filters
from daq_service.catalogue.standard_errors import find_standard_errors
from daq_service.web.answers import cursors, models
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import describe_errors
from daq_service.web.answers.problem import not_found
from daq_service.web.answers.vocabulary import VOCABULARY
from daq_service.web.context import Context, ContextOf, Freshness
from daq_service.web.routes import listing
from daq_service.web.tables.baselines import list_published_baselines
from daq_service.web.tables.quality import find_assessed_qualities
from hardware_drivers.measurement import SetKey

router = APIRouter()
Parameters = dict[str, tuple[object, object]]
"""Type and default of query parameters by name."""
HOURS: Parameters = {"from_h": (listing.FromHour, None), "to_h": (listing.ToHour, None)}
POSITION: Parameters = {"position": (listing.PositionFilter, None)}
SET_QUERY = Query(pattern=listing.SET_PATTERN, description=listing.SET_TEXT)
SET_INDEX: Parameters = {"set_index": (Annotated[str | None, SET_QUERY], None)}
PURPOSE: Parameters = {"purpose": (listing.PurposeFilter, "planned")}


def add_listing_route(
    resource: str,
    kind: type[rows.Row],
    page: type[BaseModel],
    filters: Parameters,
    render_rows: Callable[[Context, Freshness, Sequence[Any]], list[dict[str, object]]] | None = None,
) -> None:
    """Add a route ``/{resource}`` that lists a table in limited pages in the order of `Catalogue.rows`.

    Parameters
    ----------
    kind, page
        Rows of the table, and model of the answer.
    filters
        Query parameters in addition to ``cursor`` and ``limit``, by the names of `Filters` but for the hours
        ``from_h`` and ``to_h``: type and default of each.
    render_rows
        Converts rows to JSON; None: each row with its times and age.

    Raises
    ------
    KeyError
        The vocabulary has no description of the resource.
    """

    def answer_page(context: Context, cursor: str | None, limit: int, **query: Any) -> JsonAnswer:
        """Return one page of the rows that pass the filters, with the cursor of the next page.

        Raises a Problem for an unknown position (404), an invalid cursor or range (422), or without data
        (503).
        """
        if query.get("position") is not None:
            context.validate_position(query["position"])
        name = listing.build_listing_name(resource, **query)
        chosen = {key: value for key, value in query.items() if key not in HOURS}
        if query.get("set_index") is not None:  # the key alone decides whether the set is a scheduled one
            chosen |= {**SetKey.parse(query["set_index"])._asdict(), "purpose": None}
        chosen["first_h"] = query.get("from_h")
        chosen["last_h"] = listing.find_last_hour(query.get("from_h"), query.get("to_h"))
        chosen["after_id"] = cursors.decode_cursor(name, cursor)
        catalogue, fresh = context.catalogue(), context.read_freshness()
        found: Sequence[Any] = catalogue.rows(kind, limit=limit + 1, **cast(Filters, chosen))
        page_rows = found[:limit]
        items = (
            render_rows(context, fresh, page_rows) if render_rows else [fresh.row(row) for row in page_rows]
        )
        next_cursor = cursors.encode_cursor(name, page_rows[-1].id) if len(found) > limit else None
        return JsonAnswer({"as_of": fresh.as_of(), "next_cursor": next_cursor, "items": items})

    parameters = {**filters, "cursor": (listing.CursorText, None), "limit": (listing.Limit, 100)}
    # FastAPI reads from the signature which parameters there are.
    answer_page.__signature__ = Signature(  # type: ignore[attr-defined]  # `inspect` documents it, mypy lacks it
        [
            Parameter("context", Parameter.KEYWORD_ONLY, annotation=ContextOf),
            *(
                Parameter(name, Parameter.KEYWORD_ONLY, annotation=annotation, default=default)
                for name, (annotation, default) in parameters.items()
            ),
        ]
    )
    answer_page.__doc__ = VOCABULARY.listings[resource]
    router.get(
        f"/{resource}",
        tags=[resource],
        name=f"list_{resource}",
        response_model=page,
        responses=describe_errors(404, 503) if "position" in filters else describe_errors(503),
    )(answer_page)


def add_quality(
    context: Context, fresh: Freshness, assessments: Sequence[rows.AssessmentRow]
) -> list[dict[str, object]]:
    """Convert assessments for an answer, each with the quality of its feature or thickness, or None.

    Raises a Problem (503) or StorageError if the catalogue cannot be read.
    """
    methods = {name: place.method for name, place in context.settings.positions.items()}
    qualities = find_assessed_qualities(context.catalogue(), methods, assessments)
    return [fresh.row(row, quality=quality) for row, quality in zip(assessments, qualities, strict=True)]


def add_standard_errors(
    context: Context, fresh: Freshness, features: Sequence[rows.FeatureRow]
) -> list[dict[str, object]]:
    """Convert features for an answer, those of sets with their standard errors; StorageError as `rows`."""
    errors = find_standard_errors(context.catalogue(), features)
    return [fresh.row(row, standard_error=error) for row, error in zip(features, errors, strict=True)]


BY_SET = SET_INDEX | HOURS | PURPOSE
STATE: Parameters = {"state": (rows.SetState | None, None)}
MEANS = Query(description="Means of sets, or single shots")
SCOPE: Parameters = {"scope": (Annotated[Literal["set", "shot"], MEANS], "set")}
ACTIVE = Query(description="true: not closed; false: closed; absent: all")
OF_ALARMS: Parameters = {
    "active": (Annotated[bool | None, ACTIVE], None),
    "state": (Annotated[rows.AlarmState | None, Query(description="Only this state")], None),
    "priority": (Annotated[rows.Priority | None, Query(description="Only this priority")], None),
    "kind": (Annotated[str | None, Query(max_length=50, description="Only this kind")], None),
}
WITHDRAWN = Query(description="true: those withdrawn; false: the others; absent: all")
OF_ANNOTATIONS: Parameters = {"withdrawn": (Annotated[bool | None, WITHDRAWN], None)}
add_listing_route("sets", rows.SetRow, models.SetPage, POSITION | STATE | BY_SET)
OF_FEATURES = POSITION | SCOPE | BY_SET
add_listing_route("features", rows.FeatureRow, models.FeaturePage, OF_FEATURES, add_standard_errors)
add_listing_route("thickness", rows.ThicknessRow, models.ThicknessPage, POSITION | SET_INDEX | HOURS)
add_listing_route("wall", rows.WallRow, models.WallPage, POSITION | SET_INDEX | HOURS)
add_listing_route("assessments", rows.AssessmentRow, models.AssessmentPage, POSITION | BY_SET, add_quality)
add_listing_route("environment", rows.EnvironmentRow, models.EnvironmentPage, HOURS)
add_listing_route("alarms", rows.AlarmRow, models.AlarmPage, POSITION | HOURS | OF_ALARMS)
add_listing_route("annotations", rows.AnnotationRow, models.AnnotationPage, POSITION | HOURS | OF_ANNOTATIONS)


@router.get(
    "/sets/{position}/{set_index}/shots",
    tags=["sets"],
    response_model=models.ShotPage,
    responses=describe_errors(404, 503),
)
def list_shots(context: ContextOf, position: str, set_index: listing.SetOfPath) -> JsonAnswer:
    """List the stored shots of one set, in one page; 404 if none is stored."""
    context.validate_position(position)
    fresh = context.read_freshness()
    shots = context.catalogue().rows(rows.ShotRow, position=position, **SetKey.parse(set_index)._asdict())
    if not shots:
        raise not_found(
            f"No shot of position {position}, set {set_index} is stored.", "/api/v1/sets lists the sets."
        )
    items = [fresh.row(row) for row in shots]
    return JsonAnswer({"as_of": fresh.as_of(), "next_cursor": None, "items": items})


@router.get(
    "/baselines",
    tags=["assessments"],
    response_model=models.BaselineList,
    responses=describe_errors(404, 503),
)
def list_baselines(context: ContextOf, position: listing.PositionFilter = None) -> JsonAnswer:
    """List all baselines of each position, the newest last: lifecycle, statistics, limits, provenance.

    A transducer without a baseline has the planned one that is collecting. An unknown position: 404.
    """
    if position is not None:
        context.validate_position(position)
    fresh = context.read_freshness()
    baselines = list_published_baselines(context.catalogue(), context.settings, fresh.epoch_utc_ns, position)
    return JsonAnswer(
        {
            "as_of": fresh.as_of(),
            "items": [fresh.row(row, **extra_columns) for row, extra_columns in baselines],
        }
    )
