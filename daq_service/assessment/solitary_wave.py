"""Assessments of a solitary-wave transducer as rows and as conditions of alarms, with their messages.

Rules and state are in `analysis.assessment.step`. Nothing here reads a clock or a file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import compress

from analysis.assessment.baseline_quality import assess_baseline
from analysis.assessment.confirmation import confirms_change, request_reason
from analysis.assessment.diagnosis import diagnose_confirmation
from analysis.assessment.step import (
    SetAssessment,
    SetOfShots,
    State,
    assess_alone,
    reinstated,
    step,
)
from analysis.diagnosis.diagnose import Diagnosis
from analysis.statistics.limits import F_PREDICTIVE, PAPER_MEAN_3SD
from analysis.statistics.named_limits import CHART, DISTANCE
from analysis.waves.features import (
    ALL_FEATURE_NAMES,
    EXTRACTOR_VERSION,
    FEATURE_NAMES,
    SetFeatures,
    ShotFeatures,
    extract_from_average,
    mean_features,
)
from analysis.waves.quality_gate import ACCEPTED
from analysis.waves.template import compare_with_others, flag_residual_reflections, learn_template
from daq_service.acquisition.schedule import DueSet
from daq_service.acquisition.taken_set import n_tried
from daq_service.alarms.states import Condition
from daq_service.archive import SetRecord
from daq_service.assessment.assessor import PositionResult, StoredResult
from daq_service.assessment.baseline_lifecycle import AUTOMATIC, BaselineRange
from daq_service.assessment.diagnosis_texts import diagnosis_details
from daq_service.assessment.rules import rules_of
from daq_service.assessment.signal_change import wall_conditions
from daq_service.catalogue.rows import AssessmentRow, BaselineRow, FeatureRow
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import Shot


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
        self._rules = rules_of(settings, baseline=baseline, position=position, has_chart=has_chart)
        self._quality = settings.quality
        self._approval = settings.baseline.approval
        self._of_set = settings.features.of_set
        self._baseline_id = baseline.row_id
        self._rehearsal = rehearsal
        self.state = State()

    def follow(self, stored: StoredResult) -> Sequence[AssessmentRow]:
        """Update the state with a set by its rows; return the assessments of a baseline that it completes."""
        row, result, before = stored.its_set, stored.result, self.state
        set_of_shots = SetOfShots(
            set_index=row.set_index,
            due_h=row.due_h,
            n_taken=row.n_taken,
            n_tried=row.n_taken + row.n_missed - row.n_restrikes,
            n_valid=row.n_valid,
            quality="bad" if result is None else result.quality,
            reason="",
            values={} if result is None else {name: getattr(result, name) for name in ALL_FEATURE_NAMES},
            flags=stored.flags,
        )
        if row.purpose is not None:
            self._diagnose_unscheduled(set_of_shots)
            return ()
        self.state, _ = step(before, set_of_shots, self._rules)
        return self._baseline_assessments() if _freezes(before, self.state) else ()

    @property
    def baseline_id(self) -> int:
        """Return the id of the baseline that the state belongs to."""
        return self._baseline_id

    def reinstate(self) -> None:
        """Clear the faults that retired the transducer, because a person has reinstated it."""
        self.state = reinstated(self.state)

    def assess_set(
        self, due: DueSet, record: SetRecord, features: Mapping[int, ShotFeatures]
    ) -> PositionResult:
        """Assess the records of a set at this position; only accepted shots count, all have rows."""
        shots = [shot for shot in record.shots if shot.key.position == self.position]
        position_result = self.assess(
            due,
            shots,
            [features[shot.sequence] for shot in shots],
            outcomes=record.outcomes,
            n_tried=n_tried(record, self.position),
        )
        return replace(position_result, conditions=(), suspicion="") if self._rehearsal else position_result

    def assess_empty_set(self, due: DueSet, n_tried: int) -> PositionResult:
        """Assess a set without any record."""
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
        """Assess one set from its shots and their features.

        Parameters
        ----------
        shots, features
            Shots with a waveform, in order, every attempt.
        outcomes
            Outcome of each shot that is not ``accepted``, by its sequence.
        n_tried
            Shots that were struck, with or without a record; None: those that have one.
        """
        features, counting, mean = self._combine_shots(shots, features, outcomes or {})
        state_before = self.state
        tried = len({shot.key.shot_index for shot in shots}) if n_tried is None else n_tried
        set_of_shots = self._set_of_shots(due, len(shots), tried, counting, mean)
        self.state, assessment = step(state_before, set_of_shots, self._rules)
        if assessment is None:
            return PositionResult(conditions=self._device_conditions(due, mean), note=mean.reason)
        freezes = _freezes(state_before, self.state)
        assessments = self._baseline_assessments() if freezes else []
        if not any(row.set_index == due.set_index for row in assessments):
            assessments.append(self._assessment_row(due.set_index, due.due_h, assessment))
        # Shots without a reflected wave are a finding about the wall, not about the transducer.
        conditions = [] if self.state.hole.sets_running else self._device_conditions(due, mean)
        conditions += wall_conditions(self.position, self.state, self._rules, assessments[-1])
        conditions += [self._hole_condition(due, counting), self._not_assessed_condition(due)]
        return replace(
            self._result_of_shots(due, shots, features, mean),
            baseline=self._baseline_row() if freezes else None,
            assessments=assessments,
            conditions=conditions,
            suspicion=request_reason(state_before, self.state, assessment, self._rules),
        )

    def assess_unscheduled(
        self, due: DueSet, record: SetRecord, features: Mapping[int, ShotFeatures]
    ) -> PositionResult:
        """Assess an unscheduled set; control chart and baseline never use it."""
        shots = [shot for shot in record.shots if shot.key.position == self.position]
        checked, counting, mean = self._combine_shots(
            shots, [features[shot.sequence] for shot in shots], record.outcomes
        )
        result = self._result_of_shots(due, shots, checked, mean)
        if self.state.baseline is None:
            return result
        set_of_shots = self._set_of_shots(due, len(shots), n_tried(record, self.position), counting, mean)
        assessment = assess_alone(set_of_shots, self.state.baseline, self._rules)
        vector, fitted = set_of_shots.vector(), self.state.baseline.fitted
        assessment = replace(assessment, cause=self._diagnose_unscheduled(set_of_shots))
        row = self._assessment_row(due.set_index, due.due_h, assessment, due.unscheduled_index)
        if vector is not None and fitted is not None:
            row = replace(row, confirms=confirms_change(self.state.assessed, fitted, vector))
        return replace(result, assessments=[row])

    def _diagnose_unscheduled(self, set_of_shots: SetOfShots) -> Diagnosis | None:
        """Diagnose an unscheduled set; the diagnosis state keeps it."""
        parameters = None if self.state.baseline is None else self.state.baseline.causes
        if parameters is None or set_of_shots.vector() is None:
            return None
        diagnosis_state, diagnosis = diagnose_confirmation(
            self.state.diagnosis_state, parameters, set_of_shots.values
        )
        self.state = replace(self.state, diagnosis_state=diagnosis_state)
        return diagnosis

    @property
    def not_assessed_reason(self) -> str:
        """Return why a set cannot be compared with a baseline; empty if it can."""
        baseline = self.state.baseline
        return (
            "it has no baseline yet; wait until it is recorded" if baseline is None else baseline.reason or ""
        )

    def _combine_shots(
        self, shots: Sequence[Shot], features: Sequence[ShotFeatures], outcomes: Mapping[int, str]
    ) -> tuple[list[ShotFeatures], list[ShotFeatures], SetFeatures]:
        """Return the features of all shots, of the accepted shots, and of the set."""
        baseline = self.state.baseline
        if baseline is not None and baseline.fitted is not None:
            usual_ratio = float(baseline.fitted.mean[FEATURE_NAMES.index("amplitude_ratio")])
            features = flag_residual_reflections(features, usual_ratio)
        # Only the comparison with the other shots shows a weak strike, a knock or a second strike.
        features = compare_with_others(features, learn_template(features))
        accepted = [outcomes.get(shot.sequence, ACCEPTED) == ACCEPTED for shot in shots]
        accepted_features = list(compress(features, accepted))
        return (
            features,
            accepted_features,
            self._set_features(list(compress(shots, accepted)), accepted_features),
        )

    def _set_of_shots(
        self, due: DueSet, n_taken: int, n_tried: int, counting: Sequence[ShotFeatures], mean: SetFeatures
    ) -> SetOfShots:
        return SetOfShots(
            set_index=due.set_index,
            due_h=due.due_h,
            n_taken=n_taken,
            n_tried=n_tried,
            n_valid=mean.n_valid,
            quality=mean.quality,
            reason=mean.reason,
            values={name: value if math.isfinite(value) else None for name, value in mean.mean.items()},
            flags=[features.flags for features in counting],
        )

    def _result_of_shots(
        self, due: DueSet, shots: Sequence[Shot], features: Sequence[ShotFeatures], mean: SetFeatures
    ) -> PositionResult:
        """Return the rows and flags of a set that depend on no other set."""
        rows = [
            _feature_row(due, shot, features_of_shot)
            for shot, features_of_shot in zip(shots, features, strict=True)
        ]
        rows.append(_set_feature_row(self.position, due, mean))
        return PositionResult(
            features=rows,
            n_valid=mean.n_valid,
            shot_flags={
                shot.sequence: features_of_shot.flags
                for shot, features_of_shot in zip(shots, features, strict=True)
            },
            invalid=frozenset(
                shot.sequence
                for shot, features_of_shot in zip(shots, features, strict=True)
                if not features_of_shot.valid
            ),
            note=mean.reason,
        )

    def _set_features(self, shots: Sequence[Shot], features: Sequence[ShotFeatures]) -> SetFeatures:
        """Compute a set's features: mean of valid shots, or of their averaged waveform as in the paper."""
        mean = mean_features(features, self._rules.minimum_valid_shots)
        if self._of_set == "mean_of_shots" or mean.quality == "bad":
            return mean
        valid = [
            shot.waveform
            for shot, features_of_shot in zip(shots, features, strict=True)
            if features_of_shot.valid
        ]
        of_average = extract_from_average(valid)
        if not of_average.valid:
            return replace(
                mean, quality="bad", reason=f"the averaged record is {', '.join(of_average.flags)}"
            )
        return replace(mean, mean=of_average.values())

    # Rows ----------------------------------------------------------------------------------------

    def _baseline_row(self) -> BaselineRow:
        """Return the row of the baseline that was just frozen."""
        state, rules = self.state, self._rules
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

    def _baseline_assessments(self) -> list[AssessmentRow]:
        """Return the assessment rows of the baseline's sets with their distances."""
        state = self.state
        assert state.baseline is not None, "just closed"
        fitted = state.baseline.fitted
        distances = [None] * len(state.healthy) if fitted is None else fitted.distances_squared.tolist()
        return [
            self._assessment_row(
                healthy_set.set_index,
                healthy_set.due_h,
                SetAssessment(in_baseline=True, distance_squared=distance, reason="part of the baseline"),
            )
            for healthy_set, distance in zip(state.healthy, distances, strict=True)
        ]

    def _assessment_row(
        self, set_index: int, due_h: float, assessment: SetAssessment, unscheduled_index: int = 0
    ) -> AssessmentRow:
        baseline = self.state.baseline
        limits = {} if baseline is None else baseline.limits
        other_statistics = {
            name: value for name, value in assessment.statistics.items() if name not in (DISTANCE, CHART)
        }
        return AssessmentRow(
            set_index=set_index,
            unscheduled_index=unscheduled_index,
            position=self.position,
            due_h=due_h,
            baseline_id=None if baseline is None else self._baseline_id,
            in_baseline=assessment.in_baseline,
            distance_squared=assessment.distance_squared,
            limit_name=self._rules.limit if baseline is None else baseline.effective_limit(self._rules.limit),
            limit_f_predictive=limits.get(F_PREDICTIVE),
            limit_mean_3sd=limits.get(PAPER_MEAN_3SD),
            outlier=assessment.outlier,
            outlier_mean_3sd=assessment.outlier_mean_3sd,
            reason=assessment.reason,
            contributions=None if assessment.contributions is None else dict(assessment.contributions),
            mewma_statistic=assessment.statistics.get(CHART),
            mewma_alarm=None if assessment.memory is None else assessment.memory.alarming,
            statistics=other_statistics or None,
            limits=dict(limits) or None,
            averages=None
            if assessment.memory is None
            else {name: list(average) for name, average in assessment.memory.averages.items()},
            diagnosis=None if assessment.cause is None else assessment.cause.cause,
            diagnosis_probability=None if assessment.cause is None else assessment.cause.probability,
            diagnosis_details=None if assessment.cause is None else diagnosis_details(assessment.cause),
        )

    # Conditions ----------------------------------------------------------------------------------

    def _device_conditions(self, due: DueSet, mean: SetFeatures) -> list[Condition]:
        """Return the conditions of too few valid shots: first an alarm, later the transducer is retired."""
        quality, poor = self._quality, self.state.poor_sets
        finding = f"{poor} sets running with too few valid shots at {self.position} (last: {mean.reason})"
        action = "check coil, striker, sensor and cable"
        evidence = {
            "set_index": due.set_index,
            "consecutive_poor_sets": poor,
            "minimum_valid_shots": self._rules.minimum_valid_shots,
        }
        return [
            Condition(
                position=self.position,
                kind="few_valid_shots",
                priority="medium",
                present=poor >= quality.no_data_sets,
                message=f"{finding}; {action}",
                evidence=evidence,
            ),
            Condition(
                position=self.position,
                kind="transducer_disabled",
                priority="high",
                present=0 < quality.retire_after_sets <= poor,
                latched=True,
                message=f"{finding}: the transducer strikes no more; {action}, then reinstate it",
                evidence=evidence,
            ),
        ]

    def _not_assessed_condition(self, due: DueSet) -> Condition:
        baseline = self.state.baseline
        return Condition(
            position=self.position,
            kind="not_assessed",
            priority="medium",
            present=baseline is not None and baseline.fitted is None,
            message=f"nothing is judged at {self.position}: {self.not_assessed_reason}",
            evidence={"set_index": due.set_index, "baseline_id": self._baseline_id},
        )

    def _hole_condition(self, due: DueSet, features: Sequence[ShotFeatures]) -> Condition:
        rule = self._rules.hole
        n_without_psw = sum("no_psw" in features_of_shot.flags for features_of_shot in features)
        return Condition(
            position=self.position,
            kind="no_reflection",
            alarm_class="damage",
            priority="critical",
            present=self.state.hole.hole,
            latched=True,
            message=(
                f"no reflected wave at {self.position} in {n_without_psw} of {len(features)} shots, "
                f"{rule.consecutive_sets} sets running: the wall has a hole or the chain lost contact; "
                "the transducer strikes no more"
            ),
            evidence={
                "rule": {"shots": rule.shots, "consecutive_sets": rule.consecutive_sets},
                "set_index": due.set_index,
                "shots_without_psw": n_without_psw,
                "extractor_version": EXTRACTOR_VERSION,
            },
        )


def _freezes(before: State, after: State) -> bool:
    return before.baseline is None and after.baseline is not None


def _feature_row(due: DueSet, shot: Shot, features: ShotFeatures) -> FeatureRow:
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


def _set_feature_row(position: str, due: DueSet, mean: SetFeatures) -> FeatureRow:
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
