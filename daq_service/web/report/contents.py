"""Contents of a report, read once from the catalogue for all figures and tables."""

from __future__ import annotations

import hashlib
import logging
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from daq_service.assessment.position_status import (
    find_data_age_h,
    find_limit,
    find_status,
    is_data_stale,
    read_latest_rows,
)
from daq_service.catalogue import Catalogue, open_catalogue
from daq_service.catalogue.reader import Filters, LatestRows
from daq_service.catalogue.rows import (
    AlarmRow,
    AnnotationRow,
    AssessmentRow,
    BaselineRow,
    CommandRow,
    EventRow,
    ExperimentRow,
    FeatureRow,
    SetRow,
    ThicknessRow,
    WallRow,
)
from daq_service.catalogue.standard_errors import read_error_columns
from daq_service.commands.audit import AuditEntry, read_audit_log
from daq_service.commands.deadline import mark_if_expired, remaining_now_s
from daq_service.errors import UsageError
from daq_service.processes.freshness import Freshness
from daq_service.settings.stored import restore_settings
from daq_service.settings.tree import Settings
from daq_service.web.tables.choice import find_last_hour_inside
from hardware_drivers.methods import PULSE_ECHO
from hardware_drivers.nanoseconds import NS_PER_H

log = logging.getLogger(__name__)

MOST_SETS = 20_000
"""Limit per position: each set is a point of every figure."""
MOST_LINES = 500
"""Limit for each of alarms, annotations, commands and the audit; the newest are shown."""
OF_WAVES = ("set_index", "due_h", "tof_pp_s", "amplitude_ratio", "quality")
OF_ASSESSMENTS = (
    *("due_h", "distance_squared", "limit_f_predictive", "limit_mean_3sd", "limit_name", "limits"),
    *("mewma_statistic", "diagnosis_details", "outlier", "in_baseline"),
)
OF_FORECAST = ("forecast_low_m", "forecast_m", "forecast_high_m")
OF_WALL = (
    *("due_h", "thickness_m", "interval_low_m", "interval_high_m", "quality"),
    *("minimum_m", "below_minimum_probability", "time_to_minimum_s"),
    *("forecast_h", *OF_FORECAST),
)
OF_ECHOES = ("due_h", "thickness_m", "thickness_loss_m", "interval_low_m", "interval_high_m", "quality")

Columns = Mapping[str, list[Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """Consecutive planned sets that were missed or are incomplete, with one reason."""

    position: str
    state: str
    reason: str
    from_h: float
    to_h: float
    n_sets: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionReport:
    """Position: its present state, and its sets of the range as columns.

    Attributes
    ----------
    values
        Features of the sets' means with their standard errors, or thickness.
    assessments, wall
        Assessments and wall thickness of a transducer; None for pulse echo.
    """

    name: str
    label: str
    method: str
    serial_number: str
    last: LatestRows
    state: str
    age_h: float | None
    stale: bool
    limit: float | None
    values: Columns
    assessments: Columns | None
    wall: Columns | None
    states: Mapping[str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Contents:
    """All contents of a report; hours are those of the test, ``to_h`` is excluded.

    Attributes
    ----------
    files_sha256
        Digest of the names and SHA-256 of the sets' files in the range, in their order; ``n_files`` of them.
    baselines
        Baselines by their id.
    history
        Events of the alarms, by the alarm's id.
    audit
        None: the reader has no permission.
    """

    experiment: ExperimentRow
    settings: Settings
    from_h: float
    to_h: float
    now_h: float
    now_utc_ns: int
    wall_utc_ns: int
    wall_age_s: float | None
    recorder: str
    paused: str | None
    rig_identity: Mapping[str, Any]
    n_files: int
    files_sha256: str
    extractors: Sequence[str]
    positions: Sequence[PositionReport]
    gaps: Sequence[Gap]
    baselines: Mapping[int, BaselineRow]
    alarms: Sequence[AlarmRow]
    history: Mapping[int, Sequence[EventRow]]
    annotations: Sequence[AnnotationRow]
    orders: Sequence[CommandRow]
    audit: Sequence[AuditEntry] | None


def read_report_contents(
    folder: Path, *, from_h: float | None = None, to_h: float | None = None, audited: bool = False
) -> Contents:
    """Read the contents of a report, also of a running test.

    Alarms, annotations, commands and audit entries are limited to the newest 500 each.

    Parameters
    ----------
    from_h, to_h
        Hours of the test, the first included, the last not; None is open.
    audited
        Include the audit log.

    Raises
    ------
    UsageError
        The range is empty, or has more than `MOST_SETS` sets of a position.
    StorageError
        There is no test, or it cannot be read.
    ValidationError
        This version does not accept the stored configuration.
    OSError
        The audit log cannot be read.
    """
    with open_catalogue(folder) as catalogue:
        experiment = catalogue.read_experiment()
        settings = restore_settings(experiment.configuration)
        fresh = Freshness(folder, catalogue, experiment.clock)
        begin_h = 0.0 if from_h is None else from_h
        end_h = math.nextafter(fresh.now_h, math.inf) if to_h is None else to_h
        if not begin_h < end_h:
            raise UsageError(
                f"the report would begin at {begin_h:g} h and end at {end_h:g} h; let it end later"
            )
        filters: Filters = {"first_h": from_h, "last_h": find_last_hour_inside(to_h)}
        sets = {name: _read_sets_in_range(catalogue, name, filters) for name in settings.positions}
        latest = read_latest_rows(catalogue, fresh, settings.positions)
        positions = [
            _build_position_report(catalogue, settings, fresh, last, sets[name], filters)
            for name, last in latest.items()
        ]
        features = [last.last_feature for last in latest.values() if last.last_feature]
        files = {row.file: row.file_sha256 or "" for rows in sets.values() for row in rows if row.file}
        file_list = "".join(f"{file} {sha256}\n" for file, sha256 in sorted(files.items()))
        alarms = [
            fresh.expire_shelf(row)
            for row in catalogue.rows(AlarmRow)
            if _was_active(row, experiment, begin_h, end_h)
        ]
        started = catalogue.read_last_service_event("recorder_started")
        return Contents(
            experiment=experiment,
            settings=settings,
            from_h=begin_h,
            to_h=end_h,
            now_h=fresh.now_h,
            now_utc_ns=fresh.now_utc_ns,
            wall_utc_ns=time.time_ns(),
            wall_age_s=fresh.wall_age_s,
            recorder=fresh.recorder.description,
            paused=catalogue.paused(),
            rig_identity={} if started is None else started.payload.get("rig_identity", {}),
            n_files=len(files),
            files_sha256=hashlib.sha256(file_list.encode()).hexdigest(),
            extractors=sorted({feature.extractor_version for feature in features}),
            positions=positions,
            gaps=[gap for name in settings.positions for gap in _group_gaps(sets[name])],
            baselines=catalogue.read_baselines_by_id(),
            alarms=alarms[-MOST_LINES:],
            history=_read_alarm_history(catalogue, {row.id for row in alarms[-MOST_LINES:]}),
            annotations=catalogue.rows(AnnotationRow, **filters)[-MOST_LINES:],
            orders=[
                mark_if_expired(row, remaining_now_s(row)) for row in catalogue.rows(CommandRow)[-MOST_LINES:]
            ],
            audit=[entry for _, entry in read_audit_log(folder, limit=MOST_LINES)[0]] if audited else None,
        )


def _read_sets_in_range(catalogue: Catalogue, position: str, filters: Filters) -> list[SetRow]:
    """Read the sets of a position in the range, in order; raise UsageError for more than `MOST_SETS`."""
    position_filters: Filters = {**filters, "position": position}
    rows = catalogue.rows(SetRow, limit=MOST_SETS + 1, **position_filters)
    if len(rows) > MOST_SETS:
        raise UsageError(
            f"position {position} has more than {MOST_SETS} sets in this range, and a report shows "
            "each; choose a shorter range of hours"
        )
    return rows


def _build_position_report(
    catalogue: Catalogue,
    settings: Settings,
    fresh: Freshness,
    last: LatestRows,
    sets: Sequence[SetRow],
    filters: Filters,
) -> PositionReport:
    """Read the present state of a position and the columns of its sets in the range.

    ``sets`` are those of the range, ``last`` its newest rows, ``filters`` the range in hours.
    """
    name, age_h = last.position, find_data_age_h(last, fresh)
    position_settings = settings.positions[name]
    is_probe = position_settings.method == PULSE_ECHO
    kind, columns = (ThicknessRow, OF_ECHOES) if is_probe else (FeatureRow, OF_WAVES)
    set_filters: Filters = {**filters, "position": name, "scope": None if is_probe else "set"}
    assessment_filters: Filters = {**set_filters, "scope": None}
    values = catalogue.columns(kind, columns, **set_filters)
    states, assessments, wall = [row.state for row in sets], None, None
    if not is_probe:
        from analysis.statistics.named_limits import MEWMA  # with SciPy, which is slow to import

        values |= read_error_columns(catalogue, OF_WAVES[2:4], values["set_index"], **set_filters)
        assessments = catalogue.columns(AssessmentRow, OF_ASSESSMENTS, **assessment_filters)
        wall = catalogue.columns(WallRow, OF_WALL, **assessment_filters)
        assessments["mewma_limit"] = [(row or {}).get(MEWMA) for row in assessments["limits"]]
    return PositionReport(
        name=name,
        label=position_settings.label,
        method=position_settings.method,
        serial_number=position_settings.serial_number,
        last=last,
        state=find_status(last),
        age_h=age_h,
        stale=is_data_stale(settings.schedule, fresh, age_h),
        limit=find_limit(last, settings.find_wall_limit_m(name)),
        values=values,
        assessments=assessments,
        wall=wall,
        states={state: states.count(state) for state in dict.fromkeys(states)},
    )


def _group_gaps(sets: Sequence[SetRow]) -> list[Gap]:
    """Group the sets of a position that are not done, in order.

    Consecutive ones with the same state and reason become one gap.
    """
    incomplete = enumerate(row for row in sets if row.state != "done")
    # Index minus place in the list is the same for consecutive sets.
    groups = groupby(incomplete, lambda item: (item[1].set_index - item[0], item[1].state, item[1].reason))
    runs = [[row for _, row in group] for _, group in groups]
    return [
        Gap(
            position=run[0].position,
            state=run[0].state,
            reason=run[0].reason or "",
            from_h=run[0].due_h,
            to_h=run[-1].due_h,
            n_sets=len(run),
        )
        for run in runs
    ]


def _was_active(row: AlarmRow, experiment: ExperimentRow, from_h: float, to_h: float) -> bool:
    """Return whether an alarm was raised before ``to_h`` and not cleared before ``from_h`` (hours)."""
    cleared_ns = row.cleared_utc_ns
    cleared_h = math.inf if cleared_ns is None else (cleared_ns - experiment.epoch_utc_ns) / NS_PER_H
    return row.raised_h < to_h and cleared_h >= from_h


def _read_alarm_history(catalogue: Catalogue, ids: set[int | None]) -> dict[int, list[EventRow]]:
    """Read the events of these alarms, ascending, by the id of the alarm.

    Alarms without events have no entry.
    """
    events_by_alarm: dict[int, list[EventRow]] = {}
    for event in catalogue.rows(EventRow, topic="alarms"):
        alarm_id = event.payload.get("alarm_id")
        if isinstance(alarm_id, int) and alarm_id in ids:
            events_by_alarm.setdefault(alarm_id, []).append(event)
    return events_by_alarm
