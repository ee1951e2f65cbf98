"""Read the status of a test from its folder: values with limits, quality and age."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from daq_service.acquisition.schedule import list_due_hours
from daq_service.alarms.evidence import describe_baseline_anomalies
from daq_service.assessment.confirmation import count_requests, read_confirmations, summarize_confirmation
from daq_service.assessment.position_status import find_data_age_h, find_limit, find_status, is_data_stale
from daq_service.assessment.stored_limits import find_chart_statistic
from daq_service.catalogue import Catalogue, open_catalogue
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.errors import NoDataYetError
from daq_service.catalogue.experiment_file import HISTORY_FILE
from daq_service.catalogue.history import describe_lost_newest_event, read_history
from daq_service.catalogue.reader import LatestRows
from daq_service.catalogue.rows import (
    AlarmRow,
    AssessmentRow,
    BaselineRow,
    CommandRow,
    EnvironmentRow,
    SetRow,
    as_dict,
)
from daq_service.commands.deadline import mark_if_expired, remaining_now_s
from daq_service.corrosion_drive.supply_state import describe_supply, read_supply_status
from daq_service.errors import StorageError
from daq_service.processes.disk_policy import forecast_disk
from daq_service.processes.freshness import Freshness
from daq_service.processes.heartbeat import compute_test_time_ns
from daq_service.processes.lost_catalogue import describe_loss
from daq_service.processes.lost_sets import find_lost_sets
from daq_service.processes.recorder_state import read_recorder_state
from daq_service.settings.tree import Settings
from hardware_drivers.methods import SOLITARY_WAVE
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

LOOKED_AT = 4000
"""The files of so many of the newest rows are looked at; ``doctor`` and a recorder look at all."""
END_BYTES = 100_000
"""Of the history; its last line is enough."""
GAPS_A_POSITION = 5
"""So many of the newest gaps of a position are named."""


def describe_status(folder: Path, settings: Settings) -> dict[str, object]:
    """Read recorder, counts, gaps, commands, disk, supply, and the newest rows of each position.

    Returns an object for JSON; before the first data most values are None or empty.

    Raises
    ------
    StorageError
        The catalogue is lost, or cannot be read.
    """
    drive = read_supply_status(folder)
    supply = None if drive is None else {**asdict(drive), "description": describe_supply(drive)}
    try:
        with open_catalogue(folder, writer=False) as catalogue:
            fresh = Freshness(folder, catalogue, settings.clock.kind)
            counts, schedule = catalogue.counts(), settings.schedule
            hours = list_due_hours(schedule.phases, end_h=schedule.end_h)
            baselines = catalogue.read_newest_baselines()
            return {
                "recorder": fresh.recorder.description,
                "recorder_state": fresh.recorder.status,
                "now_h": fresh.now_h,
                "wall_age_s": fresh.wall_age_s,
                "system_ahead_s": fresh.system_ahead_s,
                "supply": supply,
                "climate": _describe_newest_climate(catalogue.read_last_environment()),
                "paused": catalogue.paused(),
                "orders": _list_open_commands(catalogue),
                "counts": counts,
                "next_due_h": next(iter(hours[counts["sets"] + counts["missed_sets"] :]), None),
                "gaps": _list_gaps(catalogue) if counts["missed_sets"] + counts["partial_sets"] else [],
                "lost": _describe_lost_events(folder, catalogue)
                | find_lost_sets(folder, catalogue, newest_rows=LOOKED_AT),
                "confirmations": _summarize_confirmations(
                    catalogue,
                    settings.list_positions(SOLITARY_WAVE),
                    settings.alarms.confirmation_sets_a_day,
                    fresh,
                ),
                "disk": asdict(forecast_disk(folder, settings.storage, settings.schedule, catalogue)),
                "positions": {
                    name: {
                        **_convert_newest_rows(latest),
                        **_compute_present_state(settings, fresh, latest),
                        "baseline": _describe_baseline(baselines.get(name)),
                    }
                    for name, latest in (
                        (name, fresh.expire_shelves(found))
                        for name, found in catalogue.read_latest_rows().items()
                    )
                },
                "alarms": [
                    {**as_dict(fresh.expire_shelf(row)), "age_h": fresh.age_h(row.raised_h)}
                    for row in catalogue.rows(AlarmRow, active=True)
                ],
            }
    except NoDataYetError:
        if reason := describe_loss(folder):
            raise StorageError(reason) from None
        recorder = read_recorder_state(folder, [])
        recorder_ns = compute_test_time_ns(recorder.beat)
        nothing = dict.fromkeys(
            ("now_h", "wall_age_s", "climate", "paused", "counts", "next_due_h", "disk", "confirmations")
        )
        return {
            "recorder": recorder.description,
            "recorder_state": recorder.status,
            "system_ahead_s": None if recorder_ns is None else (time.time_ns() - recorder_ns) / NS_PER_S,
            "supply": supply,
            **nothing,
            "orders": [],
            "gaps": [],
            "lost": {},
            "positions": {},
            "alarms": [],
        }


def _describe_newest_climate(row: EnvironmentRow | None) -> dict[str, object] | None:
    """Return quality, age (s), temperature (°C) and humidity (fraction) of a set; None without a probe."""
    if row is None or row.climate_quality == "absent":
        return None
    names = ("climate_quality", "climate_age_s", "temperature_c", "relative_humidity")
    return {name: getattr(row, name) for name in names}


def _describe_lost_events(folder: Path, catalogue: Catalogue) -> dict[str, str]:
    """Return a description by file if the catalogue lacks events of the history; empty if it has all.

    An unreadable history is described instead. Only its last `END_BYTES` are read.
    """
    try:
        lacking = describe_lost_newest_event(read_history(folder, tail_bytes=END_BYTES), catalogue)
    except OSError as error:
        return {HISTORY_FILE: f"cannot be read: {error}"}
    return {FILE_NAME: lacking} if lacking else {}


def _convert_newest_rows(latest: LatestRows) -> dict[str, object]:
    """Convert the newest rows and active alarms of a position to objects for JSON; None for missing."""
    names = ("last_set", "last_feature", "last_assessment", "last_thickness", "last_wall")
    rows_by_name = {name: None if (row := getattr(latest, name)) is None else as_dict(row) for name in names}
    return {
        "position": latest.position,
        "method": latest.method,
        **rows_by_name,
        "active_alarms": [as_dict(row) for row in latest.active_alarms],
    }


def _compute_present_state(settings: Settings, fresh: Freshness, last: LatestRows) -> dict[str, object]:
    """Compute the values that change with time: state, data age (h), staleness, limit, control chart.

    The limit is a thickness in m or a squared distance, by method. Limit and chart (statistic and its limit)
    are None where there is none.
    """
    age_h = find_data_age_h(last, fresh)
    chart = find_chart_statistic(last.last_assessment, settings.alarms)
    return {
        "state": find_status(last),
        "age_h": age_h,
        "stale": is_data_stale(settings.schedule, fresh, age_h),
        "limit": find_limit(last, settings.find_wall_limit_m(last.position)),
        "chart": None if chart is None else dict(zip(("statistic", "limit"), chart, strict=True)),
    }


def _describe_baseline(row: BaselineRow | None) -> dict[str, object] | None:
    """Return name, size, state, limit reason, design false-alarm rate and doubts of a baseline.

    The rate comes with whether it is verified and why not. None without a baseline.
    """
    if row is None:
        return None
    names = ("false_alarms_per_sensor_year", "rate_verified", "rate_not_verified_reason")
    return {
        "name": row.name,
        "n_sets": row.n_sets,
        "state": row.state,
        "limit_reason": row.limit_reason,
        **{name: (row.baseline_quality or {}).get(name) for name in names},
        "doubts": describe_baseline_anomalies(row.baseline_quality),
    }


def _summarize_confirmations(
    catalogue: Catalogue, transducers: Sequence[str], maximum_a_day: int, fresh: Freshness
) -> dict[str, object]:
    """Return the confirmation sets' number, newest result, and by transducer how many are left today."""
    rows = catalogue.rows(SetRow, purpose="confirmation")
    newest = max(rows, key=lambda row: row.due_utc_ns, default=None)
    last = None
    if newest is not None:
        assessments = catalogue.rows(AssessmentRow, position=newest.position, **newest.set_key._asdict())
        result = asdict(summarize_confirmation(newest, assessments[0] if assessments else None))
        last = {"position": newest.position, **result, "age_h": fresh.age_h(newest.due_h)}
    requested = read_confirmations(catalogue)
    return {
        "sets": len(rows),
        "last": last,
        "left_today": {
            name: max(0, maximum_a_day - count_requests(name, requested, fresh.now_h)) for name in transducers
        },
    }


def _list_open_commands(catalogue: Catalogue) -> list[dict[str, object]]:
    """List the commands that are pending or started, without expired ones; remaining time in s.

    Each with id, kind, author, arguments and state.
    """
    waiting = catalogue.rows(CommandRow, states={"pending", "started"})
    commands_with_time = [(row, remaining_now_s(row)) for row in waiting]
    names = ("id", "kind", "author", "arguments", "state")
    return [
        {**{name: getattr(row, name) for name in names}, "expires_in_s": left_s}
        for row, left_s in commands_with_time
        if mark_if_expired(row, left_s).state in ("pending", "started")
    ]


def _list_gaps(catalogue: Catalogue) -> list[dict[str, object]]:
    """List the newest incomplete sets, at most `GAPS_A_POSITION`, oldest first, with positions and reason."""
    found: dict[tuple[int, str, str | None, float], list[str]] = {}
    for row in catalogue.read_newest_gaps(GAPS_A_POSITION):
        found.setdefault((row.set_index, row.state, row.reason, row.due_h), []).append(row.position)
    names = ("set_index", "state", "reason", "due_h", "positions")
    newest = sorted(found.items(), key=lambda item: item[0][0])[-GAPS_A_POSITION:]
    return [dict(zip(names, (*gap, positions), strict=True)) for gap, positions in newest]
