"""`/api/v1/thickness`: wall thickness from pulse echo."""

from __future__ import annotations

from fastapi import APIRouter

from daq_service.catalogue.rows import ThicknessRow
from daq_service.web.answers.models import ThicknessPage
from daq_service.web.routes.listing import HOURS, POSITION, SET_INDEX, add_listing

router = APIRouter(tags=["thickness"])
add_listing(
    router,
    "thickness",
    ThicknessRow,
    ThicknessPage,
    "List pulse-echo results with their quality and age.",
    POSITION | SET_INDEX | HOURS,
)
