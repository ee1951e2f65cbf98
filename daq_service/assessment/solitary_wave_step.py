"""One set after another at a solitary-wave transducer: a pure step from state and set to state and verdict.

The recorder feeds each set as it is taken; a restart feeds those of the catalogue again and stands where
the last recorder stood. Rows and wording are `solitary_wave`'s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from analysis.diagnosis.diagnose import Diagnosis
from analysis.diagnosis.parameters import DiagnosisParameters
from analysis.diagnosis.state import DiagnosisState
from analysis.errors import NotEnoughSetsError, SingularCovarianceError
from analysis.statistics.baseline import Baseline, fit_baseline
from analysis.statistics.design import ChartState, Design, design_of, next_chart_state, state_at_end_of
from analysis.statistics.distance import distance_squared, named_contributions
from analysis.statistics.limits import F_PREDICTIVE, PAPER_MEAN_3SD, f_predictive_limit, paper_limit
from analysis.statistics.named_limits import DISTANCE, LIMITS
from analysis.statistics.rules import (
    MINIMUM_SETS,
    AlarmRule,
    AlarmState,
    HoleRule,
    HoleState,
    next_alarm_state,
    next_hole_state,
    next_poor_sets,
)
from analysis.waves.features import FEATURE_NAMES
from daq_service.assessment.diagnosis import Origin, cause_after, design_of_causes, next_origin


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """What a transducer is judged by.

    Attributes
    ----------
    first_baseline_set, last_baseline_set
        Indices of the first and last set that belong to the baseline; one before them belongs to a baseline
        that was retired meanwhile.
    minimum_sets, minimum_valid_shots
        Fewer valid sets make no baseline, fewer valid shots a poor set.
    limit
        Name of the limit beyond which a set is an outlier.
    decides_by
        What raises the alarm of the wall: ``chart``, or ``k_of_n`` of such sets (``alarm``).
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
    """What a set gave.

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
        """Return the five features of the Mahalanobis vector; None where the set is not to be judged."""
        values = [self.values.get(name) for name in FEATURE_NAMES]
        known = tuple(value for value in values if value is not None and math.isfinite(value))
        return known if self.quality != "bad" and len(known) == len(values) else None


@dataclass(frozen=True, slots=True, kw_only=True)
class AssessedSet:
    """A planned set behind the baseline: its five features, and whether it lies beyond the limit."""

    vector: tuple[float, ...]
    outlier: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class FrozenBaseline:
    """The closed baseline with its limits.

    Attributes
    ----------
    fitted
        None: the sets gave none, and ``reason`` says why.
    limits
        By name.
    design
        Everything else to judge by; None: the baseline was frozen by a version that had no chart.
    causes
        What tells a sick wall from a sick sensor; None: there is no design, or features that never change.
    """

    fitted: Baseline | None
    limits: Mapping[str, float] = field(default_factory=dict)
    reason: str | None = None
    design: Design | None = None
    causes: DiagnosisParameters | None = None

    def judging(self, name: str) -> str:
        """Return the limit beyond which a set is an outlier: the wanted one, where that version had it."""
        return name if name in self.limits or not self.limits else F_PREDICTIVE


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """What later sets are judged by.

    Attributes
    ----------
    healthy, n_left_out
        Sets of the baseline, and how many of its sets were unfit for it.
    baseline
        None while it is being recorded.
    memory
        What the charts remember; None: they have not begun, or there are none.
    diagnosis_state
        What the causes are told by.
    origin
        Where the change comes from that has an alarm, or would have.
    poor_sets
        Sets running with too few valid shots.
    judged
        The last judged sets, as many as ``alarm`` remembers: a confirmation set is compared with them.
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
    judged: tuple[AssessedSet, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class SetAssessment:
    """What a set says.

    Attributes
    ----------
    outlier, outlier_paper
        Beyond the deciding limit, and beyond the paper's; None: not judged, ``reason`` says why.
    contributions
        Part of the squared distance of each feature, by its name.
    statistics
        Everything that limits bound, by name; empty: not judged.
    memory
        What the charts remember after it; None: it was not judged by them.
    cause, diagnosis_state, origin
        What the change comes from, what is remembered for it, and whose alarm it is; None: none was sought.
    """

    in_baseline: bool = False
    distance_squared: float | None = None
    outlier: bool | None = None
    outlier_paper: bool | None = None
    reason: str | None = None
    contributions: Mapping[str, float] | None = None
    statistics: Mapping[str, float] = field(default_factory=dict)
    memory: ChartState | None = None
    cause: Diagnosis | None = None
    diagnosis_state: DiagnosisState | None = None
    origin: Origin | None = None


def alarms(state: State, rules: Rules) -> bool:
    """Return whether the wall alarm is present: by the chart or a wall that is named, or by k of n."""
    if rules.decides_by == "chart" and state.memory is not None:
        return state.memory.alarming or state.diagnosis_state.wall
    return state.alarm.active


def step(
    state: State, found: SetOfShots, rules: Rules, stored: SetAssessment | None = None
) -> tuple[State, SetAssessment | None]:
    """Judge one set; no verdict where not one record was taken.

    Parameters
    ----------
    stored
        Its verdict, where it was judged before: a restart reads only the last sets, and what came before them
        is in what they remember.
    """
    if found.set_index < rules.first_baseline_set:
        return state, SetAssessment(
            reason="its baseline was retired before it was judged"
        ) if found.n_taken else None
    poor_sets = next_poor_sets(
        state.poor_sets,
        n_valid=found.n_valid,
        n_tried=found.n_tried,
        n_planned=rules.shots_per_set,
        minimum_valid=rules.minimum_valid_shots,
    )
    state = replace(state, poor_sets=poor_sets)
    if not found.n_taken:
        return state, None
    state = replace(state, hole=next_hole_state(state.hole, found.flags, rules.hole))
    in_baseline = found.set_index <= rules.last_baseline_set
    if in_baseline:
        state = _remembering(state, found)
    # Where the baseline's last set was missed, it closes at the first one after it.
    closes = state.baseline is None and found.set_index >= rules.last_baseline_set
    if closes:
        state = _frozen(state, rules)
    if in_baseline:
        return state, SetAssessment(
            in_baseline=True,
            reason="left out of the baseline: too few valid shots"
            if closes
            else "the baseline is being recorded",
        )
    assert state.baseline is not None, "it closes at the first set after it"
    assessment = stored or _judged(found, state, state.baseline, rules)
    alarm = next_alarm_state(state.alarm, assessment.outlier, rules.alarm)
    if stored is None:
        assessment = _with_cause(assessment, found, state, rules, suspicious=alarm.active)
    vector = found.vector()
    if assessment.outlier is not None and vector is not None:
        last = AssessedSet(vector=vector, outlier=assessment.outlier)
        state = replace(state, judged=(*state.judged, last)[-rules.alarm.n :])
    return replace(
        state,
        alarm=alarm,
        memory=assessment.memory or state.memory,
        diagnosis_state=assessment.diagnosis_state or state.diagnosis_state,
        origin=assessment.origin or state.origin,
    ), assessment


def _with_cause(
    assessment: SetAssessment, found: SetOfShots, state: State, rules: Rules, *, suspicious: bool
) -> SetAssessment:
    design = None if state.baseline is None else state.baseline.causes
    if design is None or assessment.memory is None:
        return assessment
    suspicious = suspicious or assessment.memory.alarming
    diagnosis_state, cause = cause_after(
        state.diagnosis_state, design, found.set_index, found.values, suspicious=suspicious
    )
    if cause is None:
        return replace(assessment, diagnosis_state=diagnosis_state)
    origin = next_origin(state.origin, cause.cause, stood=alarms(state, rules), n=rules.alarm.n)
    return replace(assessment, cause=cause, diagnosis_state=diagnosis_state, origin=origin)


def reinstated(state: State) -> State:
    """Forget what retired the transducer: a person says that it may strike again."""
    return replace(state, hole=HoleState(), poor_sets=0)


def _remembering(state: State, found: SetOfShots) -> State:
    if found.vector() is None:
        return replace(state, n_left_out=state.n_left_out + 1)
    return replace(state, healthy=(*state.healthy, found))


def _frozen(state: State, rules: Rules) -> State:
    """Fit the baseline to the remembered sets, and begin the charts; the same sets give the same bits."""
    vectors = np.array([found.vector() for found in state.healthy], dtype=np.float64)
    try:
        if len(state.healthy) < _least(rules):
            raise NotEnoughSetsError(
                f"a baseline of {len(state.healthy)} sets; it needs {_least(rules)} (baseline.minimum_sets)"
            )
        indices = [found.set_index for found in state.healthy]
        fitted = fit_baseline(vectors, indices, name=rules.baseline_name)
    except (NotEnoughSetsError, SingularCovarianceError) as error:
        return replace(state, baseline=FrozenBaseline(fitted=None, reason=f"{error}; {_remedy(rules)}"))
    if rules.run_length is None:
        limits = {
            F_PREDICTIVE: f_predictive_limit(fitted.n, fitted.p, rules.false_alarm_rate),
            PAPER_MEAN_3SD: paper_limit(fitted.distances_squared),
        }
        return replace(state, baseline=FrozenBaseline(fitted=fitted, limits=limits))
    history = np.full((indices[-1] - indices[0] + 1, fitted.p), np.nan)
    history[np.array(indices) - indices[0]] = vectors
    design = design_of(history, fitted, rules.run_length, rules.false_alarm_rate)
    return replace(
        state,
        baseline=FrozenBaseline(
            fitted=fitted,
            limits=design.limits,
            design=design,
            causes=design_of_causes([(found.set_index, found.values) for found in state.healthy]),
        ),
        memory=state_at_end_of(fitted, vectors[-1]),
        diagnosis_state=DiagnosisState(),
        origin=Origin(),
    )


def _least(rules: Rules) -> int:
    return max(rules.minimum_sets, MINIMUM_SETS)


def _remedy(rules: Rules) -> str:
    n_planned = 1 + rules.last_baseline_set - rules.first_baseline_set
    if n_planned < _least(rules):
        return f"only {n_planned} are planned: begin a new test with more baseline.hours"
    return "`solimon renew-baseline` begins another one"


def _judged(found: SetOfShots, state: State, baseline: FrozenBaseline, rules: Rules) -> SetAssessment:
    if baseline.fitted is None:
        return SetAssessment(reason=baseline.reason)
    values = found.vector()
    if values is None:
        return SetAssessment(reason=found.reason or "a feature is not available")
    vector = np.array(values)
    memory, statistics = None, {DISTANCE: float(distance_squared(vector, baseline.fitted))}
    if baseline.design is not None and state.memory is not None:
        memory, statistics = next_chart_state(state.memory, baseline.design, found.set_index, vector)
    return SetAssessment(
        distance_squared=statistics[DISTANCE],
        outlier=beyond(baseline.judging(rules.limit), statistics, baseline.limits),
        outlier_paper=beyond(PAPER_MEAN_3SD, statistics, baseline.limits),
        contributions=named_contributions(vector, baseline.fitted),
        statistics=statistics,
        memory=memory,
    )


def alone(found: SetOfShots, baseline: FrozenBaseline, rules: Rules) -> SetAssessment:
    """Judge a set by its own distance; no chart takes it in."""
    return _judged(found, State(baseline=baseline), baseline, rules)


def beyond(name: str, statistics: Mapping[str, float], limits: Mapping[str, float]) -> bool | None:
    """Tell whether a set lies beyond a limit; None: there is no such limit, or nothing to compare with it."""
    value, limit = statistics.get(LIMITS[name].of), limits.get(name)
    return None if value is None or limit is None else value > limit
