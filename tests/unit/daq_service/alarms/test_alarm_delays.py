"""On-delay, off-delay and dead-band: what holds an alarm back before it follows its condition."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq_service.alarms.delays import apply_delays
from daq_service.alarms.guidance import GUIDANCE
from daq_service.alarms.states import Condition, Moment, acknowledge, update
from daq_service.settings.alarm_delays import DEAD_BAND_KINDS, LONGEST_DELAY_S, AlarmKindSettings
from hardware_drivers.nanoseconds import NS_PER_S


def condition(present, *, times_limit=None, kind="wall_change"):
    return Condition(
        position="B",
        kind=kind,
        family="damage",
        severity="high",
        present=present,
        times_limit=times_limit,
        message="3 of 5",
    )


def moment(at_s):
    return Moment(utc_ns=at_s * NS_PER_S, due_h=at_s / 3600.0, set_index=at_s)


class Alarm:
    """An alarm that is told of one condition after another."""

    def __init__(self, **rule):
        self.kinds = {"wall_change": AlarmKindSettings(**rule)}
        self.row, self.since_ns, self.told = None, None, []

    def tell(self, at_s, present, times_limit=None):
        now = condition(present, times_limit=times_limit)
        now, self.since_ns = apply_delays(self.row, now, self.since_ns, moment(at_s), self.kinds)
        change = None if now is None else update(self.row, now, moment(at_s))
        if change is not None:
            self.row = replace(change.row, id=1)
            self.told.append((at_s, change.event_kind))
        return self

    def is_seen(self, at_s):
        self.row = acknowledge(self.row, "ann", "", moment(at_s)).row
        return self


def test_a_condition_holds_for_the_on_delay_before_the_alarm_is_raised():
    alarm = Alarm(on_delay_s=60.0).tell(0, True).tell(59, True)
    assert (alarm.told, alarm.since_ns) == ([], 0)
    assert alarm.tell(60, True).told == [(60, "alarm_raised")]
    assert alarm.row.raised_set_index == 60
    assert alarm.since_ns is None


def test_a_condition_that_goes_in_between_begins_its_on_delay_anew():
    alarm = Alarm(on_delay_s=60.0).tell(0, True).tell(30, False).tell(40, True).tell(99, True)
    assert alarm.told == []
    assert alarm.tell(100, True).told == [(100, "alarm_raised")]


def test_a_condition_is_gone_for_the_off_delay_before_the_alarm_returns():
    alarm = Alarm(off_delay_s=60.0).tell(0, True).tell(10, False).tell(50, True).tell(80, False)
    alarm.is_seen(90).tell(139, False)
    assert alarm.told == [(0, "alarm_raised")]
    assert alarm.tell(140, False).told[1:] == [(140, "alarm_cleared")]
    assert alarm.row.state == "normal"


def test_an_alarm_that_comes_back_waits_for_its_on_delay_again():
    alarm = Alarm(on_delay_s=60.0).tell(0, True).tell(60, True).tell(70, False).tell(80, True)
    assert (alarm.row.state, alarm.since_ns) == ("returned_unacknowledged", 80 * NS_PER_S)
    assert alarm.tell(140, True).told[-1] == (140, "alarm_returned")


def test_within_the_dead_band_or_unknown_the_quantity_is_not_back():
    alarm = Alarm(dead_band_fraction=0.1).tell(0, True, 1.4).tell(1, False, 0.95).tell(2, False)
    assert alarm.told == [(0, "alarm_raised")]
    assert alarm.tell(3, False, 0.9).told[1:] == [(3, "alarm_cleared")]


def test_a_dead_band_raises_nothing():
    assert Alarm(dead_band_fraction=0.1).tell(0, False, 0.95).tell(1, False).told == []


def test_an_off_delay_begins_behind_the_dead_band():
    alarm = Alarm(dead_band_fraction=0.1, off_delay_s=60.0).tell(0, True, 2.0)
    alarm.tell(10, False, 0.95).tell(80, False, 0.8).tell(139, False, 0.8)
    assert alarm.told == [(0, "alarm_raised")]
    assert alarm.tell(140, False, 0.8).told[1:] == [(140, "alarm_cleared")]


@given(st.lists(st.tuples(st.booleans(), st.sampled_from([None, 0.5, 0.95, 1.5])), max_size=12))
def test_without_a_rule_an_alarm_follows_its_condition_at_once(told):
    """What it did before there were delays."""
    alarm, row, expected = Alarm(), None, []
    for at_s, (present, times_limit) in enumerate(told):
        alarm.tell(at_s, present, times_limit)
        change = update(row, condition(present), moment(at_s))
        if change is not None:
            row = replace(change.row, id=1)
            expected.append((at_s, change.event_kind))
    assert (alarm.told, alarm.since_ns) == (expected, None)


@pytest.mark.parametrize("kind", [*LONGEST_DELAY_S, *DEAD_BAND_KINDS])
def test_there_are_alarms_of_the_kinds_that_may_wait(kind):
    assert kind in GUIDANCE
