"""Which strikes are repeated, and which attempt counts."""

import pytest

from analysis.errors import InvalidInputError
from analysis.waves.quality_gate import (
    ACCEPTED,
    FLAGS,
    RESTRIKE_FLAGS,
    SUPERSEDED,
    Attempt,
    RestrikeRule,
    decide_outcomes,
)


@pytest.mark.parametrize("flag", FLAGS)
def test_a_flag_of_the_rule_asks_for_a_restrike_and_no_other_does(flag):
    wants = RestrikeRule().wants((flag,), attempt=0, restrikes_so_far=0)
    # None of these left a wave: they follow what is set for missed strikes.
    assert wants == (flag in (*RESTRIKE_FLAGS, "false_trigger", "lost_samples", "disturbed"))


def test_a_false_trigger_is_repeated_where_a_missed_strike_is():
    rule = RestrikeRule(flags=("double",))
    assert not rule.wants(("false_trigger",), attempt=0, restrikes_so_far=0)


def test_a_clean_shot_is_not_repeated():
    assert not RestrikeRule().wants((), attempt=0, restrikes_so_far=0)


def test_a_restrike_is_not_repeated_again():
    assert not RestrikeRule().wants(("missed",), attempt=1, restrikes_so_far=1)


def test_the_budget_of_a_set_is_kept():
    rule = RestrikeRule(restrikes_per_set=2)
    assert [rule.wants(("double",), attempt=0, restrikes_so_far=n) for n in range(4)] == [
        True,
        True,
        False,
        False,
    ]
    assert not RestrikeRule(restrikes_per_set=0).wants(("missed",), attempt=0, restrikes_so_far=0)


def test_unknown_flags_and_negative_budgets_are_refused():
    with pytest.raises(InvalidInputError, match="wobbly"):
        RestrikeRule(flags=("missed", "wobbly"))
    with pytest.raises(InvalidInputError, match="-1"):
        RestrikeRule(restrikes_per_set=-1)


def attempt(shot_index, number, quality):
    return Attempt(shot=shot_index, attempt=number, quality=quality)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ("bad", "good", [SUPERSEDED, ACCEPTED]),
        ("bad", "bad", [SUPERSEDED, ACCEPTED]),
        ("suspect", "good", [SUPERSEDED, ACCEPTED]),
        ("suspect", "bad", [ACCEPTED, SUPERSEDED]),  # noisy, then clipped: the first is the better one
        ("good", "good", [SUPERSEDED, ACCEPTED]),
    ],
)
def test_the_better_attempt_counts_and_of_equals_the_last(first, second, expected):
    assert decide_outcomes([attempt(3, 0, first), attempt(3, 1, second)]) == expected


def test_every_shot_has_exactly_one_accepted_record():
    records = [attempt(0, 0, "good"), attempt(1, 0, "bad"), attempt(1, 1, "good"), attempt(2, 1, "suspect")]
    assert decide_outcomes(records) == [ACCEPTED, SUPERSEDED, ACCEPTED, ACCEPTED]
    assert decide_outcomes([]) == []


def test_an_unknown_quality_is_refused():
    with pytest.raises(InvalidInputError, match="splendid"):
        decide_outcomes([attempt(0, 0, "splendid")])
