"""Summarize a finished test per position from the catalogue."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from daq_service.assessment.stored_limits import collect_limits_by_name
from daq_service.catalogue import open_catalogue
from daq_service.catalogue.rows import (
    AlarmRow,
    AssessmentRow,
    BaselineRow,
    EventRow,
    FeatureRow,
    ThicknessRow,
)
from daq_service.catalogue.store import Catalogue
from daq_service.settings.tree import BaselineSettings, Settings
from hardware_drivers.methods import PULSE_ECHO

OF_SOLITARY_WAVES = (
    *("outlier_fraction_before_100_h", "outlier_fraction_after_100_h"),
    *("outlier_fraction_after_100_h_paper_limit", "tof_us", "amplitude_ratio"),
    *("limit", "limit_name", "limit_paper", "limit_reason", "n_baseline"),
)
SPLIT_H = 100.0
"""The paper counts outliers after 100 h."""


def summarise_run(settings: Settings, folder: Path) -> dict[str, object]:
    """Read counts, cost, and for each position alarm hour, outliers, last features and limit.

    Returns an object for JSON; values that do not apply to a position's method are None. Raises StorageError
    if the catalogue cannot be read.
    """
    with open_catalogue(folder, writer=False) as catalogue:
        counts = catalogue.counts()
        positions = {
            name: _summarise_pulse_echo(catalogue, name)
            if place.method == PULSE_ECHO
            else _summarise_solitary_wave(catalogue, settings.baseline, settings.novelty.limit, name)
            for name, place in settings.positions.items()
        }
        return {
            "sets": counts["sets"],
            "shots": counts["shots"],
            "pulse_echo_records": counts["pulse_echo_records"],
            "missed_sets": counts["missed_sets"],
            "seed": settings.twin.seed,
            "cost": _read_wall_times(catalogue),
            "positions": positions,
        }


def sum_stage_seconds(cost: dict[str, float]) -> float:
    """Return the total wall time in s of all stages in ``cost``, whose key ``sets`` is no stage."""
    return sum(value for name, value in cost.items() if name != "sets")


def _read_wall_times(catalogue: Catalogue) -> dict[str, float] | None:
    """Return the wall time in s by stage of the recorder's last run; None if no run ended normally."""
    rows = [row for row in catalogue.rows(EventRow, topic="service") if "cost" in row.payload]
    return rows[-1].payload["cost"] if rows else None


def _summarise_solitary_wave(
    catalogue: Catalogue, rules: BaselineSettings, limit_name: str, position: str
) -> dict[str, object]:
    """Summarize a solitary-wave transducer: first alarm (h), outlier fractions, ToF (us), AR, limit.

    Missing values, and those of echoes, are None.
    """
    assessments = catalogue.rows(AssessmentRow, position=position)
    assessed = [row for row in assessments if not row.in_baseline and row.outlier is not None]
    after = [row for row in assessed if row.due_h > SPLIT_H]
    baseline = catalogue.baseline(position)
    last = _find_last_good_feature(catalogue, rules.minimum_valid_shots, position)
    limit = None if baseline is None else collect_limits_by_name(baseline).get(limit_name)
    return {
        "first_alarm_h": _find_first_alarm_h(catalogue, position),
        "outlier_fraction_before_100_h": _outlier_fraction(
            row.outlier for row in assessed if row.due_h <= SPLIT_H
        ),
        "outlier_fraction_after_100_h": _outlier_fraction(row.outlier for row in after),
        "outlier_fraction_after_100_h_paper_limit": _outlier_fraction(row.outlier_mean_3sd for row in after),
        "tof_us": None if last is None else _scale_value(last.tof_pp_s, 1e6),
        "amplitude_ratio": None if last is None else last.amplitude_ratio,
        "limit": limit,
        "limit_name": limit_name,
        "limit_paper": None if baseline is None else baseline.limit_mean_3sd,
        "limit_reason": "the baseline is still being recorded" if baseline is None else baseline.limit_reason,
        "n_baseline": _count_baseline_sets(catalogue, baseline, position),
        "travel_time_us": None,
        "thickness_mm": None,
    }


def _summarise_pulse_echo(catalogue: Catalogue, position: str) -> dict[str, object]:
    """Summarize an ultrasonic probe: first alarm (h), last travel time (us) and thickness (mm).

    Missing values, and those of solitary waves, are None.
    """
    rows = [row for row in catalogue.rows(ThicknessRow, position=position) if row.thickness_m is not None]
    last = rows[-1] if rows else None
    return {
        **dict.fromkeys(OF_SOLITARY_WAVES),
        "first_alarm_h": _find_first_alarm_h(catalogue, position),
        "travel_time_us": None if last is None else _scale_value(last.travel_time_s, 1e6),
        "thickness_mm": None if last is None else _scale_value(last.thickness_m, 1e3),
    }


def _scale_value(value: float | None, factor: float) -> float | None:
    """Multiply a value by a factor; None stays None."""
    return None if value is None else value * factor


def _find_last_good_feature(catalogue: Catalogue, minimum_valid: int, position: str) -> FeatureRow | None:
    """Return the newest features of a set with enough valid shots and a ToF; None if there are none."""
    rows = catalogue.rows(FeatureRow, position=position, scope="set")
    good = [row for row in rows if row.n_valid >= minimum_valid and row.tof_pp_s is not None]
    return good[-1] if good else None


def _count_baseline_sets(catalogue: Catalogue, baseline: BaselineRow | None, position: str) -> int:
    """Return the number of sets in the frozen baseline, or collected so far if it is None."""
    if baseline is not None:
        return baseline.n_sets
    return sum(1 for row in catalogue.rows(AssessmentRow, position=position) if row.in_baseline)


def _find_first_alarm_h(catalogue: Catalogue, position: str) -> float | None:
    """Return the hour of the first damage alarm at a position; None without one."""
    alarms = catalogue.rows(AlarmRow, position=position)
    return min((row.raised_h for row in alarms if row.alarm_class == "damage"), default=None)


def _outlier_fraction(outliers: Iterable[bool | None]) -> float | None:
    """Compute the fraction of outliers among the values that are not None; None if there are none."""
    known = [outlier for outlier in outliers if outlier is not None]
    return sum(known) / len(known) if known else None


def format_summary_lines(summary: dict[str, Any], folder: Path) -> Iterator[str]:
    """Yield the summary as lines: totals, a table of positions, seconds by stage, and the folder."""
    yield (
        f"{summary['sets']} sets, {summary['shots']} solitary-wave shots, {summary['pulse_echo_records']} "
        f"pulse-echo records, {summary['missed_sets']} sets missed (seed {summary['seed']})"
    )
    yield (
        "position  first alarm  outliers to/after 100 h   last ToF    AR     thickness  limit (baseline sets)"
    )
    for name, row in summary["positions"].items():
        before, after = row["outlier_fraction_before_100_h"], row["outlier_fraction_after_100_h"]
        yield (
            f"{name:<8}  {_format_cell(row['first_alarm_h'], '9.1f', ' h'):>11}  "
            f"{_format_percent(before):>9} /{_format_percent(after):>8}      "
            f"{_format_cell(row['tof_us'], '.1f', ' us'):>9}  "
            f"{_format_cell(row['amplitude_ratio'], '.3f', ''):>6}  "
            f"{_format_cell(row['thickness_mm'], '.2f', ' mm'):>9}  {_format_limit(row)}"
        )
    if summary["cost"] is not None:
        stages = (
            f"{name.removesuffix('_s')} {value:.1f}"
            for name, value in summary["cost"].items()
            if name != "sets"
        )
        total_s = sum_stage_seconds(summary["cost"])
        yield f"seconds of the recorder's last run: {', '.join(stages)}; together {total_s:.1f}"
    yield f"files: {folder / 'sets'}"


def _format_limit(row: dict[str, object]) -> str:
    """Format limit, its name and baseline size; the reason if there is no limit, "-" for a probe."""
    if row["n_baseline"] is None:
        return "-"
    if row["limit"] is None:
        return f"none: {row['limit_reason']}"
    return f"{row['limit']:.1f} {row['limit_name']} ({row['n_baseline']})"


def _format_cell(value: float | None, form: str, unit: str) -> str:
    """Format a cell of a table with a format specification and its unit; "-" if it is None."""
    return "-" if value is None else f"{value:{form}}".strip() + unit


def _format_percent(value: float | None) -> str:
    """Format a fraction in percent with one decimal; "-" if it is None."""
    return "-" if value is None else f"{100 * value:.1f} %"
