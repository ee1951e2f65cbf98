"""Assessments have a diagnosis, keep its state across restarts, and raise the matching alarm."""

from dataclasses import replace

import numpy as np
import pytest
from support.invented_rows import assessment_row
from support.memory_archive import bits
from support.memory_line import memory_settings

from analysis.assessment import step as solitary_wave_step
from analysis.assessment.diagnosis import Origin, diagnose_confirmation, diagnose_scheduled, update_origin
from analysis.assessment.exact_json import from_json
from analysis.assessment.step import Rules, SetOfShots, State, assess_next_set
from analysis.diagnosis.diagnose import UNDETERMINED
from analysis.diagnosis.hypotheses import COUPLING, ENVIRONMENT, OK, SENSOR, WALL
from analysis.diagnosis.slopes import COMPONENTS, DAMPING, DROP_HEIGHT, GAIN, STIFFNESS, TILT, WALL_B
from analysis.statistics.rules import AlarmRule, HoleRule
from analysis.wall.thickness import WallTrack
from daq_service.alarms.evidence import describe_evidence
from daq_service.assessment.baseline_lifecycle import get_baseline_range
from daq_service.assessment.diagnosis_texts import build_diagnosis_details, format_diagnosis
from daq_service.assessment.solitary_wave import SolitaryWaveAssessor, build_change_condition
from daq_service.recording.set_assessor import find_changed_state_rows

LAST, SETS = 59, 100
RULES = Rules(
    baseline_name="B-baseline-1",
    first_baseline_set=0,
    last_baseline_set=LAST,
    minimum_sets=15,
    minimum_valid_shots=3,
    shots_per_set=4,
    limit="f_predictive",
    false_alarm_rate=0.0027,
    run_length=43_830.0,
    false_alarms_per_sensor_year=0.2,
    decides_by="k_of_n",
    alarm=AlarmRule(k=3, n=5),
    hole=HoleRule(shots=3, consecutive_sets=2),
)
RANDOM = np.random.default_rng(3)
SD = np.array([0.01] * 9 + [0.05] * 9 + [0.06, 0.003])
SCATTER = (SD * RANDOM.standard_normal((SETS, 20))) @ np.array([*STIFFNESS, *DAMPING, DROP_HEIGHT, TILT])
SCATTER += 1e-3 * RANDOM.standard_normal(SCATTER.shape)
RAMP = np.clip((np.arange(SETS) - LAST) / (SETS - LAST), 0.0, None)[:, None]
CHANGES = {OK: np.zeros((SETS, 7)), SENSOR: -0.5 * RAMP * np.array(GAIN), WALL: RAMP * np.array(WALL_B[5])}


def sets(change):
    logs = SCATTER + change
    return [
        SetOfShots(
            set_index=index,
            due_h=float(index),
            n_taken=4,
            n_tried=4,
            n_valid=4,
            quality="good",
            reason="",
            values=dict(zip(COMPONENTS, np.exp(row).tolist(), strict=True)),
            flags=((),) * 4,
        )
        for index, row in enumerate(logs)
    ]


def run(change, state=None, since=0, until=SETS):
    state = state or State()
    for item in sets(change)[since:until]:
        state, assessment = assess_next_set(state, item, RULES)
    return state, assessment


def row_of(assessment):
    return assessment_row(
        SETS - 1,
        due_h=99.0,
        distance_squared=assessment.distance_squared,
        limits={"f_predictive": 30.0},
        outlier=assessment.outlier,
        diagnosis=assessment.cause.cause,
        diagnosis_probability=assessment.cause.probability,
        diagnosis_details=build_diagnosis_details(assessment.cause),
    )


HEADLINES = {SENSOR: "transducer fault", WALL: "wall thinning"}


@pytest.mark.parametrize(
    ("cause", "raised"), [(OK, set()), (SENSOR, {"transducer_change"}), (WALL, {"wall_change"})]
)
def test_the_alarm_has_the_kind_and_name_of_the_diagnosis(cause, raised):
    state, assessment = run(CHANGES[cause])
    assert assessment.cause.cause == cause
    found = build_change_condition("B", state, RULES, row_of(assessment))
    assert ({found.kind} if found.present else set()) == raised
    if found.present:
        texts = found.build_texts(99.0)
        assert texts.headline.startswith(f"B: signal change, probable {HEADLINES[cause]} (model: ")
        assert texts.message.endswith(texts.action)
        lines = describe_evidence(found.kind, found.evidence)
        assert any(f"{cause.upper()} " in line for line in lines if line.startswith("Probabilities"))


def test_a_loss_of_wall_known_from_earlier_sets_names_the_wall_earlier():
    def state_at_wall(lost_probability):
        """Return the state before and after the first set that is diagnosed as WALL."""
        track = WallTrack(packed=np.zeros(1, np.uint8), baseline_id=1, lost_probability=lost_probability)
        after = State(wall=track)
        for item in sets(CHANGES[WALL]):
            before, (after, assessment) = after, assess_next_set(after, item, RULES)
            if assessment.cause is not None and assessment.cause.cause == WALL:
                return before, item
        raise AssertionError("the wall thins")

    before, first = state_at_wall(1.0)
    alone, last = state_at_wall(0.0)
    assert first.set_index < last.set_index
    assert State().lost_probability == 0.0
    # With a confirmation set, too: alone it is the first one that is sure of a wall.
    settings = memory_settings()
    assessor = SolitaryWaveAssessor("B", settings, baseline=get_baseline_range("B", settings, None))
    alone = replace(alone, diagnosis_state=replace(alone.diagnosis_state, likely=False))
    for state, cause in ((alone, UNDETERMINED), (replace(alone, wall=before.wall), WALL)):
        assessor.state = state
        assert assessor.diagnose_unscheduled(last).cause == cause


def origins(causes, n=5):
    """Return a letter for each set: `e` if the change is of another origin than the wall, else `w`."""
    origin, letters = Origin(), ""
    for number, cause in enumerate(causes):
        origin = update_origin(origin, KINDS[cause], was_active=number > 2, n=n)
        letters += "e" if origin.not_wall else "w"
    return letters


KINDS = {"S": SENSOR, "E": ENVIRONMENT, "C": COUPLING, "W": WALL, "?": UNDETERMINED, "o": OK}


@pytest.mark.parametrize(
    ("causes", "expected"),
    [
        # Before the change is persistent, each set determines the kind.
        ("?S?", "wew"),
        # An undetermined diagnosis does not change the kind, five consecutive sets do.
        ("?SSS?S??S????S", "weeeeeeeeeeeee"),
        ("?SSS????SE?????", "weeeeeeeeeeeeew"),
        ("????SSSS?SSESSS", "wwwwwwwwwwwwwee"),
        # A confirmed diagnosis does immediately; a healthy set does not affect a persistent change.
        ("?SSSW", "weeew"),
        ("????C?C??", "wwwweeeee"),
        ("?SSSoooooo", "weeeeeeeee"),
    ],
)
def test_an_alarm_changes_its_kind_only_for_a_persistent_diagnosis(causes, expected):
    assert origins(causes) == expected


def test_an_alarm_that_was_active_before_the_set_keeps_its_kind(monkeypatch):
    was_active = []

    def noted(before, cause, **how):
        was_active.append(how["was_active"])
        return update_origin(before, cause, **how)

    monkeypatch.setattr(solitary_wave_step, "update_origin", noted)
    state, before = State(), []
    for item in sets(CHANGES[SENSOR]):
        before.append(state.alarm.active)
        state, _ = assess_next_set(state, item, RULES)
    assert was_active == before[LAST + 1 :]
    assert {True, False} == set(was_active)
    assert state.origin == Origin(not_wall=True)


def test_an_undetermined_cause_raises_the_wall_alarm():
    state, assessment = run(CHANGES[SENSOR])
    state = replace(state, origin=Origin())
    row = replace(row_of(assessment), diagnosis=UNDETERMINED)
    # Without a cause, as in a folder of an earlier version, the texts are the same.
    without = replace(row, diagnosis=None, diagnosis_probability=None, diagnosis_details=None)
    for item in (row, without):
        wall = build_change_condition("B", state, RULES, item)
        assert (wall.kind, wall.present) == ("wall_change", True)
        assert wall.build_texts(99.0).headline == "B: signal change, cause undetermined"


def test_a_wall_diagnosis_raises_an_alarm_before_the_chart_does():
    chart = replace(RULES, decides_by="chart")
    state, assessment = run(CHANGES[OK])
    quiet = replace(state.memory, alarming=False)
    healthy, row = replace(state, memory=quiet), row_of(assessment)
    named = replace(healthy, diagnosis_state=replace(state.diagnosis_state, wall=True))
    wall_row = replace(row, diagnosis=WALL, diagnosis_probability=0.97)
    assert not build_change_condition("B", healthy, chart, row).present
    wall = build_change_condition("B", named, chart, wall_row)
    assert (wall.kind, wall.present) == ("wall_change", True)
    assert wall.evidence["raised_by"] == "diagnosis"
    assert any(
        "Raised by the diagnosis: WALL in two consecutive sets" in sentence
        for sentence in describe_evidence(wall.kind, wall.evidence)
    )
    # An undetermined diagnosis does not reverse it, only a healthy set does.
    unsure = replace(wall_row, diagnosis=UNDETERMINED)
    assert build_change_condition("B", named, chart, unsure).present
    # If k of n sets decide, nothing else does.
    assert not build_change_condition("B", named, RULES, wall_row).present
    alarming = replace(named, memory=replace(quiet, alarming=True))
    by_chart = build_change_condition("B", alarming, chart, wall_row)
    assert by_chart.evidence["raised_by"] == "mewma"
    assert not any(
        "Raised by" in sentence for sentence in describe_evidence(by_chart.kind, by_chart.evidence)
    )


def restarted(state):
    """Return the state after a restart: stored and read."""
    rows = find_changed_state_rows(None, state, position="B", baseline_id=1, configuration_hash="")
    return from_json(State, *(row.state for row in rows))


def test_a_restart_continues_from_the_stored_state_bit_for_bit():
    _, uninterrupted = run(CHANGES[WALL])
    state = State()
    for item in sets(CHANGES[WALL]):
        state, assessment = assess_next_set(restarted(state), item, RULES)
    assert bits(assessment) == bits(uninterrupted)


def test_a_set_without_an_incident_wave_width_keeps_the_diagnosis_state():
    state, _ = run(CHANGES[OK])
    design = state.baseline.causes
    memory, cause = diagnose_scheduled(
        state.diagnosis_state, design, SETS, {"isw_fwhm_s": None}, suspicious=True
    )
    assert (memory, cause) == (state.diagnosis_state, None)
    assert diagnose_confirmation(memory, design, {"isw_fwhm_s": None}) == (memory, None)


def test_a_confirmation_set_changes_an_abrupt_change_to_coupling_permanently():
    foot = 0.3 * np.array(STIFFNESS[-1])
    change = np.where(np.arange(SETS)[:, None] > LAST + 20, foot, 0.0)
    struck_after, found = LAST + 25, sets(change)
    state, alone = run(change, until=struck_after + 1)
    assert alone.cause.cause == UNDETERMINED
    assert "check the chain contact" in build_diagnosis_details(alone.cause)["action"]
    assert format_diagnosis(UNDETERMINED, 0.8, build_diagnosis_details(alone.cause)).startswith(
        "UNDETERMINED: the waves have changed from one set to the next"
    )
    design, values = state.baseline.causes, found[struck_after].values
    memory, confirmed = diagnose_confirmation(state.diagnosis_state, design, values)
    assert (confirmed.cause, confirmed.reseated) == (COUPLING, True)
    confirmed_state = restarted(replace(state, diagnosis_state=memory))
    state, assessment = run(change, state=confirmed_state, since=struck_after + 1)
    assert assessment.cause.cause == COUPLING
    found = build_change_condition("B", state, RULES, row_of(assessment))
    assert (found.kind, found.present) == ("transducer_change", True)
    assert found.build_texts(99.0).action.startswith("Re-seat the chain; measure the wall before")
