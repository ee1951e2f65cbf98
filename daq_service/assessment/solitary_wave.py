"""Assessments of a solitary-wave transducer as rows and as conditions of alarms.

Rules and state are in `analysis.assessment.step`. Nothing here reads a clock or a file.

The control chart or the diagnosis WALL raises `wall_change` and `transducer_change`; or k of n sets above a
limit, as configured. Where a baseline has no chart, k of n always decides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from analysis.assessment.baseline_quality import assess_baseline
from analysis.assessment.combined_shots import CombinedShots, combine_shots
from analysis.assessment.confirmation import confirms_change, explain_confirmation_request
from analysis.assessment.diagnosis import diagnose_confirmation
from analysis.assessment.step import (
    Rules,
    SetAssessment,
    SetOfShots,
    State,
    assess_next_set,
    assess_without_charts,
    clear_faults,
    is_wall_alarm_active,
)
from analysis.diagnosis.diagnose import Diagnosis
from analysis.diagnosis.hypotheses import COUPLING, SENSOR, WALL
from analysis.statistics.design import Design, compute_chart_contributions
from analysis.statistics.limits import F_PREDICTIVE, PAPER_MEAN_3SD
from analysis.statistics.named_limits import DISTANCE, LIMITS, MEWMA
from analysis.statistics.rules import HoleRule
from analysis.wall.thickness import WallThickness
from analysis.waves.features import EXTRACTOR_VERSION, FEATURE_NAMES, SetFeatures, ShotFeatures
from analysis.waves.record_reduction import ExtractionSettings
from daq_service.acquisition.shot_features import derive_extraction_settings
from daq_service.alarms.states import Condition
from daq_service.archive import SetRecord
from daq_service.assessment.assessor import PositionResult
from daq_service.assessment.baseline_lifecycle import AUTOMATIC, BaselineRange
from daq_service.assessment.diagnosis_texts import build_diagnosis_details
from daq_service.assessment.rules import build_rules
from daq_service.assessment.wall import build_wall_estimator, build_wall_results
from daq_service.catalogue.rows import AssessmentRow, BaselineRow, FeatureRow
from daq_service.settings.tree import QualitySettings, Settings
from hardware_drivers.measurement import DueSet, Shot

FORMULA = "D = (x - mean)^T K^-1 (x - mean), equation 16"
CHART_FORMULA = (
    "T = (2 - w)/w |z|^2, z = w u + (1 - w) z of the set before, w = 0.1; u: what is new in the set, "
    "whitened, cut back to the F limit of 1 %"
)
BY_DIAGNOSIS = "diagnosis"
"""Value of ``raised_by`` if the diagnosis raised the alarm."""
COMMON_EVIDENCE = (
    *("set_index", "distance_squared", "baseline_id"),
    *("diagnosis", "diagnosis_probability", "diagnosis_details"),
)
"""Columns of an assessment that every alarm of a signal change shows."""


class SolitaryWaveAssessor:
    """Assessor of one solitary-wave transducer.

    Parameters
    ----------
    baseline
        Range of sets of the current baseline.
    rehearsal
        Waveforms are noise, so they raise no alarm of wall or transducer.
    has_chart
        False if its baseline was frozen by a version without control charts.
    """

    def __init__(
        self,
        position: str,
        settings: Settings,
        *,
        baseline: BaselineRange,
        rehearsal: bool = False,
        has_chart: bool = True,
    ) -> None:
        self.position = position
        self.rules = build_rules(settings, baseline=baseline, position=position, has_chart=has_chart)
        self._quality = settings.quality
        self._approval = settings.baseline.approval
        self._of_set = settings.features.of_set
        self._extraction = derive_extraction_settings(settings.positions).get(position, ExtractionSettings())
        self._baseline_id = baseline.row_id
        self._rehearsal = rehearsal
        place, rule = settings.positions[position], self.rules.alarm
        self._wall = None if rehearsal else build_wall_estimator(place, rule, baseline)
        self.state = State()

    @property
    def baseline_id(self) -> int:
        """Return the id of the baseline that the state belongs to."""
        return self._baseline_id

    def enable(self) -> None:
        """Clear the faults that disabled the transducer, because a person has enabled it."""
        self.state = clear_faults(self.state)

    def assess_set(
        self, due: DueSet, record: SetRecord, features: Mapping[int, ShotFeatures]
    ) -> PositionResult:
        """Assess the records of a scheduled set at this position and update the state.

        All shots have rows, but only accepted ones count. In a rehearsal the result has no conditions and no
        suspicion. Raise KeyError if ``features`` lacks a shot.
        """
        shots = [shot for shot in record.shots if shot.key.position == self.position]
        position_result = self.assess(
            due,
            shots,
            [features[shot.sequence] for shot in shots],
            outcomes=record.outcomes,
            n_tried=record.n_tried(self.position),
        )
        return replace(position_result, conditions=(), suspicion="") if self._rehearsal else position_result

    def assess_empty_set(self, due: DueSet, n_tried: int) -> PositionResult:
        """Assess a scheduled set without any record; tried shots count as a set with too few valid ones."""
        return self.assess(due, [], [], n_tried=n_tried)

    def assess(
        self,
        due: DueSet,
        shots: Sequence[Shot],
        features: Sequence[ShotFeatures],
        *,
        outcomes: Mapping[int, str] | None = None,
        n_tried: int | None = None,
    ) -> PositionResult:
        """Assess one scheduled set from its shots and their features, and update the state.

        A set without a record has neither rows nor an assessment, only conditions and a note. The set that
        completes the baseline also has its row, and the assessments of all its sets.

        Parameters
        ----------
        shots, features
            Shots with a waveform, in order, every attempt, and the features of each.
        outcomes
            Outcome of each shot that is not ``accepted``, by its sequence number.
        n_tried
            Shots that were struck, with or without a record; None: those that have one.
        """
        combined, before = self._average_valid(shots, features, outcomes or {}), self.state
        tried = len({shot.key.shot_index for shot in shots}) if n_tried is None else n_tried
        set_of_shots = combined.to_set_of_shots(due.set_index, due.due_h, tried)
        assessment, found = self.add_set(set_of_shots)
        devices = build_transducer_conditions(
            self.position, due, self.state, self.rules, self._quality, combined.mean.reason
        )
        if assessment is None:
            return PositionResult(conditions=devices, note=combined.mean.reason)
        freezes = has_completed_baseline(before, self.state)
        assessments = self.build_baseline_assessments() if freezes else []
        if not any(row.set_index == due.set_index for row in assessments):
            assessments.append(self._build_assessment_row(due.set_index, due.due_h, assessment))
        wall, thin = None, list[Condition]()
        if found is not None:
            wall, thin = build_wall_results(self.position, due, self.state, self.rules, found)
        return replace(
            self._build_shot_results(due, combined),
            baseline=self._build_baseline_row() if freezes else None,
            assessments=assessments,
            wall=wall,
            conditions=[
                # Shots without a reflected wave are a finding about the wall, not about the transducer.
                *([] if self.state.hole.sets_running else devices),
                build_change_condition(self.position, self.state, self.rules, assessments[-1]),
                build_no_reflection_condition(
                    self.position, due, self.state, self.rules.hole, set_of_shots.flags
                ),
                build_not_assessed_condition(self.position, due, self.state, self._baseline_id),
                *thin,
            ],
            suspicion=explain_confirmation_request(before, self.state, assessment, self.rules),
        )

    def add_set(self, set_of_shots: SetOfShots) -> tuple[SetAssessment | None, WallThickness | None]:
        """Update the state with a scheduled set; return its assessment and wall thickness, if it has one."""
        self.state, assessment = assess_next_set(self.state, set_of_shots, self.rules)
        if self._wall is None or assessment is None or assessment.distance_squared is None:
            return assessment, None
        cause = "" if assessment.cause is None else assessment.cause.cause
        other_cause = cause if cause in (SENSOR, COUPLING) else ""
        track, found = self._wall.add_set(self.state.wall, self.state.healthy, set_of_shots, other_cause)
        self.state = replace(self.state, wall=track)
        return assessment, found

    def assess_unscheduled(
        self, due: DueSet, record: SetRecord, features: Mapping[int, ShotFeatures]
    ) -> PositionResult:
        """Assess an unscheduled set; it may change the diagnosis state, but never control chart and baseline.

        Before the baseline is complete the assessment has only a reason. The result never has conditions.
        """
        shots = [shot for shot in record.shots if shot.key.position == self.position]
        combined = self._average_valid(shots, [features[shot.sequence] for shot in shots], record.outcomes)
        result = self._build_shot_results(due, combined)
        if self.state.baseline is None:
            assessment = SetAssessment(in_baseline=False, reason="no baseline yet")
            row = self._build_assessment_row(due.set_index, due.due_h, assessment, due.unscheduled_index)
            return replace(result, assessments=[row])
        set_of_shots = combined.to_set_of_shots(due.set_index, due.due_h, record.n_tried(self.position))
        assessment = assess_without_charts(set_of_shots, self.state.baseline, self.rules)
        vector, fitted = set_of_shots.vector(), self.state.baseline.fitted
        assessment = replace(assessment, cause=self.diagnose_unscheduled(set_of_shots))
        row = self._build_assessment_row(due.set_index, due.due_h, assessment, due.unscheduled_index)
        if vector is not None and fitted is not None:
            row = replace(row, confirms=confirms_change(self.state.assessed, fitted, vector))
        return replace(result, assessments=[row])

    def diagnose_unscheduled(self, set_of_shots: SetOfShots) -> Diagnosis | None:
        """Diagnose an unscheduled set and update the diagnosis state with it.

        Return None, with the state unchanged, if the baseline is not complete or has no diagnosis model, or
        the set lacks a feature.
        """
        parameters = None if self.state.baseline is None else self.state.baseline.causes
        if parameters is None or set_of_shots.vector() is None:
            return None
        diagnosis_state, diagnosis = diagnose_confirmation(
            self.state.diagnosis_state, parameters, set_of_shots.values, self.state.lost_probability
        )
        self.state = replace(self.state, diagnosis_state=diagnosis_state)
        return diagnosis

    def _average_valid(
        self, shots: Sequence[Shot], features: Sequence[ShotFeatures], outcomes: Mapping[int, str]
    ) -> CombinedShots:
        """Flag the shots of a set by comparison, and average each feature over its valid accepted shots.

        With `features.of_set` = averaged_waveform the features are those of the mean waveform of these shots.
        With too few valid shots the mean is NaN and its quality ``bad`` (`combine_shots`).
        """
        return combine_shots(
            shots,
            features,
            outcomes,
            baseline=self.state.baseline,
            minimum_valid_shots=self.rules.minimum_valid_shots,
            of_set=self._of_set,
            settings=self._extraction,
        )

    def _build_shot_results(self, due: DueSet, combined: CombinedShots) -> PositionResult:
        """Return the result of a set without an assessment: a feature row for each shot, then their mean's.

        Also the valid shots, flags by sequence number, and the reason for a poor mean as note.
        """
        of_shots = list(zip(combined.shots, combined.features, strict=True))
        rows = [_build_feature_row(due, shot, features) for shot, features in of_shots]
        return PositionResult(
            features=[*rows, _build_set_feature_row(self.position, due, combined.mean)],
            n_valid=combined.mean.n_valid,
            shot_flags={shot.sequence: features.flags for shot, features in of_shots},
            invalid=frozenset(shot.sequence for shot, features in of_shots if not features.valid),
            note=combined.mean.reason,
        )

    # Rows ----------------------------------------------------------------------------------------

    def _build_baseline_row(self) -> BaselineRow:
        """Return the row of the baseline that this set has completed: ``approved`` if that is automatic.

        Without enough usable sets its mean and covariance consist of None, and it is ``proposed``.
        """
        state, rules = self.state, self.rules
        assert state.baseline is not None, "just closed"
        fitted = state.baseline.fitted
        indices = [healthy_set.set_index for healthy_set in state.healthy]
        n_features = len(FEATURE_NAMES)
        return BaselineRow(
            id=self._baseline_id,
            name=rules.baseline_name,
            position=self.position,
            first_set_index=indices[0] if indices else 0,
            last_set_index=rules.last_baseline_set,
            n_sets=len(indices),
            feature_names=list(FEATURE_NAMES),
            mean=[None] * n_features if fitted is None else fitted.mean.tolist(),
            covariance=[[None] * n_features] * n_features if fitted is None else fitted.covariance.tolist(),
            limit_f_predictive=state.baseline.limits.get(F_PREDICTIVE),
            limit_mean_3sd=state.baseline.limits.get(PAPER_MEAN_3SD),
            limit_reason=state.baseline.reason,
            limits=dict(state.baseline.limits) or None,
            baseline_quality=assess_baseline(state, rules),
            approval=self._approval,
            # A baseline without limits cannot be approved.
            state="approved" if self._approval == AUTOMATIC and fitted is not None else "proposed",
            provenance={
                "set_indices": indices,
                "sets_left_out": state.n_left_out,
                "suspects": [] if fitted is None else list(fitted.suspects),
                "warnings": [] if fitted is None else list(fitted.warnings),
                "extractor_version": EXTRACTOR_VERSION,
                "false_alarm_rate": rules.false_alarm_rate,
            },
        )

    def build_baseline_assessments(self) -> list[AssessmentRow]:
        """Return the assessment rows of the usable sets of the completed baseline, in order, with distances.

        They are None if it has no limits. Raise AssertionError before it is complete.
        """
        state = self.state
        assert state.baseline is not None, "just closed"
        fitted = state.baseline.fitted
        distances = [None] * len(state.healthy) if fitted is None else fitted.distances_squared.tolist()
        return [
            self._build_assessment_row(
                healthy_set.set_index,
                healthy_set.due_h,
                SetAssessment(in_baseline=True, distance_squared=distance, reason="part of the baseline"),
            )
            for healthy_set, distance in zip(state.healthy, distances, strict=True)
        ]

    def _build_assessment_row(
        self, set_index: int, due_h: float, assessment: SetAssessment, unscheduled_index: int = 0
    ) -> AssessmentRow:
        """Return the row of an assessment with limits of the baseline, statistics and diagnosis."""
        baseline = self.state.baseline
        limits = {} if baseline is None else baseline.limits
        other_statistics = {
            name: value for name, value in assessment.statistics.items() if name not in (DISTANCE, MEWMA)
        }
        return AssessmentRow(
            set_index=set_index,
            unscheduled_index=unscheduled_index,
            position=self.position,
            due_h=due_h,
            baseline_id=None if baseline is None else self._baseline_id,
            in_baseline=assessment.in_baseline,
            distance_squared=assessment.distance_squared,
            limit_name=self.rules.limit if baseline is None else baseline.choose_limit_name(self.rules.limit),
            limit_f_predictive=limits.get(F_PREDICTIVE),
            limit_mean_3sd=limits.get(PAPER_MEAN_3SD),
            outlier=assessment.outlier,
            outlier_mean_3sd=assessment.outlier_mean_3sd,
            reason=assessment.reason,
            contributions=None if assessment.contributions is None else dict(assessment.contributions),
            mewma_statistic=assessment.statistics.get(MEWMA),
            mewma_alarm=None if assessment.memory is None else assessment.memory.alarming,
            statistics=other_statistics or None,
            limits=dict(limits) or None,
            averages=None
            if assessment.memory is None
            else {name: list(average) for name, average in assessment.memory.averages.items()},
            diagnosis=None if assessment.cause is None else assessment.cause.cause,
            diagnosis_probability=None if assessment.cause is None else assessment.cause.probability,
            diagnosis_details=None if assessment.cause is None else build_diagnosis_details(assessment.cause),
        )


def has_completed_baseline(before: State, after: State) -> bool:
    """Return whether the set between two states, before and after it, completed the baseline."""
    return before.baseline is None and after.baseline is not None


def _build_feature_row(due: DueSet, shot: Shot, features: ShotFeatures) -> FeatureRow:
    """Return the row of the features of one shot; ``n_valid`` is 1 if the shot is valid, else 0; no id."""
    return FeatureRow(
        id=None,
        set_index=due.set_index,
        unscheduled_index=due.unscheduled_index,
        position=shot.key.position,
        shot_index=shot.key.shot_index,
        sequence=shot.sequence,
        due_h=due.due_h,
        extractor_version=EXTRACTOR_VERSION,
        quality=features.quality,
        n_valid=int(features.valid),
        **features.values(),
    )


def _build_set_feature_row(position: str, due: DueSet, mean: SetFeatures) -> FeatureRow:
    """Return the row of the mean features of a set; ``shot_index`` and ``sequence`` are None."""
    return FeatureRow(
        id=None,
        set_index=due.set_index,
        unscheduled_index=due.unscheduled_index,
        position=position,
        shot_index=None,
        sequence=None,
        due_h=due.due_h,
        extractor_version=EXTRACTOR_VERSION,
        quality=mean.quality,
        n_valid=mean.n_valid,
        **mean.mean,
    )


# Conditions of alarms --------------------------------------------------------------------------------


def build_change_condition(position: str, state: State, rules: Rules, assessment: AssessmentRow) -> Condition:
    """Return the condition ``wall_change`` (high) or ``transducer_change`` (medium) after a set.

    A change with a diagnosis other than the wall raises the transducer alarm; an undetermined one raises the
    wall alarm (`diagnosis.update_origin`).

    Parameters
    ----------
    assessment
        Row of that set.
    """
    design = None if state.baseline is None else state.baseline.design
    if rules.decides_by == "chart" and design is not None and state.memory is not None:
        present, times_limit, evidence = _get_chart_basis(design, state, rules)
    else:
        present, times_limit, evidence = _build_k_of_n_basis(state, rules, assessment)
    not_wall = state.origin.not_wall
    return Condition(
        position=position,
        kind="transducer_change" if not_wall else "wall_change",
        alarm_class="diagnostic" if not_wall else "damage",
        priority="medium" if not_wall else "high",
        present=present,
        times_limit=times_limit,
        known=WALL if assessment.diagnosis == WALL and not not_wall else "",
        evidence=evidence
        | {name: getattr(assessment, name) for name in COMMON_EVIDENCE}
        | {"extractor_version": EXTRACTOR_VERSION},
    )


AlarmBasis = tuple[bool, float | None, dict[str, Any]]
"""Presence of the condition, multiple of the limit, and evidence."""


def _get_chart_basis(design: Design, state: State, rules: Rules) -> AlarmBasis:
    """Return presence, multiple of the limit and evidence of an alarm that the MEWMA chart decides.

    The evidence has statistic, limit, contribution of each feature, design rate, and whether the chart or the
    diagnosis raised it. Raise AssertionError if the state has no chart.
    """
    memory = state.memory
    assert memory is not None, "checked by the caller"
    limit, average = design.limits[MEWMA], np.array(memory.averages[MEWMA])
    parts = compute_chart_contributions(average)
    statistic = float(parts.sum())
    budget = rules.false_alarms_per_sensor_year
    evidence = {
        "formula": CHART_FORMULA,
        "rule": {"false_alarms_per_sensor_year": budget},
        "raised_by": MEWMA if memory.alarming else BY_DIAGNOSIS,
        "mewma_statistic": statistic,
        "limit_name": MEWMA,
        "limit": limit,
        "contributions": dict(zip(design.baseline.feature_names, parts.tolist(), strict=True)),
        "rate_verified": not design.rate_not_verified_reason,
        "rate_not_verified_reason": design.rate_not_verified_reason or None,
    }
    return is_wall_alarm_active(state, rules), statistic / limit, evidence


def _build_k_of_n_basis(state: State, rules: Rules, assessment: AssessmentRow) -> AlarmBasis:
    """Return presence, multiple of the limit, message and evidence of an alarm by k outliers of n sets.

    The multiple is None if statistic or limit is missing. Raise KeyError for an unknown limit name.
    """
    alarm, rule = state.alarm, rules.alarm
    statistics = {
        DISTANCE: assessment.distance_squared,
        MEWMA: assessment.mewma_statistic,
        **(assessment.statistics or {}),
    }
    value = statistics.get(LIMITS[assessment.limit_name].of)
    limit = (assessment.limits or {}).get(assessment.limit_name)
    evidence = {
        "formula": FORMULA,
        "rule": {"k": rule.k, "n": rule.n},
        "limit_name": assessment.limit_name,
        "limit": limit,
        "contributions": assessment.contributions,
    }
    times_limit = None if value is None or limit is None else value / limit
    return alarm.active, times_limit, evidence


def build_no_reflection_condition(
    position: str, due: DueSet, state: State, rule: HoleRule, flags: Sequence[Sequence[str]]
) -> Condition:
    """Return the condition ``no_reflection`` (critical, latched): a hole, or a chain that lost contact.

    It is present after `rule.consecutive_sets` sets with enough shots without a reflected wave.

    Parameters
    ----------
    flags
        Flags of each accepted shot; those with ``no_psw`` are counted in the evidence.
    """
    n_without_psw = sum("no_psw" in of_shot for of_shot in flags)
    return Condition(
        position=position,
        kind="no_reflection",
        alarm_class="damage",
        priority="critical",
        present=state.hole.hole,
        latched=True,
        evidence={
            "rule": {"shots": rule.shots, "consecutive_sets": rule.consecutive_sets},
            "set_index": due.set_index,
            "shots_without_psw": n_without_psw,
            "shots": len(flags),
            "extractor_version": EXTRACTOR_VERSION,
        },
    )


def build_transducer_conditions(
    position: str, due: DueSet, state: State, rules: Rules, quality: QualitySettings, reason: str
) -> list[Condition]:
    """Return the conditions ``few_valid_shots`` (medium) and, latched, ``transducer_disabled`` (high).

    They are present from `quality.no_data_sets` and `quality.retire_after_sets` consecutive poor sets on; 0
    for the latter never disables a transducer.

    Parameters
    ----------
    reason
        Why the set's features are bad or suspect, for the evidence.
    """
    poor = state.poor_sets
    few_valid_shots = Condition(
        position=position,
        kind="few_valid_shots",
        priority="medium",
        present=poor >= quality.no_data_sets,
        evidence={
            "set_index": due.set_index,
            "consecutive_poor_sets": poor,
            "minimum_valid_shots": rules.minimum_valid_shots,
            "reason": reason,
        },
    )
    disabled = replace(
        few_valid_shots,
        kind="transducer_disabled",
        priority="high",
        present=0 < quality.retire_after_sets <= poor,
        latched=True,
    )
    return [few_valid_shots, disabled]


def build_not_assessed_condition(position: str, due: DueSet, state: State, baseline_id: int) -> Condition:
    """Return the condition ``not_assessed`` (medium): present if the baseline is complete, but has no limits.

    Its evidence has the reason.
    """
    reason = "" if state.baseline is None else state.baseline.reason
    return Condition(
        position=position,
        kind="not_assessed",
        priority="medium",
        present=state.baseline is not None and state.baseline.fitted is None,
        evidence={"set_index": due.set_index, "baseline_id": baseline_id, "reason": reason},
    )
