"""What the listings share: bounded pages with opaque cursors, half-open ranges of hours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any

from fastapi import Query

from daq_service.web.answers import cursors
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.problem import Problem
from daq_service.web.context import Freshness

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
        raise Problem(
            422,
            "invalid-request",
            "The range is upside down",
            f"from_h is {from_h:g} and to_h is {to_h:g}.",
            "Let to_h be at least from_h; the range includes from_h and excludes to_h.",
        )
    return math.nextafter(to_h, -math.inf)


def listing_name(resource: str, **filters: object) -> str:
    """Name of a listing with its filters, to which its cursors are tied."""
    return resource + "".join(
        f"&{key}={value}" for key, value in sorted(filters.items()) if value is not None
    )


def page(
    fresh: Freshness,
    name: str,
    rows: Sequence[dict[str, Any]],
    limit: int,
    *,
    at: str = "due_h",
) -> JsonAnswer:
    """Answer of one page; ``rows`` holds one row more than the page where there are more."""
    shown = rows[:limit]
    following = cursors.encode(name, shown[-1]["id"]) if len(rows) > limit else None
    return JsonAnswer(
        {
            "as_of": fresh.as_of(),
            "next_cursor": following,
            "items": [fresh.row(row, at=at) for row in shown],
        }
    )
