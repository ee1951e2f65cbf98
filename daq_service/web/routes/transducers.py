"""Present state: `/api/v1/transducers` for each monitored position, `/api/v1/environment/latest`."""

from __future__ import annotations

from dataclasses import asdict

from fastapi import APIRouter

from daq_service.alarms.states import PRIORITIES, find_disabled
from daq_service.assessment.position_status import (
    find_data_age_h,
    find_newest_data_hour,
    find_status,
    is_data_stale,
    read_latest_rows,
)
from daq_service.catalogue.reader import LatestRows
from daq_service.catalogue.rows import Row
from daq_service.corrosion_drive.supply_state import read_supply_status
from daq_service.processes import freshness
from daq_service.settings.tree import PositionSettings, ScheduleSettings
from daq_service.web.answers.json_answer import JsonAnswer, format_hour_as_rfc3339, format_rfc3339
from daq_service.web.answers.models import (
    EnvironmentNow,
    PositionList,
    PositionStanding,
    PositionState,
    describe_errors,
)
from daq_service.web.context import Context, ContextOf, Freshness
from daq_service.web.routes.row_listings import add_quality

router = APIRouter()


@router.get("/transducers", tags=["transducers"], response_model=PositionList, responses=describe_errors(503))
def list_transducers(context: ContextOf) -> JsonAnswer:
    """Return state, newest values, quality and age of every position, in the order of the configuration."""
    fresh = context.read_freshness()
    latest = read_latest_rows(context.catalogue(), fresh, context.settings.positions)
    items = [_build_state(context, fresh, last) for last in latest.values()]
    return JsonAnswer({"as_of": fresh.as_of(), "items": items})


@router.get(
    "/transducers/{position}",
    tags=["transducers"],
    response_model=PositionState,
    responses=describe_errors(404, 503),
)
def get_transducer(position: str, context: ContextOf) -> JsonAnswer:
    """Return state, newest values, quality and age of one position; 404 if the test does not have it."""
    context.validate_position(position)
    fresh, place = context.read_freshness(), {position: context.settings.positions[position]}
    (last,) = read_latest_rows(context.catalogue(), fresh, place).values()
    return JsonAnswer(_build_state(context, fresh, last))


@router.get(
    "/environment/latest", tags=["environment"], response_model=EnvironmentNow, responses=describe_errors(503)
)
def get_latest_environment(context: ContextOf) -> JsonAnswer:
    """Return the newest row of supply and climate, and the present status of the supply.

    Each is null if there is none.
    """
    fresh = context.read_freshness()
    row, drive = context.catalogue().read_last_environment(), read_supply_status(context.data_folder)
    return JsonAnswer(
        {
            "as_of": fresh.as_of(),
            "latest": None if row is None else fresh.row(row),
            "supply_now": None if drive is None else asdict(drive),
        }
    )


def _build_state(context: Context, fresh: Freshness, last: LatestRows) -> dict[str, object]:
    """Build the present state of a position with its newest rows and numbers of alarms.

    Suppressed alarms are counted apart and not in the highest priority; ``shelved_until_utc`` is the first
    end of a shelf.
    """
    place = context.settings.positions[last.position]
    assessment, alarms = last.last_assessment, last.active_alarms
    visible_alarms = [row for row in alarms if row.suppressed is None]
    shelves = [row.shelved_until_utc_ns for row in alarms if row.shelved_until_utc_ns is not None]
    standing = assess_position(place, context.settings.schedule, fresh, last)
    data_h = standing.data_h
    return {
        **standing.model_dump(),
        "serial_number": place.serial_number,
        "data_utc": None if data_h is None else format_hour_as_rfc3339(fresh.epoch_utc_ns, data_h),
        "last_set": _to_json_row(fresh, last.last_set),
        "last_feature": _to_json_row(fresh, last.last_feature),
        "last_thickness": _to_json_row(fresh, last.last_thickness),
        "last_wall": _to_json_row(fresh, last.last_wall),
        "last_assessment": None if assessment is None else add_quality(context, fresh, [assessment])[0],
        "disabled_reason": find_disabled(alarms).get(last.position),
        "active_alarms": len(visible_alarms),
        "suppressed_alarms": len(alarms) - len(visible_alarms),
        "shelved_until_utc": format_rfc3339(min(shelves, default=None)),
        "highest_priority": max((row.priority for row in visible_alarms), key=PRIORITIES.index, default=None),
    }


def assess_position(
    place: PositionSettings, schedule: ScheduleSettings, fresh: freshness.Freshness, last: LatestRows
) -> PositionStanding:
    """Build the status of a position from its newest rows: state, hour and age of the data, stale or not."""
    age_h = find_data_age_h(last, fresh)
    return PositionStanding(
        position=last.position,
        label=place.label,
        method=place.method,
        state=find_status(last),
        stale=is_data_stale(schedule, fresh, age_h),
        data_h=find_newest_data_hour(last),
        age_h=age_h,
    )


def _to_json_row(fresh: Freshness, row: Row | None) -> dict[str, object] | None:
    """Convert a row for an answer, with times and age; None stays None."""
    return None if row is None else fresh.row(row)
