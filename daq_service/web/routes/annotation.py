"""`/api/v1/annotations`: annotations of hours of the test; commands create and withdraw them."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from daq_service.catalogue.rows import AnnotationRow
from daq_service.web.answers import models
from daq_service.web.routes.listing import HOURS, POSITION, add_listing

router = APIRouter(tags=["annotations"])
WITHDRAWN = Annotated[bool | None, Query(description="true: those withdrawn; false: the others; absent: all")]
add_listing(
    router,
    "annotations",
    AnnotationRow,
    models.AnnotationPage,
    "List annotations of any hour of a range, in the order they were written.",
    POSITION | HOURS | {"withdrawn": (WITHDRAWN, None)},
)
