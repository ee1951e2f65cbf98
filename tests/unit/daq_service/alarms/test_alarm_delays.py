"""On-delay, off-delay and deadband of alarms."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.invented_rows import condition

from daq_service.alarms.delays import apply_delays
from daq_service.alarms.guidance import GUIDANCE
from daq_service.alarms.operator_actions import acknowledge_alarm
from daq_service.alarms.states import Moment, update_alarm
from daq_service.settings.alarm_delays import DEAD_BAND_KINDS, LONGEST_DELAY_S, AlarmKindSettings
from hardware_drivers.nanoseconds import NS_PER_S


def moment(at_s):
    return Moment(utc_ns=at_s * NS_PER_S, due_h=at_s / 3600.0, set_index=at_s)


class Alarm:
    """Alarm that is updated with one condition after another."""

    def __init__(self, **rule):
        self.rule = AlarmKindSettings(**rule)
        self.row, self.since_ns, self.events = None, None, []

    def update(self, at_s, present, times_limit=None):
        now = condition(present, times_limit=times_limit)
        now, self.since_ns = apply_delays(self.row, now, self.since_ns, moment(at_s), self.rule)
        change = None if now is None else update_alarm(self.row, now, moment(at_s))
        if change is not None:
            self.row = replace(change.row, id=1)
            self.events.append((at_s, change.event_kind))
        return self

    def is_seen(self, at_s):
        self.row = acknowledge_alarm(self.row, "ann", "", moment(at_s)).row
        return self


def test_a_condition_holds_for_the_on_delay_before_the_alarm_is_raised():
    alarm = Alarm(on_delay_s=60.0).update(0, True).update(59, True)
    assert (alarm.events, alarm.since_ns) == ([], 0)
    assert alarm.update(60, True).events == [(60, "alarm_raised")]
    assert alarm.row.raised_set_index == 60
    assert alarm.since_ns is None


def test_a_condition_that_clears_in_between_restarts_its_on_delay():
    alarm = Alarm(on_delay_s=60.0).update(0, True).update(30, False).update(40, True).update(99, True)
    assert alarm.events == []
    assert alarm.update(100, True).events == [(100, "alarm_raised")]


def test_a_condition_is_gone_for_the_off_delay_before_the_alarm_returns():
    alarm = Alarm(off_delay_s=60.0).update(0, True).update(10, False).update(50, True).update(80, False)
    alarm.is_seen(90).update(139, False)
    assert alarm.events == [(0, "alarm_raised")]
    assert alarm.update(140, False).events[1:] == [(140, "alarm_cleared")]
    assert alarm.row.state == "normal"


def test_an_alarm_that_is_active_again_waits_for_its_on_delay():
    alarm = Alarm(on_delay_s=60.0).update(0, True).update(60, True).update(70, False).update(80, True)
    assert (alarm.row.state, alarm.since_ns) == ("returned_unacknowledged", 80 * NS_PER_S)
    assert alarm.update(140, True).events[-1] == (140, "alarm_reactivated")


def test_a_quantity_in_the_deadband_or_unknown_is_not_normal():
    alarm = Alarm(dead_band_fraction=0.1).update(0, True, 1.4).update(1, False, 0.95).update(2, False)
    assert alarm.events == [(0, "alarm_raised")]
    assert alarm.update(3, False, 0.9).events[1:] == [(3, "alarm_cleared")]


def test_a_deadband_raises_no_alarm():
    assert Alarm(dead_band_fraction=0.1).update(0, False, 0.95).update(1, False).events == []


def test_an_off_delay_starts_after_the_deadband():
    alarm = Alarm(dead_band_fraction=0.1, off_delay_s=60.0).update(0, True, 2.0)
    alarm.update(10, False, 0.95).update(80, False, 0.8).update(139, False, 0.8)
    assert alarm.events == [(0, "alarm_raised")]
    assert alarm.update(140, False, 0.8).events[1:] == [(140, "alarm_cleared")]


@given(st.lists(st.tuples(st.booleans(), st.sampled_from([None, 0.5, 0.95, 1.5])), max_size=12))
def test_without_a_rule_an_alarm_follows_its_condition_at_once(conditions):
    """The behavior is that of a version without delays."""
    alarm, row, expected = Alarm(), None, []
    for at_s, (present, times_limit) in enumerate(conditions):
        alarm.update(at_s, present, times_limit)
        change = update_alarm(row, condition(present), moment(at_s))
        if change is not None:
            row = replace(change.row, id=1)
            expected.append((at_s, change.event_kind))
    assert (alarm.events, alarm.since_ns) == (expected, None)


@pytest.mark.parametrize("kind", [*LONGEST_DELAY_S, *DEAD_BAND_KINDS])
def test_every_kind_with_a_delay_is_an_alarm_kind(kind):
    assert kind in GUIDANCE
