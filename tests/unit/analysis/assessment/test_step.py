"""The pure assessment step with plain numbers: baseline, limits, outliers, holes and poor sets."""

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest

from analysis.assessment.baseline_quality import ALIKE, assess_baseline
from analysis.assessment.step import Rules, SetOfShots, State, assess_next_set, clear_faults
from analysis.statistics.limits import f_predictive_limit, paper_limit
from analysis.statistics.named_limits import LIMITS, NamedLimit
from analysis.statistics.rules import AlarmRule, HoleRule
from analysis.waves.features import FEATURE_NAMES

LAST = 19
RULES = Rules(
    baseline_name="B-baseline-1",
    first_baseline_set=0,
    last_baseline_set=LAST,
    minimum_sets=15,
    minimum_valid_shots=3,
    shots_per_set=4,
    limit="f_predictive",
    false_alarm_rate=0.0027,
    run_length=1000.0,
    false_alarms_per_sensor_year=0.2,
    decides_by="chart",
    alarm=AlarmRule(k=3, n=5),
    hole=HoleRule(shots=3, consecutive_sets=2),
)
HEALTHY = 1.0 + 0.01 * np.random.default_rng(7).standard_normal((40, 5))
SILENT = [("no_psw",)] * 3 + [()]


def set_summary(index, *, shift=0.0, quality="good", n_valid=4, n_taken=4, n_tried=4, flags=((),) * 4):
    vector = HEALTHY[index % 40] + shift
    return SetOfShots(
        set_index=index,
        due_h=0.5 * index,
        n_taken=n_taken,
        n_tried=n_tried,
        n_valid=n_valid,
        quality=quality,
        reason="too few" if quality == "bad" else "",
        values=dict(zip(FEATURE_NAMES, vector.tolist(), strict=True)),
        flags=flags,
    )


def states(sets, rules=RULES, state=None):
    """Assess sets one after the other; return every state and assessment."""
    found = []
    state = state or State()
    for item in sets:
        state, assessment = assess_next_set(state, item, rules)
        found.append((state, assessment))
    return found


def state_after(sets, rules=RULES):
    return states(sets, rules)[-1]


def baseline():
    return [set_summary(index) for index in range(LAST + 1)]


def test_sets_are_not_assessed_until_the_baseline_is_complete():
    for state, assessment in states(baseline()[:-1]):
        assert state.baseline is None
        assert assessment.in_baseline
        assert assessment.outlier is None
        assert assessment.reason == "the baseline is being recorded"


def test_the_last_set_completes_the_baseline_with_every_limit():
    state, assessment = state_after(baseline())
    assert assessment.in_baseline
    fitted = state.baseline.fitted
    assert fitted.set_indices == tuple(range(LAST + 1))
    np.testing.assert_array_equal(fitted.mean, HEALTHY[: LAST + 1].mean(axis=0))
    limits = state.baseline.limits
    assert limits["f_predictive"] == f_predictive_limit(LAST + 1, 5, 0.0027)
    assert limits["paper_mean_3sd"] == paper_limit(fitted.distances_squared)
    assert limits.keys() == LIMITS.keys()


def test_the_baseline_closes_at_the_first_later_set_where_its_last_one_was_missed():
    state, assessment = state_after([*baseline()[:-1], set_summary(LAST + 1)])
    assert state.baseline.fitted.n == LAST
    assert not assessment.in_baseline
    assert assessment.distance_squared is not None


def test_poor_sets_are_left_out_of_the_baseline_and_counted():
    sets = baseline()
    sets[3] = replace(sets[3], quality="bad")
    sets[LAST] = replace(sets[LAST], values={**sets[LAST].values, FEATURE_NAMES[0]: None})
    state, assessment = state_after(sets)
    assert state.n_left_out == 2
    assert state.baseline.fitted.n == LAST - 1
    assert assessment.reason == "left out of the baseline: too few valid shots"


def test_too_few_healthy_sets_give_no_limit_but_a_reason():
    state, assessment = state_after([*baseline(), set_summary(LAST + 1)], replace(RULES, minimum_sets=21))
    assert state.baseline.fitted is None
    assert "; it needs 21 (baseline.minimum_sets)" in state.baseline.reason
    assert (assessment.outlier, assessment.distance_squared) == (None, None)
    assert assessment.reason == state.baseline.reason


def test_an_outlier_exceeds_the_deciding_limit():
    sets = [*baseline(), set_summary(LAST + 1, shift=0.012)]
    assessment = state_after(sets)[1]
    baseline_state = state_after(baseline())[0].baseline
    for limit, outlier in (
        ("f_predictive", assessment.distance_squared > baseline_state.limits["f_predictive"]),
        ("paper_mean_3sd", assessment.distance_squared > baseline_state.limits["paper_mean_3sd"]),
    ):
        assert state_after(sets, replace(RULES, limit=limit))[1].outlier == outlier
    limits = baseline_state.limits
    assert limits["paper_mean_3sd"] < assessment.distance_squared < limits["f_predictive"]
    assert sum(assessment.contributions.values()) == pytest.approx(assessment.distance_squared, rel=1e-12)


def test_an_unassessed_set_neither_raises_nor_clears_the_alarm():
    sets = [*baseline(), *(set_summary(LAST + 1 + k, shift=1.0) for k in range(2))]
    assert not state_after(sets)[0].alarm.active
    bad = set_summary(LAST + 3, shift=1.0, quality="bad")
    state, assessment = state_after([*sets, bad])
    assert (assessment.outlier, assessment.reason) == (None, "too few")
    assert not state.alarm.active
    assert state_after([*sets, bad, set_summary(LAST + 4, shift=1.0)])[0].alarm.active


def test_consecutive_silent_sets_are_a_hole_also_across_a_gap():
    silent = [set_summary(k, flags=SILENT) for k in (0, 2)]
    gap = set_summary(1, n_taken=0, n_tried=0, n_valid=0, flags=())
    assert not state_after(silent[:1])[0].hole.hole
    assert state_after([silent[0], gap, silent[1]])[0].hole.hole


def test_a_set_without_a_record_has_no_assessment_but_counts_as_poor():
    state, assessment = state_after([set_summary(0, n_taken=0, n_valid=0, flags=())])
    assert assessment is None
    assert state == State(poor_sets=1)


@pytest.mark.parametrize(
    ("n_valid", "n_tried", "poor"), [(2, 4, 2), (2, 3, 1), (3, 4, 0), (3, 3, 0)], ids=str
)
def test_consecutive_poor_sets_are_counted_and_an_incomplete_set_is_ignored(n_valid, n_tried, poor):
    state = State(poor_sets=1)
    assert states([set_summary(5, n_valid=n_valid, n_tried=n_tried)], state=state)[-1][0].poor_sets == poor


def test_a_command_resets_only_the_reason_of_the_disabled_transducer():
    state = state_after(
        [*baseline(), *(set_summary(LAST + 1 + k, shift=1.0, flags=SILENT, n_valid=1) for k in range(3))]
    )[0]
    assert state.hole.hole
    assert state.poor_sets == 3
    again = clear_faults(state)
    assert (again.hole.hole, again.hole.sets_running, again.poor_sets) == (False, 0, 0)
    assert (again.baseline, again.alarm) == (state.baseline, state.alarm)


def test_a_restart_with_the_same_sets_has_the_same_state():
    sets = [*baseline(), *(set_summary(LAST + 1 + k, shift=0.03 * k) for k in range(8))]
    live = states(sets)
    for cut in (0, 5, LAST, LAST + 1, len(sets) - 1):
        fed = reduce(lambda state, one: assess_next_set(state, one, RULES)[0], sets[:cut], State())
        for (expected, assessment), (found, again) in zip(
            live[cut:], states(sets[cut:], state=fed), strict=True
        ):
            assert again == assessment
            assert (found.alarm, found.hole, found.poor_sets, found.memory) == (
                expected.alarm,
                expected.hole,
                expected.poor_sets,
                expected.memory,
            )


def test_a_set_without_a_vector_does_not_change_the_chart():
    assessed_sets = [*baseline(), set_summary(LAST + 1, shift=0.03)]
    state, assessment = state_after(assessed_sets)
    assert state.memory == assessment.memory != state_after(baseline())[0].memory
    for poor in (set_summary(LAST + 2, quality="bad"), set_summary(LAST + 2, n_taken=0, n_valid=0, flags=())):
        assert state_after([*assessed_sets, poor])[0].memory == state.memory


def test_the_chart_raises_an_alarm_during_a_persistent_change():
    changed = [set_summary(LAST + 1 + k, shift=0.1) for k in range(15)]
    alarming = [state.memory.alarming for state, _ in states([*baseline(), *changed])[LAST + 1 :]]
    first = alarming.index(True)
    assert 2 < first < 14  # one set alone is cut back
    assert all(alarming[first:])
    over = [set_summary(LAST + 16 + k) for k in range(25)]
    assert not state_after([*baseline(), *changed, *over])[0].memory.alarming


def test_a_baseline_of_a_version_without_chart_keeps_its_two_limits():
    state, assessment = state_after(
        [*baseline(), set_summary(LAST + 1)], replace(RULES, run_length=None, limit="default")
    )
    assert state.baseline.limits.keys() == {"f_predictive", "paper_mean_3sd"}
    assert (state.memory, state.baseline.design, assessment.outlier) == (None, None, False)


def test_a_limit_is_added_by_its_entry_alone(monkeypatch):
    twice = NamedLimit(
        words="Twice the F limit", of="distance_squared", value=lambda facts: 2 * facts.by_default.limit
    )
    monkeypatch.setattr("analysis.statistics.named_limits.LIMITS", {**LIMITS, "twice": twice})
    monkeypatch.setattr("analysis.assessment.step.LIMITS", {**LIMITS, "twice": twice})
    sets = [*baseline(), set_summary(LAST + 1, shift=0.02)]
    state, assessment = state_after(sets, replace(RULES, limit="twice"))
    assert state.baseline.limits["twice"] == 2 * state.baseline.limits["default"]
    assert assessment.outlier is False
    assert state_after(sets)[1].outlier is True


def test_a_feature_that_is_the_same_in_most_of_a_baseline_stops_no_recorder():
    """Records that are played back repeatedly have such features."""
    name = FEATURE_NAMES[0]
    stuck = [
        replace(item, values=item.values | {name: 1.0 if item.set_index % 4 else item.values[name]})
        for item in baseline()
    ]
    state, _ = state_after(stuck)
    quality = assess_baseline(state, RULES)
    assert (quality["named"], quality["n"]) == ([], LAST + 1)
    assert quality["advice"].endswith(f"; {ALIKE}")
    state, assessment = assess_next_set(state, set_summary(LAST + 1, shift=1.0), RULES)
    assert assessment.outlier
