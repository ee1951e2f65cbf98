"""What the listings share: bounded pages with opaque cursors, half-open ranges of hours."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from inspect import Parameter, Signature
from typing import Annotated, Any, cast

from fastapi import APIRouter, Query

from daq_service.catalogue.published_columns import Purposes
from daq_service.catalogue.reader import Filters
from daq_service.catalogue.rows import Row
from daq_service.web.answers import cursors
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import Page, problems
from daq_service.web.answers.problem import invalid
from daq_service.web.context import Context, ContextOf, Freshness

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
SET_INDEX = {"set_index": (Annotated[int | None, Query(ge=0, le=LARGEST_INDEX)], None)}

PurposeFilter = Annotated[
    Purposes,
    Query(description="Sets of the plan, those beside it, or both"),
]
PURPOSE = {"purpose": (PurposeFilter, "planned")}


def last_hour(from_h: float | None, to_h: float | None) -> float | None:
    """Greatest hour inside the half-open range, as the catalogue wants it.

    Raises
    ------
    Problem
        422: the range ends before it begins.
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
    told: str,
    filters: Mapping[str, tuple[Any, Any]],
    answers: Callable[[Context, Freshness, Sequence[Any]], list[dict[str, Any]]] | None = None,
) -> None:
    """Serve a table at ``/{resource}``: bounded pages in the order of `Catalogue.rows`.

    Parameters
    ----------
    kind, page
        Its rows, and the shape of the answer.
    told
        What the listing is for, as the description of the interface says it.
    filters
        Query parameters beside ``cursor`` and ``limit``, by the names of `Filters` but for the hours
        ``from_h`` and ``to_h``: type and default of each.
    answers
        How rows leave the service; None: with their age.
    """

    def listing(context: Context, cursor: str | None, limit: int, **given: Any) -> JsonAnswer:
        if given.get("position") is not None:
            context.known(given["position"])
        last_hour(given.get("from_h"), given.get("to_h"))
        name = listing_name(resource, **given)
        given["after_id"] = cursors.decode(name, cursor)
        catalogue, fresh = context.catalogue(), context.freshness()
        rows = catalogue.rows(kind, limit=limit + 1, **_filters(given))
        of_page = rows[:limit]
        shown = answers(context, fresh, of_page) if answers else [fresh.row(row) for row in of_page]
        following = cursors.encode(name, shown[-1]["id"]) if len(rows) > limit else None
        return JsonAnswer({"as_of": fresh.as_of(), "next_cursor": following, "items": shown})

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
    listing.__doc__ = told
    router.get(
        f"/{resource}",
        operation_id=f"list_{resource}",
        name=f"list_{resource}",
        response_model=page,
        responses=problems(404, 422, 503) if "position" in filters else problems(422, 503),
    )(listing)


def _filters(given: Mapping[str, Any]) -> Filters:
    """Translate for the catalogue."""
    from_h, to_h = given.get("from_h"), given.get("to_h")
    chosen: dict[str, Any] = {name: given[name] for name in given if name not in HOURS}
    return cast(Filters, chosen | {"first_h": from_h, "last_h": last_hour(from_h, to_h)})


def listing_name(resource: str, **filters: object) -> str:
    """Name of a listing with its filters, to which its cursors are tied."""
    return resource + "".join(
        f"&{key}={value}" for key, value in sorted(filters.items()) if value is not None
    )
