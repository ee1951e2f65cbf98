"""`/api/v1/environment/latest`: newest values of supply and climate, and the supply now."""

from __future__ import annotations

from dataclasses import asdict

from fastapi import APIRouter

from daq_service.corrosion_drive.supply_state import read_supply_status
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import EnvironmentNow, problems
from daq_service.web.context import ContextOf

router = APIRouter(tags=["environment"])


@router.get("/environment/latest", response_model=EnvironmentNow, responses=problems(503))
def get_latest_environment(context: ContextOf) -> JsonAnswer:
    """Return the newest row, and the present status of the supply; null where there is none."""
    fresh = context.freshness()
    row, drive = context.catalogue().last_environment(), read_supply_status(context.data_folder)
    return JsonAnswer(
        {
            "as_of": fresh.as_of(),
            "latest": None if row is None else fresh.row(row),
            "supply_now": None if drive is None else asdict(drive),
        }
    )
