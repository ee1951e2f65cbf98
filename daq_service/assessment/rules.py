"""Rules of assessment from the configuration."""

from __future__ import annotations

from analysis.assessment.step import Rules
from analysis.statistics.design import Budget
from analysis.statistics.rules import AlarmRule, HoleRule
from daq_service.acquisition.schedule import list_due_hours
from daq_service.assessment.baseline_lifecycle import BaselineRange, format_baseline_name
from daq_service.settings.tree import ScheduleSettings, Settings

HOURS_PER_DAY = 24.0


def build_rules(
    settings: Settings, *, baseline: BaselineRange, position: str, has_chart: bool = True
) -> Rules:
    """Build the rules of a transducer's assessment from the configuration.

    Parameters
    ----------
    baseline
        Range of sets of the current baseline.
    has_chart
        False: no control chart (``run_length`` is None), as for a baseline of a version without charts.
    """
    alarms_per_year = settings.false_alarms_per_sensor_year()
    sets_per_alarm = compute_run_length(settings.schedule, settings.baseline.hours, alarms_per_year)
    return Rules(
        baseline_name=format_baseline_name(position, baseline.number),
        first_baseline_set=baseline.first_set,
        last_baseline_set=baseline.last_set,
        minimum_sets=settings.baseline.minimum_sets,
        minimum_valid_shots=settings.baseline.minimum_valid_shots,
        shots_per_set=settings.schedule.shots_per_set,
        limit=settings.novelty.limit,
        false_alarm_rate=settings.novelty.false_alarm_rate,
        run_length=sets_per_alarm if has_chart else None,
        false_alarms_per_sensor_year=alarms_per_year,
        decides_by=settings.alarms.decides_by,
        alarm=AlarmRule(k=settings.alarms.k, n=settings.alarms.n),
        hole=HoleRule(shots=settings.alarms.hole_shots, consecutive_sets=settings.alarms.hole_sets),
    )


def compute_run_length(schedule: ScheduleSettings, baseline_end_h: float, alarms_per_year: float) -> float:
    """Compute the mean number of sets between two false alarms of a healthy transducer (average run length).

    It corresponds to ``alarms_per_year`` at the mean interval of the complete schedule after the baseline;
    without a set there, at the interval of the last phase. A test that ends early keeps its rate.
    """
    phases = schedule.phases
    hours_after = [hour for hour in list_due_hours(phases) if hour > baseline_end_h]
    interval_h = (
        (hours_after[-1] - baseline_end_h) / len(hours_after) if hours_after else phases[-1].interval_h
    )
    return Budget(alarms_per_year=alarms_per_year, sets_per_day=HOURS_PER_DAY / interval_h).run_length
