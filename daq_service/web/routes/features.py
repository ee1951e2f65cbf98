"""`/api/v1/features`: solitary-wave features of sets or of single shots."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query

from daq_service.catalogue.rows import FeatureRow
from daq_service.web.answers.models import FeaturePage
from daq_service.web.routes.listing import HOURS, POSITION, PURPOSE, SET_INDEX, add_listing

router = APIRouter(tags=["features"])
SCOPE = Annotated[Literal["set", "shot"], Query(description="Means of sets, or single shots")]
add_listing(
    router,
    "features",
    FeatureRow,
    FeaturePage,
    "List features with their quality and age.",
    POSITION | {"scope": (SCOPE, "set")} | SET_INDEX | HOURS | PURPOSE,
)
