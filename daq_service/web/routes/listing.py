"""Shared parts of listings: limited pages with opaque cursors, half-open ranges of hours."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from inspect import Parameter, Signature
from typing import Annotated, Any, cast

from fastapi import APIRouter, Path, Query

from daq_service.catalogue.published_columns import Purposes
from daq_service.catalogue.reader import Filters
from daq_service.catalogue.rows import Row
from daq_service.web.answers import cursors
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import Page, problems
from daq_service.web.answers.problem import invalid
from daq_service.web.context import Context, ContextOf, Freshness
from hardware_drivers.measurement import SetKey

LARGEST_PAGE = 1000
LARGEST_HOUR = 1e7
LARGEST_INDEX = 2**31 - 1

Limit = Annotated[int, Query(ge=1, le=LARGEST_PAGE, description="Most items of a page")]
CursorText = Annotated[str | None, Query(max_length=200, description="`next_cursor` of the page before")]
FromHour = Annotated[
    float | None,
    Query(ge=-LARGEST_HOUR, le=LARGEST_HOUR, allow_inf_nan=False, description="First hour, included"),
]
ToHour = Annotated[
    float | None,
    Query(ge=-LARGEST_HOUR, le=LARGEST_HOUR, allow_inf_nan=False, description="Last hour, excluded"),
]
PositionFilter = Annotated[str | None, Query(max_length=16, description="Only this position")]
HOURS = {"from_h": (FromHour, None), "to_h": (ToHour, None)}
POSITION = {"position": (PositionFilter, None)}
SET_PATTERN = r"^[0-9]{1,8}(\.[0-9]{1,3})?$"
SET_TEXT = "Index of a set, such as 12; 12.1 is the first unscheduled set after it"
"""Form of the key of a set in paths and queries (`SetKey.parse`)."""
SetOfPath = Annotated[str, Path(pattern=SET_PATTERN, description=SET_TEXT)]
SET_INDEX = {"set_index": (Annotated[str | None, Query(pattern=SET_PATTERN, description=SET_TEXT)], None)}

PurposeFilter = Annotated[
    Purposes,
    Query(description="Sets of the plan, those beside it, or both"),
]
PURPOSE = {"purpose": (PurposeFilter, "planned")}


def last_hour(from_h: float | None, to_h: float | None) -> float | None:
    """Return the last hour inside a half-open range, for the catalogue.

    Raises
    ------
    Problem
        422: the range ends before its start.
    """
    if to_h is None:
        return None
    if from_h is not None and to_h < from_h:
        raise invalid(
            "The range is upside down",
            f"from_h is {from_h:g} and to_h is {to_h:g}.",
            "Let to_h be at least from_h; the range includes from_h and excludes to_h.",
        )
    return math.nextafter(to_h, -math.inf)


def add_listing(
    router: APIRouter,
    resource: str,
    kind: type[Row],
    page: type[Page],
    description: str,
    filters: Mapping[str, tuple[Any, Any]],
    render_rows: Callable[[Context, Freshness, Sequence[Any]], list[dict[str, Any]]] | None = None,
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

    def listing(context: Context, cursor: str | None, limit: int, **query: Any) -> JsonAnswer:
        if query.get("position") is not None:
            context.checked_position(query["position"])
        last_hour(query.get("from_h"), query.get("to_h"))
        name = listing_name(resource, **query)
        query["after_id"] = cursors.decode(name, cursor)
        catalogue, fresh = context.catalogue(), context.freshness()
        rows = catalogue.rows(kind, limit=limit + 1, **_filters(query))
        page_rows = rows[:limit]
        items = (
            render_rows(context, fresh, page_rows) if render_rows else [fresh.row(row) for row in page_rows]
        )
        next_cursor = cursors.encode(name, items[-1]["id"]) if len(rows) > limit else None
        return JsonAnswer({"as_of": fresh.as_of(), "next_cursor": next_cursor, "items": items})

    parameters = {**filters, "cursor": (CursorText, None), "limit": (Limit, 100)}
    # FastAPI reads from the signature which parameters there are.
    listing.__signature__ = Signature(  # type: ignore[attr-defined]  # `inspect` documents it, mypy lacks it
        [
            Parameter("context", Parameter.KEYWORD_ONLY, annotation=ContextOf),
            *(
                Parameter(name, Parameter.KEYWORD_ONLY, annotation=annotation, default=default)
                for name, (annotation, default) in parameters.items()
            ),
        ]
    )
    listing.__doc__ = description
    router.get(
        f"/{resource}",
        operation_id=f"list_{resource}",
        name=f"list_{resource}",
        response_model=page,
        responses=problems(404, 422, 503) if "position" in filters else problems(422, 503),
    )(listing)


def _filters(query: Mapping[str, Any]) -> Filters:
    """Return query parameters as filters of the catalogue."""
    from_h, to_h = query.get("from_h"), query.get("to_h")
    chosen: dict[str, Any] = {name: query[name] for name in query if name not in HOURS}
    if chosen.get("set_index") is not None:  # the key alone decides whether the set is a scheduled one
        chosen |= {**SetKey.parse(chosen["set_index"])._asdict(), "purpose": None}
    return cast(Filters, chosen | {"first_h": from_h, "last_h": last_hour(from_h, to_h)})


def listing_name(resource: str, **filters: object) -> str:
    """Return the name of a listing with its filters, for its cursors."""
    return resource + "".join(
        f"&{key}={value}" for key, value in sorted(filters.items()) if value is not None
    )
