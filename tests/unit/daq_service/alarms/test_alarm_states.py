from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from daq_service.alarms.operator_actions import acknowledge, reset
from daq_service.alarms.states import Condition, Moment, disabled_positions, update
from daq_service.catalogue.rows import AlarmRow, AlarmState


def condition(present: bool, **values: Any) -> Condition:
    defaults = {
        "position": "B",
        "kind": "wall_change",
        "alarm_class": "damage",
        "priority": "high",
        "message": "3 of 5",
    }
    return Condition(present=present, **{**defaults, **values})


def moment(set_index: int = 0) -> Moment:
    return Moment(utc_ns=1_000 + set_index, due_h=0.5 * set_index, set_index=set_index)


def raised(**values: Any) -> AlarmRow:
    change = update(None, condition(True, **values), moment())
    assert change is not None
    return replace(change.row, id=7)


def test_a_condition_raises_an_unacknowledged_alarm() -> None:
    change = update(None, condition(True, evidence={"limit": 24.3}), moment(3))
    assert change is not None
    assert change.event_kind == "alarm_raised"
    assert change.row.state == "unacknowledged"
    assert (change.row.raised_h, change.row.raised_set_index) == (1.5, 3)
    assert change.row.evidence == {"limit": 24.3}


def test_no_condition_and_no_alarm_is_no_change() -> None:
    assert update(None, condition(False), moment()) is None


def test_an_active_condition_causes_one_event() -> None:
    assert update(raised(), condition(True), moment(1)) is None


def test_a_cleared_alarm_waits_for_its_acknowledgement() -> None:
    change = update(raised(), condition(False), moment(4))
    assert change is not None
    assert change.row.state == "returned_unacknowledged"
    assert change.row.cleared_utc_ns == moment(4).utc_ns
    seen = acknowledge(change.row, "ann", "looked at it", moment(5))
    assert (seen.row.state, seen.row.acknowledged_by, seen.row.note) == (
        "normal",
        "ann",
        "looked at it",
    )


def test_an_acknowledged_alarm_ends_with_its_condition() -> None:
    seen = acknowledge(raised(), "ann", "", moment(1)).row
    assert seen.state == "acknowledged"
    change = update(seen, condition(False), moment(2))
    assert change is not None
    assert change.row.state == "normal"


def test_a_condition_that_is_active_again_needs_a_new_acknowledgement() -> None:
    cleared = update(raised(), condition(False), moment(1))
    assert cleared is not None
    again = update(cleared.row, condition(True), moment(2))
    assert again is not None
    assert (again.row.state, again.event_kind) == ("unacknowledged", "alarm_reactivated")


def test_a_reactivated_alarm_has_the_present_message() -> None:
    cleared = update(raised(evidence={"limit": 24.3}, priority="medium"), condition(False), moment(4))
    assert cleared is not None
    back = condition(True, message="WALL (99 %)", known="wall", evidence={"limit": 25.0})
    again = update(cleared.row, back, moment(5))
    assert again is not None
    assert (again.row.message, again.row.priority) == ("WALL (99 %)", "high")
    assert again.row.evidence == {"limit": 25.0, "known": "wall"}


@pytest.mark.parametrize("state", ["unacknowledged", "acknowledged"])
def test_an_active_alarm_reports_its_diagnosis_once(state: AlarmState) -> None:
    row = replace(raised(evidence={"diagnosis": "undetermined"}), state=state, suppressed="shelved")
    named = condition(True, message="WALL (99 %)", known="wall", evidence={"diagnosis": "wall"})
    change = update(row, named, moment(9))
    assert change is not None
    assert (change.event_kind, change.row.state) == ("alarm_priority_raised", "unacknowledged")
    assert (change.row.message, change.row.evidence["diagnosis"]) == ("WALL (99 %)", "wall")
    assert change.row.suppressed is None, "it was shelved for what was known then"
    # No second event, also if the diagnosis is undetermined for a while.
    for later in (named, condition(True), named):
        assert update(change.row, later, moment(10)) is None
    assert update(raised(known="wall"), named, moment(10)) is None, "it was known when it was raised"


def test_a_closed_alarm_stays_in_the_history() -> None:
    closed = replace(raised(), state="normal")
    change = update(closed, condition(True), moment(9))
    assert change is not None
    assert change.row.id is None, "a new appearance is a new row"


def test_a_hole_alarm_is_latched() -> None:
    assert (
        update(raised(kind="no_reflection"), condition(False, kind="no_reflection", latched=True), moment(1))
        is None
    )


def test_a_priority_only_rises_and_needs_a_new_acknowledgement() -> None:
    seen = acknowledge(raised(), "ann", "", moment(1)).row
    assert update(seen, condition(True, priority="low"), moment(2)) is None
    worse = update(seen, condition(True, priority="critical"), moment(2))
    assert worse is not None
    assert (worse.row.priority, worse.row.state) == ("critical", "unacknowledged")


def test_a_second_acknowledgement_is_rejected() -> None:
    seen = acknowledge(raised(), "ann", "", moment(1)).row
    with pytest.raises(ValueError, match="nothing to acknowledge"):
        acknowledge(seen, "ann", "", moment(2))


def test_a_reset_ends_a_latched_alarm_and_stores_its_author() -> None:
    change = reset(raised(kind="no_reflection"), "ann", "contact put right", moment(6))
    assert change.event_kind == "alarm_reset"
    row = change.row
    assert (row.id, row.state, row.cleared_utc_ns) == (7, "normal", moment(6).utc_ns)
    assert (row.acknowledged_by, row.acknowledged_utc_ns) == ("ann", moment(6).utc_ns)
    assert row.note == "contact put right"
    again = update(row, condition(True, kind="no_reflection", latched=True), moment(7))
    assert again is not None
    assert (again.event_kind, again.row.id) == ("alarm_raised", None)


def test_a_reset_keeps_the_acknowledging_author_and_an_old_note() -> None:
    seen = acknowledge(raised(kind="no_reflection"), "bob", "looked at it", moment(2)).row
    row = reset(seen, "ann", "", moment(6)).row
    assert (row.acknowledged_by, row.acknowledged_utc_ns) == ("bob", moment(2).utc_ns)
    assert row.note == "looked at it"
    assert reset(seen, "ann", "new coil", moment(6)).row.note == "new coil"


def test_an_alarm_that_has_ended_cannot_be_reset() -> None:
    ended = reset(raised(kind="no_reflection"), "ann", "", moment(1)).row
    with pytest.raises(ValueError, match="nothing to reset"):
        reset(ended, "ann", "", moment(2))


@given(st.lists(st.booleans(), min_size=1, max_size=30))
def test_an_alarm_is_active_while_its_condition_is_present_or_unacknowledged(
    history: list[bool],
) -> None:
    row: AlarmRow | None = None
    for index, present in enumerate(history):
        change = update(row, condition(present), moment(index))
        row = row if change is None else replace(change.row, id=index)
    appeared = any(history)
    assert (row is not None and row.state != "normal") == appeared
    if row is not None:
        assert (row.state == "unacknowledged") == history[-1]


def active_alarm(position: str | None, kind: str, state: AlarmState = "unacknowledged") -> AlarmRow:
    return replace(raised(position=position, kind=kind, message=f"{kind} at {position}"), state=state)


@pytest.mark.parametrize("kind", ["no_reflection", "transducer_disabled"])
@pytest.mark.parametrize("state", ["unacknowledged", "acknowledged", "returned_unacknowledged"])
def test_an_active_hole_or_disable_alarm_disables_a_transducer(kind: str, state: str) -> None:
    assert disabled_positions([active_alarm("B", kind, state)]) == {"B": f"{kind} at B"}


def test_a_reset_alarm_enables_the_transducer() -> None:
    assert (
        disabled_positions(
            [active_alarm("B", "no_reflection", "normal"), active_alarm("C", "transducer_disabled", "normal")]
        )
        == {}
    )


def test_one_of_two_active_alarms_is_enough() -> None:
    rows = (active_alarm("B", "no_reflection", "normal"), active_alarm("B", "transducer_disabled"))
    assert disabled_positions(rows) == {"B": "transducer_disabled at B"}


def test_other_alarms_and_service_alarms_disable_no_transducer() -> None:
    rows = (
        active_alarm("B", "wall_change"),
        active_alarm("C", "few_valid_shots"),
        active_alarm(None, "instruments_unavailable"),
    )
    assert disabled_positions(rows) == {}
