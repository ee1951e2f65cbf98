"""`/api/v1/transducers`: each monitored place as it stands now."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fastapi import APIRouter

from daq_service.alarms.states import SEVERITIES, retired_positions
from daq_service.catalogue.reader import LastWord
from daq_service.catalogue.rows import AlarmRow, Row, SetRow, VerdictRow
from daq_service.judgement.methods import METHODS
from daq_service.settings.tree import ScheduleSettings
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import PositionList, PositionState, problems
from daq_service.web.context import Context, ContextOf, Freshness
from daq_service.web.routes.verdicts import with_quality

router = APIRouter(tags=["transducers"])
STALE_INTERVALS = 1.5
"""A set may be late by half an interval before its position counts as stale."""


@router.get(
    "/transducers",
    operation_id="list_transducers",
    response_model=PositionList,
    responses=problems(503),
)
def list_transducers(context: ContextOf) -> JsonAnswer:
    """Tell state, newest values, quality and age of every position."""
    fresh = context.freshness()
    states = context.catalogue().positions_state()
    items = [_state(context, fresh, name, states.get(name)) for name in context.settings.positions]
    return JsonAnswer({"as_of": fresh.as_of(), "items": items})


@router.get(
    "/transducers/{position}",
    operation_id="get_transducer",
    response_model=PositionState,
    responses=problems(404, 422, 503),
)
def get_transducer(position: str, context: ContextOf) -> JsonAnswer:
    """Tell state, newest values, quality and age of one position."""
    context.known(position)
    state = context.catalogue().positions_state().get(position)
    return JsonAnswer(_state(context, context.freshness(), position, state))


def _state(context: Context, fresh: Freshness, name: str, found: LastWord | None) -> dict[str, Any]:
    place = context.settings.positions[name]
    last = found or LastWord(position=name, method=place.method)
    verdict, alarms = last.last_verdict, last.active_alarms
    # A set that was missed, or planned for a retired transducer, brings no data: they age on.
    data_h = max(
        (row.due_h for row in (last.last_feature, last.last_thickness) if row is not None), default=None
    )
    age_h = None if data_h is None else fresh.age_h(data_h)
    retired = retired_positions(alarms).get(name)
    word = "retired" if retired else state_word(last.last_set, verdict, alarms)
    return {
        "position": name,
        "label": place.label,
        "method": place.method,
        "serial_number": place.serial_number,
        "state": word,
        "stale": is_stale(context.settings.schedule, fresh, age_h),
        "data_h": data_h,
        "data_utc": None if data_h is None else fresh.utc_of(data_h),
        "age_h": age_h,
        "last_set": _row(fresh, last.last_set),
        "last_feature": _row(fresh, last.last_feature),
        "last_thickness": _row(fresh, last.last_thickness),
        "last_verdict": None if verdict is None else with_quality(context, fresh, [verdict])[0],
        "retired_because": retired,
        "active_alarms": len(alarms),
        "highest_severity": max((row.severity for row in alarms), key=SEVERITIES.index, default=None),
    }


def _row(fresh: Freshness, row: Row | None) -> dict[str, Any] | None:
    return None if row is None else fresh.row(row)


def state_word(last_set: SetRow | None, verdict: VerdictRow | None, alarms: Sequence[AlarmRow]) -> str:
    """One word for a position that strikes, the gravest first."""
    if last_set is None:
        return "no_data"
    if alarms:
        return "alarm"
    if verdict is not None and verdict.outlier:
        return "outlier"
    if not METHODS[last_set.method].has_baseline or (verdict is not None and verdict.outlier is not None):
        return "normal"
    return "learning"


def is_stale(schedule: ScheduleSettings, fresh: Freshness, age_h: float | None) -> bool:
    """Tell that the newest set is older than the cadence explains, or nobody records any more."""
    if age_h is None or fresh.recorder.word in {"silent", "absent", "stopped"}:
        return True
    return age_h > STALE_INTERVALS * interval_at(schedule, fresh.now_h)


def interval_at(schedule: ScheduleSettings, hour: float) -> float:
    """Hours between two sets at an hour of the test; after the end, the last phase's."""
    for phase in schedule.phases:
        if hour <= phase.until_h:
            return phase.interval_h
    return schedule.phases[-1].interval_h
