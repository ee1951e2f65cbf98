"""A cause is named by its direction and its course in time, and not where nothing is sure."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from analysis.diagnosis.diagnose import (
    LOST_LIKELY,
    STATED,
    UNDETERMINED,
    WALL_LIKELY,
    WALL_STATED,
    add_diagnosis,
    diagnose_latest_set,
)
from analysis.diagnosis.hypotheses import COUPLING, OK, SENSOR, WALL
from analysis.diagnosis.parameters import DiagnosisParameters, compute_diagnosis_parameters, log_features
from analysis.diagnosis.slopes import COMPONENTS, DAMPING, DEPTHS, DROP_HEIGHT, GAIN, STIFFNESS, TILT, WALL_B
from analysis.diagnosis.state import (
    MOST_AVERAGED,
    SETTLING,
    DiagnosisState,
    add_confirmation_set,
    add_set,
    averaging_weights,
    covariance_of_averages,
)
from analysis.errors import InvalidInputError

BASELINE, AFTER, EVERY = 200, 120, 5
SOURCES = np.array([*STIFFNESS, *DAMPING, DROP_HEIGHT, TILT])
SD = np.array([0.01] * 9 + [0.05] * 9 + [0.06, 0.003])
FOOT = 0.12 * np.array(STIFFNESS[-1])
ZERO = np.zeros(len(COMPONENTS))


def healthy(seed, sets=BASELINE + AFTER):
    """Return independent sets of a chain whose contacts vary slightly."""
    random = np.random.default_rng(seed)
    shape = (sets, len(SD))
    noise = 1e-3 * random.standard_normal((sets, len(COMPONENTS)))
    return np.asarray((SD * random.standard_normal(shape)) @ SOURCES + noise)


def growing(target):
    """Return the change of each set: zero in the baseline, then growing linearly."""
    return np.linspace(0.0, 1.0, AFTER + 1)[1:, None] * target


def wall(depth):
    """Return the change by a wall that thins linearly to this depth."""
    depths = np.linspace(0.0, depth, AFTER + 1)[1:]
    curve = np.vstack([ZERO, WALL_B])
    return np.stack([np.interp(depths, [0.0, *DEPTHS], column) for column in curve.T], axis=1)


def diagnoses(change, seed=1, confirmation=None):
    """Yield the diagnosis of every fifth set after the baseline; a confirmation follows their 30th."""
    logs = healthy(seed)
    logs[BASELINE:] += change
    design = compute_diagnosis_parameters(logs[:BASELINE])
    memory = DiagnosisState()
    for index in range(BASELINE, BASELINE + AFTER):
        memory = add_set(memory, design.mean, logs[index], index)
        if confirmation is not None and index == BASELINE + 30:
            memory = add_confirmation_set(memory, design.mean, logs[0] + confirmation)
        assessment = diagnose_latest_set(memory, design)
        memory = add_diagnosis(memory, assessment)
        if index % EVERY == 0:
            yield assessment


def test_a_thinning_wall_is_diagnosed_and_its_incident_wave_unchanged():
    found = list(diagnoses(wall(0.3)))
    assert found[-1].cause == WALL
    assert found[-1].probability > 0.99
    assert found[-1].abrupt < 0.01
    assert found[-1].changes["tof_pp_s"] == pytest.approx(0.033, abs=0.005)
    assert found[-1].changes["isw_amplitude_v"] == pytest.approx(0.0, abs=0.03)
    assert {one.cause for one in found} <= {OK, UNDETERMINED, WALL}


def test_a_healthy_transducer_is_never_diagnosed_as_wall_thinning():
    causes = [one.cause for seed in range(5) for one in diagnoses(np.zeros((AFTER, 7)), seed)]
    assert WALL not in causes
    assert causes.count(OK) > 0.98 * len(causes)


@pytest.mark.parametrize("target", [-0.4 * np.array(GAIN), -0.5 * np.array(DROP_HEIGHT)])
def test_a_change_of_the_incident_wave_is_diagnosed_as_sensor(target):
    found = list(diagnoses(growing(target)))
    assert found[-1].cause == SENSOR
    assert WALL not in {one.cause for one in found}


def test_a_step_is_a_contact_once_a_confirmation_shows_it_again():
    alone = list(diagnoses(np.tile(FOOT, (AFTER, 1))))
    assert alone[4].cause == UNDETERMINED
    assert alone[4].abrupt > 0.9
    confirmed = list(diagnoses(np.tile(FOOT, (AFTER, 1)), confirmation=FOOT))
    # It is remembered of all sets to come, though no unscheduled set is struck any more.
    assert {one.cause for one in confirmed[6:]} == {COUPLING}
    assert confirmed[-1].probability > 0.9
    assert confirmed[-1].confirmed
    assert WALL not in {one.cause for one in alone + confirmed}


@pytest.mark.parametrize("depth", [2, 4])
def test_a_change_along_the_wall_s_own_curve_is_no_wall_where_it_comes_at_once(depth):
    found = diagnoses(np.tile(WALL_B[depth], (AFTER, 1)), confirmation=np.array(WALL_B[depth]))
    assert WALL not in {one.cause for one in found}


def test_an_alarm_that_no_cause_explains_is_undetermined():
    logs = healthy(3)
    design = compute_diagnosis_parameters(logs[:BASELINE])
    memory = add_set(DiagnosisState(), design.mean, logs[BASELINE], BASELINE)
    assert diagnose_latest_set(memory, design).cause == OK
    diagnosis = diagnose_latest_set(memory, design, suspicious=True)
    assert (diagnosis.cause, diagnosis.probability) == (UNDETERMINED, diagnosis.probabilities[OK])
    assert sum(diagnosis.probabilities.values()) == pytest.approx(1.0)


def test_the_diagnosis_state_survives_a_restart_as_json():
    logs = healthy(4) + 0.002
    design = compute_diagnosis_parameters(logs[:BASELINE])
    memory = DiagnosisState()
    for index in range(BASELINE, BASELINE + 20):
        stored = json.loads(json.dumps(asdict(memory)))
        stored["changes"] = tuple(tuple(one) for one in stored["changes"])
        restored = DiagnosisState(
            **(stored | {name: tuple(stored[name]) for name in ("confirmation", "moved")})
        )
        assert restored == memory
        memory = add_set(restored, design.mean, logs[index], index)
    assert memory.n == 20


def test_a_set_without_a_feature_has_no_logarithms_and_a_wrong_history_is_reported():
    values = dict.fromkeys(COMPONENTS, 2.0)
    assert log_features(values) == pytest.approx(np.log(np.full(7, 2.0)))
    assert log_features(values | {"isw_fwhm_s": None}) is None
    assert log_features(values | {"psw_area_v_s": -1.0}) is None
    with pytest.raises(InvalidInputError, match=r"shape \(200, 5\)"):
        compute_diagnosis_parameters(healthy(1)[:200, :5])


def test_few_sets_give_parameters_that_show_a_small_change_less():
    few, many = (compute_diagnosis_parameters(healthy(6)[:n]) for n in (24, 200))
    assert isinstance(few, DiagnosisParameters)
    change = tuple(tuple(row) for row in np.tile(0.5 * np.array(WALL_B[0]), (3, 1)))
    diagnoses_of_both = [
        diagnose_latest_set(DiagnosisState(n=60, index=300, changes=change), one) for one in (few, many)
    ]
    assert diagnoses_of_both[0].probabilities[OK] > 0.9 > 0.5 > diagnoses_of_both[1].probabilities[OK]


def test_a_slow_drift_decays_with_the_scheduled_sets_wherever_the_baseline_started():
    history = healthy(6)[:BASELINE]
    change = tuple(tuple(row) for row in np.tile(0.5 * np.array(WALL_B[0]), (3, 1)))

    def ok(first_index, index):
        design = compute_diagnosis_parameters(history, first_index)
        return diagnose_latest_set(DiagnosisState(n=60, index=index, changes=change), design).probabilities[
            OK
        ]

    assert ok(0, BASELINE + 59) == ok(700, 700 + BASELINE + 59)
    # Long after the baseline the same change is more often a wander's.
    assert ok(0, BASELINE + 1500) > ok(0, BASELINE + 59) + 0.05


def test_a_wall_is_diagnosed_by_two_consecutive_sets_including_a_confirmation():
    logs = healthy(2)
    logs[BASELINE:] += wall(0.4)
    design = compute_diagnosis_parameters(logs[:BASELINE])
    memory = DiagnosisState()
    for index in range(BASELINE, BASELINE + AFTER):
        memory = add_set(memory, design.mean, logs[index], index)
        assessment = diagnose_latest_set(memory, design)
        if assessment.probabilities[WALL] >= WALL_STATED:
            break
        memory = add_diagnosis(memory, assessment)
    assert assessment.cause == UNDETERMINED
    memory = add_diagnosis(memory, assessment)
    following = add_set(memory, design.mean, logs[index + 1], index + 1)
    assert diagnose_latest_set(following, design).cause == WALL
    confirmation_change = add_confirmation_set(memory, design.mean, logs[index + 1])
    assert diagnose_latest_set(confirmation_change, design).cause == WALL
    healthy_again = add_diagnosis(memory, diagnose_latest_set(DiagnosisState(), design))
    assert not healthy_again.likely


def test_a_first_wall_diagnosis_needs_a_higher_probability():
    design = compute_diagnosis_parameters(healthy(2)[:BASELINE])
    course = np.array([[1.0], [0.95], [0.6]]) * wall(0.3)[-1]  # it grows: the longest average is behind
    last = BASELINE + AFTER - 1
    looked = [
        DiagnosisState(n=AFTER, index=last, changes=tuple(map(tuple, (part * course).tolist())), likely=True)
        for part in np.linspace(0.04, 0.06, 200)
    ]
    between = [
        one for one in looked if STATED < diagnose_latest_set(one, design).probabilities[WALL] < WALL_STATED
    ]
    assert between
    assert {diagnose_latest_set(one, design).cause for one in between} == {UNDETERMINED}
    assert {diagnose_latest_set(replace(one, wall=True), design).cause for one in between} == {WALL}
    assert not any(add_diagnosis(one, diagnose_latest_set(one, design)).likely for one in between)


def test_a_loss_of_wall_names_a_wall_that_the_diagnosis_only_holds_for_likely():
    design = compute_diagnosis_parameters(healthy(2)[:BASELINE])
    course = np.array([[1.0], [0.95], [0.6]]) * wall(0.3)[-1]
    looked = [
        DiagnosisState(
            n=AFTER, index=BASELINE + AFTER - 1, changes=tuple(map(tuple, (part * course).tolist()))
        )
        for part in np.linspace(0.02, 0.06, 100)
    ]
    for one in looked:
        alone, lost, hardly = (
            diagnose_latest_set(one, design, lost_probability=probability)
            for probability in (0.0, LOST_LIKELY, LOST_LIKELY - 0.01)
        )
        assert alone == hardly
        assert alone.cause != WALL
        assert (lost.cause == WALL) == (alone.probabilities[WALL] >= WALL_LIKELY)
        assert lost.probability == alone.probability
    assert {diagnose_latest_set(one, design, lost_probability=1.0).cause for one in looked} == {
        OK,
        UNDETERMINED,
        WALL,
    }


def test_a_wall_diagnosis_is_withdrawn_only_by_healthy_sets():
    logs = healthy(2)
    design = compute_diagnosis_parameters(logs[:BASELINE])
    memory = DiagnosisState(wall=True)
    for index in range(BASELINE, BASELINE + 60):
        sick = logs[index] + (index - BASELINE) * -0.01 * np.array(GAIN)
        memory = add_set(memory, design.mean, sick, index)
    diagnosis = diagnose_latest_set(memory, design)
    assert diagnosis.probabilities[SENSOR] > 0.9
    assert diagnosis.cause == UNDETERMINED
    assert add_diagnosis(memory, diagnosis).wall
    assert not add_diagnosis(memory, diagnose_latest_set(DiagnosisState(), design)).wall


def test_a_wall_is_diagnosed_after_a_re_seat_and_a_return_is_healthy():
    onset = np.arange(AFTER)[:, None] >= 60
    thinner = np.where(onset, FOOT + 2.0 * (wall(0.4) - wall(0.4)[60]), FOOT)
    causes = [one.cause for one in diagnoses(thinner, confirmation=FOOT)]
    assert causes[8] == COUPLING
    assert causes[-1] == WALL
    back = [one.cause for one in diagnoses(np.where(onset, 0.0, FOOT), confirmation=FOOT)]
    assert (back[8], back[-1]) == (COUPLING, OK)


def test_the_new_contact_level_is_estimated_from_the_following_sets():
    logs, mean = healthy(5), np.zeros(len(COMPONENTS))
    memory = DiagnosisState(moved=(1.0,) * len(COMPONENTS))
    for index in range(SETTLING + 5):
        memory = add_set(memory, mean, logs[index], index)
    assert memory.moved == pytest.approx(logs[:SETTLING].mean(axis=0))
    assert np.abs(memory.averages(from_moved=True)).max() < np.abs(logs).max()


def test_growth_during_a_gap_is_not_a_step():
    logs = healthy(7)
    logs[BASELINE:] += wall(0.4)
    design = compute_diagnosis_parameters(logs[:BASELINE])
    memory = DiagnosisState()
    for index in (*range(BASELINE, BASELINE + 5), *range(BASELINE + 110, BASELINE + 114)):
        memory = add_set(memory, design.mean, logs[index], index)
        assessment = diagnose_latest_set(memory, design)
        memory = add_diagnosis(memory, assessment)
    assert (memory.gap, memory.gap_ago) == (105, 4)
    assert assessment.cause == WALL
    # Had the plan been without a gap, it would have come at once.
    assert diagnose_latest_set(replace(memory, gap=0, gap_ago=0), design).abrupt > 0.9


def test_a_gap_is_forgotten_with_the_sets_before_it_and_the_wider_of_two_is_kept():
    mean, memory = ZERO, DiagnosisState()
    for index in (10, 15, 16, 18):
        memory = add_set(memory, mean, ZERO, index)
    assert (memory.gap, memory.gap_ago) == (4, 3)
    for index in range(19, 19 + MOST_AVERAGED):
        memory = add_set(memory, mean, ZERO, index)
    assert (memory.gap, memory.gap_ago) == (0, 0)


@pytest.mark.parametrize("phi", [0.0, 0.6, 0.95])
def test_averages_scatter_as_autocorrelated_sets_do(phi):
    n, confirmation_ago = 40, 3
    sets = phi ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    found = covariance_of_averages(n, phi, confirmation_ago)
    assert found[:3, :3] == pytest.approx(averaging_weights(n) @ sets @ averaging_weights(n).T)
    # The unscheduled set is no copy of the scheduled one that it follows.
    confirmation_change = sets[confirmation_ago] - (1.0 - phi) * (np.arange(n) == confirmation_ago)
    assert found[3] == pytest.approx([*(averaging_weights(n) @ confirmation_change), 1.0])
