"""Shared parameters of routes: pages and their cursors, half-open ranges of hours."""

from __future__ import annotations

import math
from typing import Annotated

from fastapi import Path, Query

from daq_service.catalogue.published_columns import Purposes
from daq_service.commands.kinds import LARGEST_ID
from daq_service.web.answers.problem import invalid

LARGEST_PAGE = 1000
LARGEST_HOUR = 1e7
LARGEST_INDEX = 2**31 - 1

Index = Annotated[int, Path(ge=0, le=LARGEST_INDEX)]
RowId = Annotated[int, Path(ge=1, le=LARGEST_ID)]
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
SET_PATTERN = r"^[0-9]{1,8}(\.[0-9]{1,3})?$"
SET_TEXT = "Index of a set, such as 12; 12.1 is the first unscheduled set after it"
"""Form of the key of a set in paths and queries (`SetKey.parse`)."""
SetOfPath = Annotated[str, Path(pattern=SET_PATTERN, description=SET_TEXT)]

PurposeFilter = Annotated[
    Purposes,
    Query(description="Scheduled sets, unscheduled sets, or both"),
]


def find_last_hour(from_h: float | None, to_h: float | None) -> float | None:
    """Return the largest number below the excluded end of a range of hours; None if the range is open.

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


def build_listing_name(resource: str, **filters: object) -> str:
    """Build the name of a listing from its resource and sorted filters, to which its cursors belong.

    Filters that are None are left out.
    """
    return resource + "".join(
        f"&{key}={value}" for key, value in sorted(filters.items()) if value is not None
    )
