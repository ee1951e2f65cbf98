"""Status of a position, and whether its data are older than they should be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from daq_service.alarms.states import NOT_ASSESSED, find_disabled
from daq_service.assessment.methods import METHODS
from daq_service.assessment.stored_limits import collect_limits_by_name
from daq_service.catalogue import Catalogue
from daq_service.catalogue.reader import LatestRows
from daq_service.processes.freshness import Freshness
from daq_service.settings.tree import PositionSettings, ScheduleSettings

STALE_INTERVALS = 1.5
"""A set may be late by half an interval before its position counts as stale."""

PositionStatus = Literal[
    "no_data",
    "normal",
    "collecting_baseline",
    "not_assessed",
    "outlier",
    "shelved",
    "out_of_service",
    "disabled",
    "alarm",
]
"""Statuses of a position in rising urgency: an alarm needs a person, a retirement is known to one."""


def find_status(last: LatestRows) -> PositionStatus:
    """Return the status of a position from its latest rows; it is never ``normal`` while an alarm is active.

    The order is: disabled, no data, alarm, out of service, shelved, outlier, then the state of the baseline.

    Parameters
    ----------
    last
        Its latest rows, with the current alarms: expired shelves removed (`Freshness.expire_shelves`).
    """
    assessment = last.last_assessment
    if find_disabled(last.active_alarms):
        return "disabled"
    if last.last_set is None:
        return "no_data"
    suppressions = {row.suppressed for row in last.active_alarms if row.kind != NOT_ASSESSED}
    if None in suppressions:
        return "alarm"
    if suppressions:
        return "out_of_service" if "out_of_service" in suppressions else "shelved"
    if assessment is not None and assessment.outlier:
        return "outlier"
    if not METHODS[last.method].has_baseline or (assessment is not None and assessment.outlier is not None):
        return "normal"
    return "collecting_baseline" if assessment is None or assessment.in_baseline else "not_assessed"


def find_data_age_h(last: LatestRows, fresh: Freshness) -> float | None:
    """Return the age of a position's newest set with data, h of the test, at least 0; None without one."""
    data_h = find_newest_data_hour(last)
    return None if data_h is None else fresh.age_h(data_h)


def read_latest_rows(
    catalogue: Catalogue, fresh: Freshness, positions: Mapping[str, PositionSettings]
) -> dict[str, LatestRows]:
    """Read the newest rows of each configured position, with expired shelves removed from its alarms.

    A position without rows gets empty ones. Raise StorageError if the catalogue cannot be read.
    """
    stored = catalogue.read_latest_rows()
    return {
        name: fresh.expire_shelves(stored.get(name) or LatestRows(position=name, method=place.method))
        for name, place in positions.items()
    }


def find_limit(last: LatestRows, wall_limit_m: float) -> float | None:
    """Return a position's limit: minimum thickness of a probe in m, or the chosen limit of a transducer.

    None for a transducer without an assessment, or whose assessment has no limit.

    Parameters
    ----------
    wall_limit_m
        Minimum thickness of the position by the configuration, m.
    """
    if not METHODS[last.method].has_baseline:
        return wall_limit_m
    assessment = last.last_assessment
    if assessment is None:
        return None
    return collect_limits_by_name(assessment).get(assessment.limit_name)


def find_newest_data_hour(last: LatestRows) -> float | None:
    """Return the hour of the test when the newest set with data was due; None before the first one.

    A set that was missed, or scheduled for a disabled transducer, has no data.
    """
    return max(
        (row.due_h for row in (last.last_feature, last.last_thickness) if row is not None), default=None
    )


def is_data_stale(schedule: ScheduleSettings, fresh: Freshness, age_h: float | None) -> bool:
    """Return whether the newest data are older than `STALE_INTERVALS` set intervals, or no recorder runs.

    True also if there are no data (``age_h`` None). The interval is that of the current phase of the
    schedule.
    """
    if age_h is None or fresh.recorder.status in {"not_responding", "not_started", "stopped"}:
        return True
    return age_h > STALE_INTERVALS * find_set_interval_h(schedule, fresh.now_h)


def find_set_interval_h(schedule: ScheduleSettings, hour: float) -> float:
    """Return the interval between sets, h, of the schedule's phase at an hour of the test.

    After the end of the schedule, that of the last phase.
    """
    for phase in schedule.phases:
        if hour <= phase.until_h:
            return phase.interval_h
    return schedule.phases[-1].interval_h
