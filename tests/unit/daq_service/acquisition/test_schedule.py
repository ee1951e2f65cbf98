import pytest

from daq_service.acquisition.schedule import list_due_hours, plan_sets
from daq_service.settings.tree import PhaseSettings, ScheduleSettings


def test_the_paper_has_425_sets_and_a_baseline_of_48():
    hours = list_due_hours(ScheduleSettings().phases)
    assert len(hours) == 425
    assert hours[149] == 75.0, "the paper: measurement 150, i.e. about 75 h"
    assert hours[-1] == 350.0
    assert sum(hour <= 24.0 for hour in hours) == 48


def test_hours_do_not_drift_with_many_sets():
    hours = list_due_hours([PhaseSettings(until_h=1000.0, interval_h=0.1)])
    assert len(hours) == 10_000
    # One rounding of k * interval, not ten thousand of a running sum.
    assert hours[-1] == pytest.approx(1000.0, abs=1e-12)


def test_an_end_cuts_the_plan_and_keeps_the_set_due_then():
    assert list_due_hours(ScheduleSettings().phases, end_h=2.0) == [0.5, 1.0, 1.5, 2.0]


def test_a_plan_counts_from_the_epoch():
    first = plan_sets(ScheduleSettings().phases, 1_000)[0]
    assert (first.set_index, first.due_h, first.due_utc_ns) == (0, 0.5, 1_000 + 1_800_000_000_000)


@pytest.mark.parametrize(("until_h", "interval_h", "sets"), [(0.3, 0.1, 3), (0.7, 0.1, 7), (2.3, 0.23, 10)])
def test_a_decimal_interval_loses_no_set_to_rounding(until_h, interval_h, sets):
    assert int(until_h / interval_h) == sets - 1, "an example that rounding cuts"
    hours = list_due_hours([PhaseSettings(until_h=until_h, interval_h=interval_h)])
    assert len(hours) == sets
    assert hours[-1] == pytest.approx(until_h, rel=1e-12)


def test_a_phase_begins_where_the_one_before_ended():
    phases = [PhaseSettings(until_h=1.0, interval_h=0.4), PhaseSettings(until_h=3.0, interval_h=1.0)]
    assert list_due_hours(phases) == [0.4, 0.8, 2.0, 3.0]
