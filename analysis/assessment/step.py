"""Assessment of one set after another at a transducer: pure functions of the state and a set.

The recorder stores the state with each set, and a restart continues from it. The stored rows of all sets give
the same state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from analysis.assessment.diagnosis import Origin, diagnose_scheduled, fit_diagnosis_parameters, update_origin
from analysis.diagnosis.diagnose import Diagnosis
from analysis.diagnosis.parameters import DiagnosisParameters
from analysis.diagnosis.state import DiagnosisState
from analysis.errors import NotEnoughSetsError, SingularCovarianceError
from analysis.statistics.baseline import Baseline, fit_baseline
from analysis.statistics.design import ChartState, Design, build_chart_state, build_design, update_chart_state
from analysis.statistics.distance import distance_squared, named_contributions
from analysis.statistics.limits import F_PREDICTIVE, PAPER_MEAN_3SD, f_predictive_limit, paper_limit
from analysis.statistics.named_limits import DISTANCE, LIMITS
from analysis.statistics.rules import (
    MINIMUM_SETS,
    AlarmRule,
    AlarmState,
    HoleRule,
    HoleState,
    count_poor_sets,
    update_alarm_state,
    update_hole_state,
)
from analysis.wall.thickness import WallTrack
from analysis.waves.features import FEATURE_NAMES


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """Rules of a transducer's assessment.

    Attributes
    ----------
    first_baseline_set, last_baseline_set
        Indices of the first and last set that belong to the baseline; one before them belongs to a baseline
        that has been retired since.
    minimum_sets, minimum_valid_shots
        Minimum number of valid sets of a baseline, and of valid shots of a set.
    limit
        Name of the limit above which a set is an outlier.
    decides_by
        Rule of the wall alarm: ``chart``, or ``k_of_n`` outliers (``alarm``).
    run_length
        Sets from one false alarm of the chart to the next, on average. None: there is no chart, since the
        baseline was frozen by a version that had none.
    """

    baseline_name: str
    first_baseline_set: int
    last_baseline_set: int
    minimum_sets: int
    minimum_valid_shots: int
    shots_per_set: int
    limit: str
    false_alarm_rate: float
    run_length: float | None
    false_alarms_per_sensor_year: float
    decides_by: str
    alarm: AlarmRule
    hole: HoleRule


@dataclass(frozen=True, slots=True, kw_only=True)
class SetOfShots:
    """Result of the shots of one set.

    Attributes
    ----------
    n_taken, n_tried, n_valid
        Records of every attempt; shots tried, with or without a record; accepted shots that are valid.
    quality, reason
        Of the set's feature (`analysis.waves.features.SetFeatures`).
    values
        The set's feature by name; None or NaN where it is not available.
    flags
        Flags of each accepted shot.
    """

    set_index: int
    due_h: float
    n_taken: int
    n_tried: int
    n_valid: int
    quality: str
    reason: str
    values: Mapping[str, float | None]
    flags: Sequence[Sequence[str]]

    def vector(self) -> tuple[float, ...] | None:
        """Return the five features in the order of `FEATURE_NAMES`; None if the set cannot be assessed.

        It cannot if its quality is bad, or if a feature is missing or not finite.
        """
        values = [self.values.get(name) for name in FEATURE_NAMES]
        known = tuple(value for value in values if value is not None and math.isfinite(value))
        return known if self.quality != "bad" and len(known) == len(values) else None


@dataclass(frozen=True, slots=True, kw_only=True)
class AssessedSet:
    """A scheduled set after the baseline: its five features, and whether it exceeds the limit."""

    vector: tuple[float, ...]
    outlier: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class FrozenBaseline:
    """A frozen baseline with its limits.

    Attributes
    ----------
    fitted
        None if the sets give no baseline, for the stated ``reason``.
    limits
        By name.
    design
        Chart parameters; None if the baseline was frozen by a version without control charts.
    causes
        Parameters of the diagnosis; None if there is no design, or a feature is constant.
    """

    fitted: Baseline | None
    limits: Mapping[str, float] = field(default_factory=dict)
    reason: str | None = None
    design: Design | None = None
    causes: DiagnosisParameters | None = None

    def choose_limit_name(self, name: str) -> str:
        """Return the name of the outlier limit: ``name`` if the baseline has it, else the F limit.

        A baseline without limits returns ``name`` unchanged.
        """
        return name if name in self.limits or not self.limits else F_PREDICTIVE


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """State of a transducer's assessment after a set.

    Attributes
    ----------
    healthy, n_left_out
        Sets of the baseline, and number of its sets that were left out.
    baseline
        None while it is collected.
    memory
        Memory of the control charts; None before their start, or without charts.
    diagnosis_state
        State of the diagnosis.
    origin
        Class of the change on which an alarm is based.
    poor_sets
        Number of consecutive sets with too few valid shots.
    assessed
        The last assessed sets, as many as the alarm rule uses: a confirmation set is compared with them.
    wall
        What is known of the wall thickness; None before the baseline is complete, or without a bank.
    """

    healthy: tuple[SetOfShots, ...] = ()
    n_left_out: int = 0
    baseline: FrozenBaseline | None = None
    alarm: AlarmState = field(default_factory=AlarmState)
    memory: ChartState | None = None
    diagnosis_state: DiagnosisState = field(default_factory=DiagnosisState)
    origin: Origin = field(default_factory=Origin)
    hole: HoleState = field(default_factory=HoleState)
    poor_sets: int = 0
    assessed: tuple[AssessedSet, ...] = ()
    wall: WallTrack | None = None

    @property
    def lost_probability(self) -> float:
        """Return the probability of a loss of wall, 0 if it is not estimated."""
        return 0.0 if self.wall is None else self.wall.lost_probability


@dataclass(frozen=True, slots=True, kw_only=True)
class SetAssessment:
    """Assessment of one set.

    Attributes
    ----------
    outlier, outlier_mean_3sd
        Above the configured limit, and above the paper's; None: not assessed, for the stated ``reason``.
    contributions
        Contribution of each feature to the squared distance, by name.
    statistics
        Every statistic that has a limit, by name; empty: not assessed.
    memory
        Memory of the control charts after this set; None: not assessed by them.
    cause, diagnosis_state, origin
        Diagnosis, its state, and the class of the alarm; None: not diagnosed.
    """

    in_baseline: bool = False
    distance_squared: float | None = None
    outlier: bool | None = None
    outlier_mean_3sd: bool | None = None
    reason: str | None = None
    contributions: Mapping[str, float] | None = None
    statistics: Mapping[str, float] = field(default_factory=dict)
    memory: ChartState | None = None
    cause: Diagnosis | None = None
    diagnosis_state: DiagnosisState | None = None
    origin: Origin | None = None


def is_wall_alarm_active(state: State, rules: Rules) -> bool:
    """Check whether the wall alarm is active.

    If the chart decides and the state has one: it is in alarm, or WALL is diagnosed. Otherwise: k outliers in
    the last n assessed sets.
    """
    if rules.decides_by == "chart" and state.memory is not None:
        return state.memory.alarming or state.diagnosis_state.wall
    return state.alarm.active


def assess_next_set(
    state: State, set_of_shots: SetOfShots, rules: Rules
) -> tuple[State, SetAssessment | None]:
    """Update the state with one set and assess it; return both, None for the assessment without a record.

    A set before the baseline's first one leaves the state unchanged and gets only a reason; one without a
    record only updates the count of poor sets. The baseline's last set freezes it, or the first set after it
    if that was missed.
    """
    if set_of_shots.set_index < rules.first_baseline_set:
        return state, SetAssessment(
            reason="its baseline was retired before it was assessed"
        ) if set_of_shots.n_taken else None
    poor_sets = count_poor_sets(
        state.poor_sets,
        n_valid=set_of_shots.n_valid,
        n_tried=set_of_shots.n_tried,
        n_planned=rules.shots_per_set,
        minimum_valid=rules.minimum_valid_shots,
    )
    state = replace(state, poor_sets=poor_sets)
    if not set_of_shots.n_taken:
        return state, None
    state = replace(state, hole=update_hole_state(state.hole, set_of_shots.flags, rules.hole))
    in_baseline = set_of_shots.set_index <= rules.last_baseline_set
    if in_baseline:
        state = _add_to_baseline(state, set_of_shots)
    # If the baseline's last set was missed, the first set after it freezes the baseline.
    freezes = state.baseline is None and set_of_shots.set_index >= rules.last_baseline_set
    if freezes:
        state = _freeze_baseline(state, rules)
    if in_baseline:
        return state, SetAssessment(
            in_baseline=True,
            reason="left out of the baseline: too few valid shots"
            if freezes
            else "the baseline is being recorded",
        )
    assert state.baseline is not None, "the first set after it freezes it"
    assessment = _assess_with_baseline(set_of_shots, state, state.baseline, rules)
    alarm = update_alarm_state(state.alarm, assessment.outlier, rules.alarm)
    assessment = _add_diagnosis(assessment, set_of_shots, state, rules, suspicious=alarm.active)
    vector = set_of_shots.vector()
    if assessment.outlier is not None and vector is not None:
        last = AssessedSet(vector=vector, outlier=assessment.outlier)
        state = replace(state, assessed=(*state.assessed, last)[-rules.alarm.n :])
    return replace(
        state,
        alarm=alarm,
        memory=assessment.memory or state.memory,
        diagnosis_state=assessment.diagnosis_state or state.diagnosis_state,
        origin=assessment.origin or state.origin,
    ), assessment


def _add_diagnosis(
    assessment: SetAssessment, set_of_shots: SetOfShots, state: State, rules: Rules, *, suspicious: bool
) -> SetAssessment:
    """Return the assessment with the diagnosis of its scheduled set added.

    Return it unchanged without diagnosis parameters, or if the control charts did not assess the set. A set
    with a feature that is missing or not positive gets no diagnosis. ``suspicious``: the k-of-n rule is in
    alarm.
    """
    parameters = None if state.baseline is None else state.baseline.causes
    if parameters is None or assessment.memory is None:
        return assessment
    suspicious = suspicious or assessment.memory.alarming
    diagnosis_state, cause = diagnose_scheduled(
        state.diagnosis_state,
        parameters,
        set_of_shots.set_index,
        set_of_shots.values,
        suspicious=suspicious,
        lost_probability=state.lost_probability,
    )
    if cause is None:
        return replace(assessment, diagnosis_state=diagnosis_state)
    origin = update_origin(
        state.origin, cause.cause, was_active=is_wall_alarm_active(state, rules), n=rules.alarm.n
    )
    return replace(assessment, cause=cause, diagnosis_state=diagnosis_state, origin=origin)


def clear_faults(state: State) -> State:
    """Return the state with the transducer's faults cleared, because a person has enabled it.

    The state of the hole rule and the count of sets with too few valid shots start from zero.
    """
    return replace(state, hole=HoleState(), poor_sets=0)


def _add_to_baseline(state: State, set_of_shots: SetOfShots) -> State:
    """Return the state with a set added to its baseline, or counted as left out if it cannot be assessed.

    The added set is stored without flags and reason.
    """
    if set_of_shots.vector() is None:
        return replace(state, n_left_out=state.n_left_out + 1)
    return replace(state, healthy=(*state.healthy, replace(set_of_shots, flags=(), reason="")))


def _freeze_baseline(state: State, rules: Rules) -> State:
    """Fit the baseline to its sets, compute its limits and start the chart; equal sets give identical bits.

    For too few sets or a singular covariance, the frozen baseline has no fit and states the reason. Without
    ``rules.run_length`` it has only the F limit and the paper's, and no chart.
    """
    vectors = np.array([healthy_set.vector() for healthy_set in state.healthy], dtype=np.float64)
    try:
        if len(state.healthy) < _minimum_sets(rules):
            raise NotEnoughSetsError(
                f"a baseline of {len(state.healthy)} sets; it needs {_minimum_sets(rules)} "
                "(baseline.minimum_sets)"
            )
        indices = [healthy_set.set_index for healthy_set in state.healthy]
        fitted = fit_baseline(vectors, indices, name=rules.baseline_name)
    except (NotEnoughSetsError, SingularCovarianceError) as error:
        return replace(
            state, baseline=FrozenBaseline(fitted=None, reason=f"{error}; {_suggest_baseline_remedy(rules)}")
        )
    if rules.run_length is None:
        limits = {
            F_PREDICTIVE: f_predictive_limit(fitted.n, fitted.p, rules.false_alarm_rate),
            PAPER_MEAN_3SD: paper_limit(fitted.distances_squared),
        }
        return replace(state, baseline=FrozenBaseline(fitted=fitted, limits=limits))
    history = np.full((indices[-1] - indices[0] + 1, fitted.p), np.nan)
    history[np.array(indices) - indices[0]] = vectors
    design = build_design(history, fitted, rules.run_length, rules.false_alarm_rate)
    return replace(
        state,
        baseline=FrozenBaseline(
            fitted=fitted,
            limits=design.limits,
            design=design,
            causes=fit_diagnosis_parameters(
                [(healthy_set.set_index, healthy_set.values) for healthy_set in state.healthy]
            ),
        ),
        memory=build_chart_state(fitted, vectors[-1]),
        diagnosis_state=DiagnosisState(),
        origin=Origin(),
    )


def _minimum_sets(rules: Rules) -> int:
    """Return the minimum number of sets of a baseline: the configured one, but at least 15."""
    return max(rules.minimum_sets, MINIMUM_SETS)


def _suggest_baseline_remedy(rules: Rules) -> str:
    """Return the advice (English text) for a baseline that cannot be fitted: longer test, new baseline."""
    n_planned = 1 + rules.last_baseline_set - rules.first_baseline_set
    if n_planned < _minimum_sets(rules):
        return f"only {n_planned} are planned: begin a new test with more baseline.hours"
    return "`solimon renew-baseline` begins another one"


def _assess_with_baseline(
    set_of_shots: SetOfShots, state: State, baseline: FrozenBaseline, rules: Rules
) -> SetAssessment:
    """Assess a set by its distance from a frozen baseline, and by the charts if they were started.

    Without a fit, or for a set of bad quality or with a missing feature, return only the reason.
    """
    if baseline.fitted is None:
        return SetAssessment(reason=baseline.reason)
    values = set_of_shots.vector()
    if values is None:
        return SetAssessment(reason=set_of_shots.reason or "a feature is not available")
    vector = np.array(values)
    memory, statistics = None, {DISTANCE: float(distance_squared(vector, baseline.fitted))}
    if baseline.design is not None and state.memory is not None:
        memory, statistics = update_chart_state(state.memory, baseline.design, set_of_shots.set_index, vector)
    return SetAssessment(
        distance_squared=statistics[DISTANCE],
        outlier=exceeds_limit(baseline.choose_limit_name(rules.limit), statistics, baseline.limits),
        outlier_mean_3sd=exceeds_limit(PAPER_MEAN_3SD, statistics, baseline.limits),
        contributions=named_contributions(vector, baseline.fitted),
        statistics=statistics,
        memory=memory,
    )


def assess_without_charts(set_of_shots: SetOfShots, baseline: FrozenBaseline, rules: Rules) -> SetAssessment:
    """Assess a set by its own distance from the baseline, without updating a chart.

    The only statistic is the squared distance; without a fit, the assessment has only a reason.
    """
    return _assess_with_baseline(set_of_shots, State(baseline=baseline), baseline, rules)


def exceeds_limit(name: str, statistics: Mapping[str, float], limits: Mapping[str, float]) -> bool | None:
    """Check whether a statistic exceeds the limit ``name``; None if either of them is missing.

    Equal to the limit is not above it. Raise KeyError for a name that is not in `LIMITS`.
    """
    value, limit = statistics.get(LIMITS[name].of), limits.get(name)
    return None if value is None or limit is None else value > limit
