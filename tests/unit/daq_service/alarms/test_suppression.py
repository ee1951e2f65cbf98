"""Shelved and out-of-service alarms: counted separately and active again after the set time."""

from dataclasses import replace

import pytest
from support.invented_rows import condition

from daq_service.alarms.operator_actions import (
    acknowledge_alarm,
    end_expired_shelf,
    end_suppression,
    remove_expired_shelf,
    report_overdue_response,
    shelve,
    take_out_of_service,
)
from daq_service.alarms.states import Moment, update_alarm
from hardware_drivers.nanoseconds import NS_PER_H

WALL_NS = 10**18


def at(hour):
    return Moment(utc_ns=round(hour * NS_PER_H), due_h=hour, set_index=None)


def raised():
    return replace(update_alarm(None, condition(priority="medium"), at(1.0)).row, id=1)


def shelved(for_h=8.0):
    change = shelve(raised(), "ann", "a known leak", for_h, at(2.0), WALL_NS)
    assert change.event_kind == "alarm_shelved"
    return change.row


def test_a_shelved_alarm_keeps_its_state_and_has_author_reason_and_end():
    row = shelved()
    assert (row.state, row.suppressed) == ("unacknowledged", "shelved")
    assert (row.suppressed_by, row.suppressed_reason) == ("ann", "a known leak")
    assert row.shelved_until_utc_ns == 10 * NS_PER_H
    assert row.shelved_until_wall_utc_ns == WALL_NS + 8 * NS_PER_H


@pytest.mark.parametrize(
    ("hour", "wall_h", "is_over"),
    [(9.99, 7.99, False), (10.0, 0.0, True), (2.0, 8.0, True)],
    ids=["before both", "by the test's hours", "in real time, while the test stands still"],
)
def test_a_shelf_ends_by_the_earlier_of_two_clocks(hour, wall_h, is_over):
    row, wall_ns = shelved(), WALL_NS + round(wall_h * NS_PER_H)
    seen = remove_expired_shelf(row, utc_ns=at(hour).utc_ns, wall_utc_ns=wall_ns)
    assert (seen.suppressed is None) == is_over
    change = end_expired_shelf(row, at(hour), wall_ns)
    assert (change is not None) == is_over
    if change is not None:
        assert (change.event_kind, change.row.suppressed) == ("alarm_shelf_expired", None)
        assert change.row.state == "unacknowledged"


def test_a_shelf_also_holds_the_next_alarm_of_its_kind():
    seen = acknowledge_alarm(shelved(), "ben", "", at(3.0)).row
    over = update_alarm(seen, condition(False, priority="medium"), at(4.0))
    assert (over.row.state, over.row.suppressed) == ("normal", "shelved")
    again = update_alarm(over.row, condition(priority="medium"), at(5.0))
    assert (again.row.id, again.row.suppressed) == (None, "shelved")
    assert again.row.shelved_until_utc_ns == 10 * NS_PER_H


def test_a_raised_priority_ends_a_shelf_but_not_out_of_service():
    worse = condition(priority="high")
    change = update_alarm(shelved(), worse, at(3.0))
    assert (change.row.priority, change.row.suppressed) == ("high", None)
    out = take_out_of_service(raised(), "ann", "sensor is being repaired", at(2.0)).row
    change = update_alarm(out, worse, at(3.0))
    assert (change.row.priority, change.row.suppressed) == ("high", "out_of_service")


def test_out_of_service_is_ended_only_by_a_person():
    out = take_out_of_service(shelved(), "ben", "sensor is being repaired", at(3.0)).row
    assert (out.suppressed, out.shelved_until_utc_ns) == ("out_of_service", None)
    assert remove_expired_shelf(out, utc_ns=10**19, wall_utc_ns=10**19) is out
    back = end_suppression(out, "out_of_service", "cai", "new cable", at(4.0))
    assert (back.event_kind, back.row.suppressed) == ("alarm_in_service", None)
    assert (back.row.suppressed_by, back.row.suppressed_reason) == ("cai", "new cable")


def test_an_invalid_suppression_is_rejected_with_its_reason():
    out = take_out_of_service(raised(), "ben", "repair", at(3.0)).row
    with pytest.raises(ValueError, match="return it to service first"):
        shelve(out, "ann", "known", 1.0, at(4.0), WALL_NS)
    with pytest.raises(ValueError, match="out of service already: repair"):
        take_out_of_service(out, "ann", "again", at(4.0))
    with pytest.raises(ValueError, match="has ended: there is nothing to shelve"):
        shelve(replace(raised(), state="normal"), "ann", "known", 1.0, at(4.0), WALL_NS)
    with pytest.raises(ValueError, match="is not shelved"):
        end_suppression(raised(), "shelved", "ann", "", at(4.0))


@pytest.mark.parametrize(("priority", "within_h"), [("critical", 0.25), ("high", 8.0), ("medium", 24.0)])
def test_an_unacknowledged_alarm_is_reported_again_after_each_time_to_respond(priority, within_h):
    row = replace(raised(), priority=priority)
    assert report_overdue_response(row, at(0.99 + within_h)) is None
    change = report_overdue_response(row, at(1.0 + within_h))
    assert (change.event_kind, change.row.state) == ("alarm_response_overdue", "unacknowledged")
    assert report_overdue_response(change.row, at(1.0 + 1.9 * within_h)) is None
    assert report_overdue_response(change.row, at(1.0 + 2.0 * within_h)) is not None
    seen = acknowledge_alarm(row, "ann", "", at(2.0)).row
    for silent in (seen, replace(row, suppressed="shelved"), replace(row, state="returned_unacknowledged")):
        assert report_overdue_response(silent, at(1.0 + 9.0 * within_h)) is None
