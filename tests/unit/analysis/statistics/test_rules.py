"""Alarm rule and hole rule."""

import itertools
import math

import pytest

from analysis.errors import InvalidInputError
from analysis.statistics.rules import (
    AlarmRule,
    AlarmState,
    HoleRule,
    HoleState,
    count_poor_sets,
    update_alarm_state,
    update_hole_state,
)

O, X = False, True  # noqa: E741 an inlier and an outlier, to be read as a string of marks


def after_each(step, start, sets, rule):
    return list(itertools.accumulate(sets, lambda state, one: step(state, one, rule), initial=start))[1:]


def alarm_states(outliers, rule=AlarmRule(), start=AlarmState()):  # noqa: B008 frozen
    return after_each(update_alarm_state, start, outliers, rule)


def active(outliers, rule=AlarmRule()):  # noqa: B008 frozen
    return [state.active for state in alarm_states(outliers, rule)]


def test_three_of_five_raise_at_once():
    assert active([X, O, X, O, X]) == [O, O, O, O, X]
    assert active([X, X, X]) == [O, O, X]


def test_three_of_six_do_not_raise():
    assert not any(active([X, O, O, X, O, X]))


def test_alarm_stays_until_five_assessed_sets_are_quiet():
    assert active([X, X, X, O, O, O, O, O]) == [O, O, X, X, X, X, X, O]
    assert active([X, X, X, O, O, O, O, X, O, O, O, O, O])[-1] is False


def test_unassessed_sets_neither_raise_nor_clear_an_alarm_nor_count():
    assert active([X, None, None, X, None, O, None, O, X]) == [O, O, O, O, O, O, O, O, X]
    assert active([X, X, X, *[None] * 20]) == [O, O] + [X] * 21
    assert active([X, X, X, O, None, O, None, O, O, None, O])[-2:] == [X, O]


def test_alarm_may_clear_before_all_is_quiet():
    rule = AlarmRule(k=3, n=5, off_at_most=1)
    assert active([X, X, X, O, O, O, O], rule) == [O, O, X, X, X, X, O]


def test_restart_from_the_stored_state_gives_the_same_answers():
    sequence = [X, O, None, X, X, O, O, None, O, O, O, X, X, X]
    whole = alarm_states(sequence)
    for cut in range(1, len(sequence)):
        assert alarm_states(sequence[cut:], start=whole[cut - 1]) == whole[cut:]


def test_rate_of_the_rule_is_that_of_the_binomial():
    # The window of five independent sets holds three or more outliers: enumerate all 32 windows.
    rate = 0.3
    raised = sum(
        math.prod(rate if x else 1 - rate for x in window)
        for window in itertools.product([O, X], repeat=5)
        if any(active(window))
    )
    expected = sum(math.comb(5, k) * rate**k * (1 - rate) ** (5 - k) for k in (3, 4, 5))
    assert raised == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("values", [{"k": 0}, {"k": 6}, {"off_at_most": 3}, {"off_at_most": -1}])
def test_impossible_rules_are_refused(values):
    with pytest.raises(InvalidInputError, match="must lie in"):
        AlarmRule(**values)


def test_state_keeps_no_more_than_the_window():
    state = AlarmState()
    for _ in range(20):
        state = update_alarm_state(state, False)
    assert state == AlarmState(recent=(False,) * 5, active=False)


SILENT, HEARD = ("no_psw",), ()
HOLE_SET = [SILENT] * 7 + [HEARD] * 3
WALL_SET = [SILENT] * 6 + [HEARD] * 4


def holes(sets, rule=HoleRule()):  # noqa: B008 frozen
    return [state.hole for state in after_each(update_hole_state, HoleState(), sets, rule)]


def test_two_consecutive_silent_sets_are_a_hole():
    assert holes([HOLE_SET, HOLE_SET]) == [False, True]
    assert holes([HOLE_SET, WALL_SET, HOLE_SET]) == [False, False, False]


def test_six_silent_shots_of_ten_are_not():
    assert not any(holes([WALL_SET] * 5))


def test_gap_neither_counts_nor_interrupts():
    assert holes([HOLE_SET, [], HOLE_SET]) == [False, False, True]


def test_hole_does_not_heal():
    assert holes([HOLE_SET, HOLE_SET, WALL_SET, WALL_SET])[-1] is True


def test_a_flag_counts_together_with_other_flags():
    both = [("double", "no_psw")] * 7 + [HEARD] * 3
    assert update_hole_state(HoleState(sets_running=1), both).hole


def test_impossible_hole_rule_is_refused():
    with pytest.raises(InvalidInputError, match="at least 1"):
        HoleRule(shots=0)
    with pytest.raises(InvalidInputError, match="at least 1"):
        HoleRule(consecutive_sets=0)


def poor_sets(*sets):
    """Return the count after each set of (valid, attempted) shots of ten; seven must be valid."""
    running, counts = 0, []
    for n_valid, n_tried in sets:
        running = count_poor_sets(running, n_valid=n_valid, n_tried=n_tried, n_planned=10, minimum_valid=7)
        counts.append(running)
    return counts


def test_sets_with_too_few_valid_shots_are_counted_while_they_run():
    assert poor_sets((0, 10), (6, 10), (7, 10), (0, 10)) == [1, 2, 0, 1]


def test_a_set_without_attempts_neither_counts_nor_interrupts():
    assert poor_sets((0, 10), (0, 0), (0, 10)) == [1, 1, 2]


def test_a_set_that_was_cut_short_counts_only_for_the_transducer():
    assert poor_sets((0, 10), (3, 4), (0, 9), (6, 6)) == [1, 1, 1, 1]
    assert poor_sets((0, 10), (7, 7)) == [1, 0]
