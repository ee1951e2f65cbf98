"""What the configuration says of judging a transducer."""

from __future__ import annotations

from analysis.statistics.design import Budget
from analysis.statistics.rules import AlarmRule, HoleRule
from daq_service.acquisition.schedule import due_hours
from daq_service.assessment.baseline_lifecycle import Planned, name_of
from daq_service.assessment.solitary_wave_step import Rules
from daq_service.settings.tree import Settings

HOURS_PER_DAY = 24.0


def rules_of(settings: Settings, *, baseline: Planned, position: str, has_chart: bool = True) -> Rules:
    """Collect what the configuration says of judging a transducer; see `Rules` for one without a chart."""
    return Rules(
        baseline_name=name_of(position, baseline.number),
        first_baseline_set=baseline.first_set,
        last_baseline_set=baseline.last_set,
        minimum_sets=settings.baseline.minimum_sets,
        minimum_valid_shots=settings.baseline.minimum_valid_shots,
        shots_per_set=settings.schedule.shots_per_set,
        limit=settings.novelty.limit,
        false_alarm_rate=settings.novelty.false_alarm_rate,
        run_length=run_length(settings) if has_chart else None,
        false_alarms_per_sensor_year=settings.false_alarms_per_sensor_year(),
        decides_by=settings.alarms.decides_by,
        alarm=AlarmRule(k=settings.alarms.k, n=settings.alarms.n),
        hole=HoleRule(shots=settings.alarms.hole_shots, consecutive_sets=settings.alarms.hole_sets),
    )


def run_length(settings: Settings) -> float:
    """Count the sets from one false alarm of a healthy sensor to the next: the budget at the mean cadence.

    The plan behind the baseline counts, whole: a test that is cut short keeps its rate.
    """
    begin_h, phases = settings.baseline.hours, settings.schedule.phases
    later = [hour for hour in due_hours(phases) if hour > begin_h]
    interval_h = (later[-1] - begin_h) / len(later) if later else phases[-1].interval_h
    budget = settings.false_alarms_per_sensor_year()
    return Budget(alarms_per_year=budget, sets_per_day=HOURS_PER_DAY / interval_h).run_length
