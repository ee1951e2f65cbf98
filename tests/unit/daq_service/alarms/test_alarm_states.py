from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.invented_rows import condition

from daq_service.alarms.operator_actions import acknowledge_alarm, reset_alarm
from daq_service.alarms.states import Moment, find_alarm, find_disabled, index_alarm, update_alarm
from daq_service.catalogue.rows import AlarmRow


def moment(set_index=0):
    return Moment(utc_ns=1_000 + set_index, due_h=0.5 * set_index, set_index=set_index)


def changed(row, present, at=0, **values):
    """Return the change that a condition makes, which must be one."""
    change = update_alarm(row, condition(present, **values), moment(at))
    assert change is not None
    return change


def raised(**values):
    return replace(changed(None, True, **values).row, id=7)


def test_a_condition_raises_an_unacknowledged_alarm():
    change = changed(None, True, 3, evidence={"limit": 24.3})
    assert change.event_kind == "alarm_raised"
    assert change.row.state == "unacknowledged"
    assert (change.row.raised_h, change.row.raised_set_index) == (1.5, 3)
    assert change.row.evidence == {"limit": 24.3}


def test_an_active_condition_causes_one_event():
    assert update_alarm(raised(), condition(True), moment(1)) is None


def test_a_cleared_alarm_waits_for_its_acknowledgement():
    change = changed(raised(), False, 4)
    assert change.row.state == "returned_unacknowledged"
    assert change.row.cleared_utc_ns == moment(4).utc_ns
    seen = acknowledge_alarm(change.row, "ann", "looked at it", moment(5))
    assert (seen.row.state, seen.row.acknowledged_by, seen.row.note) == ("normal", "ann", "looked at it")


WALL = {"diagnosis": "wall", "diagnosis_probability": 0.99}


def test_one_fault_stays_one_alarm_when_its_diagnosis_changes():
    wall = replace(raised(), id=7)
    transducer = {"kind": "transducer_change", "alarm_class": "diagnostic", "priority": "medium"}
    sensor = {"evidence": {"diagnosis": "sensor", "diagnosis_probability": 0.951}}
    alarms = {("B", "wall_change"): replace(wall, state="acknowledged")}
    found = find_alarm(alarms, condition(**transducer))
    change = update_alarm(found, condition(**transducer, **sensor), moment(5))
    row = change.row
    assert (row.id, row.kind, row.alarm_class, row.state) == (
        7,
        *list(transducer.values())[:2],
        "acknowledged",
    )
    assert row.priority == "high", "the highest until it is acknowledged"
    assert row.message.startswith("B: signal change, probable transducer fault (model: 95 %)")
    index_alarm(alarms, row)
    assert list(alarms.values()) == [row]
    # Back to the wall it needs an operator again, also out of service.
    out = replace(row, suppressed="out_of_service")
    index_alarm(alarms, out)
    assert find_alarm(alarms, condition()) is out
    change = update_alarm(out, condition(), moment(6))
    assert (change.event_kind, change.row.id, change.row.kind) == ("alarm_priority_raised", 7, "wall_change")
    assert (change.row.state, change.row.suppressed) == ("unacknowledged", None)
    # After a return to normal, another kind is another alarm.
    over = {("B", "wall_change"): replace(wall, state="normal")}
    assert find_alarm(over, condition(**transducer)) is None


def test_a_verified_trip_corrects_its_message_once():
    trip = {
        "position": None,
        "kind": "interlock_tripped",
        "alarm_class": "diagnostic",
        "priority": "critical",
    }
    row = raised(**trip, evidence={"trip_reason": "hole at B", "unverified": True})
    assert row.message.startswith("Supply trip sent, output may still be ON. Hole at B (hour ")
    verified = condition(**trip, evidence={"trip_reason": "hole at B", "unverified": None})
    change = update_alarm(row, verified, moment(2))
    assert change.row.message.startswith("Supply tripped by interlock, output off. Hole at B (hour ")
    assert change.row.state == row.state
    assert update_alarm(change.row, verified, moment(3)) is None


def test_a_reactivated_alarm_needs_a_new_acknowledgement_and_has_the_present_message():
    cleared = changed(raised(evidence={"limit": 24.3}, priority="medium"), False, 4)
    again = changed(cleared.row, True, 5, known="wall", evidence={"limit": 25.0} | WALL)
    assert (again.row.state, again.event_kind) == ("unacknowledged", "alarm_reactivated")
    assert again.row.message.startswith("B: signal change, probable wall thinning (model: 99 %) (hour ")
    assert again.row.priority == "high"
    assert again.row.evidence == {"limit": 25.0, "known": "wall"} | WALL


@pytest.mark.parametrize("state", ["unacknowledged", "acknowledged"])
def test_an_active_alarm_reports_its_diagnosis_once(state):
    row = replace(raised(evidence={"diagnosis": "undetermined"}), state=state, suppressed="shelved")
    named = condition(True, known="wall", evidence=WALL)
    change = update_alarm(row, named, moment(9))
    assert (change.event_kind, change.row.state) == ("alarm_priority_raised", "unacknowledged")
    assert "probable wall thinning (model: 99 %)" in change.row.message
    assert change.row.evidence["diagnosis"] == "wall"
    assert change.row.suppressed is None, "it was shelved for what was known then"
    # No second event, also if the diagnosis is undetermined for a while.
    for later in (named, condition(True), named):
        assert update_alarm(change.row, later, moment(10)) is None
    assert update_alarm(raised(known="wall"), named, moment(10)) is None, "it was known when it was raised"


def test_a_hole_alarm_is_latched():
    assert (
        update_alarm(
            raised(kind="no_reflection"), condition(False, kind="no_reflection", latched=True), moment(1)
        )
        is None
    )


def test_a_priority_only_rises_and_needs_a_new_acknowledgement():
    seen = acknowledge_alarm(raised(), "ann", "", moment(1)).row
    assert update_alarm(seen, condition(True, priority="low"), moment(2)) is None
    worse = changed(seen, True, 2, priority="critical")
    assert (worse.row.priority, worse.row.state) == ("critical", "unacknowledged")


def test_a_second_acknowledgement_is_rejected():
    seen = acknowledge_alarm(raised(), "ann", "", moment(1)).row
    with pytest.raises(ValueError, match="nothing to acknowledge"):
        acknowledge_alarm(seen, "ann", "", moment(2))


def test_a_reset_ends_a_latched_alarm_and_stores_its_author():
    change = reset_alarm(raised(kind="no_reflection"), "ann", "contact put right", moment(6))
    assert change.event_kind == "alarm_reset"
    row = change.row
    assert (row.id, row.state, row.cleared_utc_ns) == (7, "normal", moment(6).utc_ns)
    assert (row.acknowledged_by, row.acknowledged_utc_ns) == ("ann", moment(6).utc_ns)
    assert row.note == "contact put right"
    again = changed(row, True, 7, kind="no_reflection", latched=True)
    assert (again.event_kind, again.row.id) == ("alarm_raised", None), "a new appearance is a new row"


def test_a_reset_keeps_the_acknowledging_author_and_an_old_note():
    seen = acknowledge_alarm(raised(kind="no_reflection"), "bob", "looked at it", moment(2)).row
    row = reset_alarm(seen, "ann", "", moment(6)).row
    assert (row.acknowledged_by, row.acknowledged_utc_ns) == ("bob", moment(2).utc_ns)
    assert row.note == "looked at it"
    assert reset_alarm(seen, "ann", "new coil", moment(6)).row.note == "new coil"


def test_an_alarm_that_has_ended_cannot_be_reset():
    ended = reset_alarm(raised(kind="no_reflection"), "ann", "", moment(1)).row
    with pytest.raises(ValueError, match="nothing to reset"):
        reset_alarm(ended, "ann", "", moment(2))


@given(st.lists(st.booleans(), min_size=1, max_size=30))
def test_an_alarm_is_active_while_its_condition_is_present_or_unacknowledged(history):
    row: AlarmRow | None = None
    for index, present in enumerate(history):
        change = update_alarm(row, condition(present), moment(index))
        row = row if change is None else replace(change.row, id=index)
    appeared = any(history)
    assert (row is not None and row.state != "normal") == appeared
    if row is not None:
        assert (row.state == "unacknowledged") == history[-1]


def active_alarm(position, kind, state="unacknowledged"):
    row = raised(position=position, kind=kind)
    return replace(row, message=f"{kind} at {position}", state=state)


HOLE, DISABLED = "no_reflection", "transducer_disabled"


@pytest.mark.parametrize(
    ("alarms", "disabled"),
    [
        ([("B", HOLE, "unacknowledged"), ("C", DISABLED, "acknowledged")], {"B": HOLE, "C": DISABLED}),
        ([("B", HOLE, "acknowledged"), ("C", DISABLED, "unacknowledged")], {"B": HOLE, "C": DISABLED}),
        ([("B", HOLE, "returned_unacknowledged")], {"B": HOLE}),
        ([("B", DISABLED, "returned_unacknowledged")], {"B": DISABLED}),
        ([("B", HOLE, "normal"), ("C", DISABLED, "normal")], {}),
        ([("B", HOLE, "normal"), ("B", DISABLED, "unacknowledged")], {"B": DISABLED}),
        ([("B", "wall_change"), ("C", "few_valid_shots"), (None, "instruments_unavailable")], {}),
    ],
    ids=["active", "active, too", "hole returned", "disabled returned", "reset", "one of two", "others"],
)
def test_an_active_hole_or_disable_alarm_disables_a_transducer(alarms, disabled):
    expected = {position: f"{kind} at {position}" for position, kind in disabled.items()}
    assert find_disabled([active_alarm(*alarm) for alarm in alarms]) == expected
