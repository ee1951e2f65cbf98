"""The verdicts of a solitary-wave transducer as rows and as conditions of alarms, with their wording.

What is decided, and by which memory, is `solitary_wave_step`. Nothing here reads a clock or a file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import compress

from analysis.statistics.design import ChartState
from analysis.statistics.limits import F_PREDICTIVE, PAPER_MEAN_3SD
from analysis.statistics.named_limits import AVERAGE, CHART, DISTANCE
from analysis.waves.features import (
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
from daq_service.assessment.assessor import PositionResult
from daq_service.assessment.baseline_lifecycle import AUTOMATIC, Planned
from daq_service.assessment.baseline_quality import readiness_of
from daq_service.assessment.confirmation import confirms, suspicion
from daq_service.assessment.diagnosis import (
    averages_of,
    cause_confirmed,
    experiment_text,
    kept_origin,
    origin_of,
    restored_diagnosis_state,
)
from daq_service.assessment.rules import rules_of
from daq_service.assessment.signal_change import wall_conditions
from daq_service.assessment.solitary_wave_step import (
    SetAssessment,
    SetOfShots,
    State,
    alone,
    reinstated,
    step,
)
from daq_service.catalogue.rows import AssessmentRow, BaselineRow, FeatureRow
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import Shot


class SolitaryWaveAssessor:
    """Judges the sets of one solitary-wave transducer.

    Parameters
    ----------
    baseline
        Which sets the present baseline is made of.
    rehearsal
        Records are noise: what they say of wall and transducer is no alarm.
    has_chart
        False: its baseline was frozen by a version that had none.
    """

    def __init__(
        self,
        position: str,
        settings: Settings,
        *,
        baseline: Planned,
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
        self._state = State()

    def feed(self, found: SetOfShots, assessment: AssessmentRow | None) -> None:
        """Take in a set that was judged before, and how, as the catalogue tells it."""
        self._state, _ = step(self._state, found, self._rules, _stored(found, assessment))

    def feed_unscheduled(self, after_set: int, assessment: AssessmentRow) -> None:
        """Take in what a set beside the plan left to remember, where no planned one came later."""
        left, last = restored_diagnosis_state(assessment.averages or {}), self._state.diagnosis_state.index
        if left is not None and after_set >= (self._rules.last_baseline_set if last is None else last):
            self._state = replace(self._state, diagnosis_state=left)

    def reinstate(self) -> None:
        """Forget what retired the transducer: a person says that it may strike again."""
        self._state = reinstated(self._state)

    def assess_set(
        self, due: DueSet, record: SetRecord, features: Mapping[int, ShotFeatures]
    ) -> PositionResult:
        """Judge what a set took here; only accepted shots are averaged and judged, all have rows."""
        shots = [shot for shot in record.shots if shot.key.position == self.position]
        position_result = self.assess(
            due,
            shots,
            [features[shot.sequence] for shot in shots],
            outcomes=record.outcomes,
            n_tried=n_tried(record, self.position),
        )
        return replace(position_result, conditions=(), suspicion="") if self._rehearsal else position_result

    def nothing_taken(self, due: DueSet, n_tried: int) -> PositionResult:
        """Judge a set that gave not one record."""
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
        """Judge one set.

        Parameters
        ----------
        shots, features
            What was taken, in order, every attempt.
        outcomes
            Outcome of each shot that is not ``accepted``, by its sequence.
        n_tried
            Shots that were struck, with or without a record; None: those that have one.
        """
        features, counting, mean = self._seen(shots, features, outcomes or {})
        before = self._state
        tried = len({shot.key.shot_index for shot in shots}) if n_tried is None else n_tried
        found = self._set_of_shots(due, len(shots), tried, counting, mean)
        self._state, assessment = step(before, found, self._rules)
        if assessment is None:
            return PositionResult(conditions=self._device_conditions(due, mean), note=mean.reason)
        closes = before.baseline is None and self._state.baseline is not None
        assessments = self._baseline_assessments() if closes else []
        if not any(row.set_index == due.set_index for row in assessments):
            assessments.append(self._assessment_row(due.set_index, due.due_h, assessment))
        # Strikes that come back without a reflection tell of the wall, not of the transducer.
        conditions = [] if self._state.hole.sets_running else self._device_conditions(due, mean)
        conditions += wall_conditions(self.position, self._state, self._rules, assessments[-1])
        conditions += [self._hole_condition(due, counting), self._unjudged_condition(due)]
        return replace(
            self._told(due, shots, features, mean),
            baseline=self._baseline_row() if closes else None,
            assessments=assessments,
            conditions=conditions,
            suspicion=suspicion(before, self._state, assessment, self._rules),
        )

    def assess_unscheduled(
        self, due: DueSet, record: SetRecord, features: Mapping[int, ShotFeatures]
    ) -> PositionResult:
        """Judge a set beside the plan by what the planned ones say; no chart and no baseline sees it."""
        shots = [shot for shot in record.shots if shot.key.position == self.position]
        own, counting, mean = self._seen(shots, [features[shot.sequence] for shot in shots], record.outcomes)
        told = self._told(due, shots, own, mean)
        if self._state.baseline is None:
            return told
        found = self._set_of_shots(due, len(shots), n_tried(record, self.position), counting, mean)
        assessment, causes = alone(found, self._state.baseline, self._rules), self._state.baseline.causes
        vector, fitted = found.vector(), self._state.baseline.fitted
        if causes is not None and vector is not None:
            diagnosis_state, cause = cause_confirmed(self._state.diagnosis_state, causes, found.values)
            self._state = replace(self._state, diagnosis_state=diagnosis_state)
            assessment = replace(assessment, cause=cause, diagnosis_state=diagnosis_state)
        row = self._assessment_row(due.set_index, due.due_h, assessment)
        if vector is not None and fitted is not None:
            row = replace(row, confirms=confirms(self._state.judged, fitted, vector))
        return replace(told, assessments=[row])

    @property
    def not_assessed_reason(self) -> str:
        """Why there is nothing to compare a set with; empty: there is."""
        baseline = self._state.baseline
        return (
            "it has no baseline yet; wait until it is recorded" if baseline is None else baseline.reason or ""
        )

    def _seen(
        self, shots: Sequence[Shot], features: Sequence[ShotFeatures], outcomes: Mapping[int, str]
    ) -> tuple[list[ShotFeatures], list[ShotFeatures], SetFeatures]:
        """Look at the shots of a set together: features of all, those of the accepted ones, the set's."""
        baseline = self._state.baseline
        if baseline is not None and baseline.fitted is not None:
            usual = float(baseline.fitted.mean[FEATURE_NAMES.index("amplitude_ratio")])
            features = flag_residual_reflections(features, usual)
        # One shot alone cannot tell what the others can: a weak strike, a knock, a second one.
        features = compare_with_others(features, learn_template(features))
        counts = [outcomes.get(shot.sequence, ACCEPTED) == ACCEPTED for shot in shots]
        counting = list(compress(features, counts))
        return features, counting, self._set_features(list(compress(shots, counts)), counting)

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
            values=mean.mean,
            flags=[found.flags for found in counting],
        )

    def _told(
        self, due: DueSet, shots: Sequence[Shot], features: Sequence[ShotFeatures], mean: SetFeatures
    ) -> PositionResult:
        """Tell of a set what no other one changes."""
        rows = [_feature_row(due, shot, found) for shot, found in zip(shots, features, strict=True)]
        rows.append(_set_feature_row(self.position, due, mean))
        return PositionResult(
            features=rows,
            n_valid=mean.n_valid,
            shot_flags={shot.sequence: found.flags for shot, found in zip(shots, features, strict=True)},
            invalid=frozenset(
                shot.sequence for shot, found in zip(shots, features, strict=True) if not found.valid
            ),
            note=mean.reason,
        )

    def _set_features(self, shots: Sequence[Shot], features: Sequence[ShotFeatures]) -> SetFeatures:
        """Average the valid shots' features, or take those of their averaged record (the paper's way)."""
        mean = mean_features(features, self._rules.minimum_valid_shots)
        if self._of_set == "mean_of_shots" or mean.quality == "bad":
            return mean
        valid = [shot.waveform for shot, found in zip(shots, features, strict=True) if found.valid]
        averaged = extract_from_average(valid)
        if not averaged.valid:
            return replace(mean, quality="bad", reason=f"the averaged record is {', '.join(averaged.flags)}")
        return replace(mean, mean=averaged.values())

    # Rows ----------------------------------------------------------------------------------------

    def _baseline_row(self) -> BaselineRow:
        """Row of the baseline that was just closed."""
        state, rules = self._state, self._rules
        assert state.baseline is not None, "just closed"
        fitted = state.baseline.fitted
        indices = [found.set_index for found in state.healthy]
        p = len(FEATURE_NAMES)
        return BaselineRow(
            id=self._baseline_id,
            name=rules.baseline_name,
            position=self.position,
            first_set_index=indices[0] if indices else 0,
            last_set_index=rules.last_baseline_set,
            n_sets=len(indices),
            feature_names=list(FEATURE_NAMES),
            mean=[None] * p if fitted is None else fitted.mean.tolist(),
            covariance=[[None] * p] * p if fitted is None else fitted.covariance.tolist(),
            limit_f=state.baseline.limits.get(F_PREDICTIVE),
            limit_paper=state.baseline.limits.get(PAPER_MEAN_3SD),
            limit_reason=state.baseline.reason,
            limits=dict(state.baseline.limits) or None,
            readiness=readiness_of(state, rules),
            approval=self._approval,
            # Nobody approves what judges nothing.
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
        """Rows of the baseline's sets, with the distances that are known now."""
        state = self._state
        assert state.baseline is not None, "just closed"
        fitted = state.baseline.fitted
        distances = [None] * len(state.healthy) if fitted is None else fitted.distances_squared.tolist()
        return [
            self._assessment_row(
                found.set_index,
                found.due_h,
                SetAssessment(in_baseline=True, distance_squared=distance, reason="part of the baseline"),
            )
            for found, distance in zip(state.healthy, distances, strict=True)
        ]

    def _assessment_row(self, set_index: int, due_h: float, assessment: SetAssessment) -> AssessmentRow:
        baseline = self._state.baseline
        limits = {} if baseline is None else baseline.limits
        further = {name: v for name, v in assessment.statistics.items() if name not in (DISTANCE, CHART)}
        return AssessmentRow(
            set_index=set_index,
            position=self.position,
            due_h=due_h,
            baseline_id=None if baseline is None else self._baseline_id,
            in_baseline=assessment.in_baseline,
            distance_squared=assessment.distance_squared,
            limit_name=self._rules.limit if baseline is None else baseline.judging(self._rules.limit),
            limit_f=limits.get(F_PREDICTIVE),
            limit_paper=limits.get(PAPER_MEAN_3SD),
            outlier=assessment.outlier,
            outlier_paper=assessment.outlier_paper,
            reason=assessment.reason,
            contributions=None if assessment.contributions is None else dict(assessment.contributions),
            chart=assessment.statistics.get(CHART),
            chart_alarm=None if assessment.memory is None else assessment.memory.alarming,
            statistics=further or None,
            limits=dict(limits) or None,
            averages=_averages(assessment),
            cause=None if assessment.cause is None else assessment.cause.cause,
            cause_probability=None if assessment.cause is None else assessment.cause.probability,
            cause_told=None if assessment.cause is None else experiment_text(assessment.cause),
        )

    # Conditions ----------------------------------------------------------------------------------

    def _device_conditions(self, due: DueSet, mean: SetFeatures) -> list[Condition]:
        """Too few valid shots, set after set: first an alarm, then the transducer retires."""
        quality, poor = self._quality, self._state.poor_sets
        told = f"{poor} sets running with too few valid shots at {self.position} (last: {mean.reason})"
        check = "check coil, striker, sensor and cable"
        proof = {
            "set_index": due.set_index,
            "poor_sets_running": poor,
            "minimum_valid_shots": self._rules.minimum_valid_shots,
        }
        return [
            Condition(
                position=self.position,
                kind="no_data",
                severity="medium",
                present=poor >= quality.no_data_sets,
                message=f"{told}; {check}",
                proof=proof,
            ),
            Condition(
                position=self.position,
                kind="retired",
                severity="high",
                present=0 < quality.retire_after_sets <= poor,
                latched=True,
                message=f"{told}: the transducer strikes no more; {check}, then reinstate it",
                proof=proof,
            ),
        ]

    def _unjudged_condition(self, due: DueSet) -> Condition:
        baseline = self._state.baseline
        return Condition(
            position=self.position,
            kind="not_judged",
            severity="medium",
            present=baseline is not None and baseline.fitted is None,
            message=f"nothing is judged at {self.position}: {self.not_assessed_reason}",
            proof={"set_index": due.set_index, "baseline_id": self._baseline_id},
        )

    def _hole_condition(self, due: DueSet, features: Sequence[ShotFeatures]) -> Condition:
        rule = self._rules.hole
        silent = sum("no_psw" in found.flags for found in features)
        return Condition(
            position=self.position,
            kind="hole",
            family="damage",
            severity="critical",
            present=self._state.hole.hole,
            latched=True,
            message=(
                f"no reflected wave at {self.position} in {silent} of {len(features)} shots, "
                f"{rule.consecutive_sets} sets running: the wall has a hole or the chain lost contact; "
                "the transducer strikes no more"
            ),
            proof={
                "rule": {"shots": rule.shots, "consecutive_sets": rule.consecutive_sets},
                "set_index": due.set_index,
                "shots_without_psw": silent,
                "extractor_version": EXTRACTOR_VERSION,
            },
        )


def _stored(found: SetOfShots, row: AssessmentRow | None) -> SetAssessment | None:
    """Give a verdict as it was stored; None: the set belongs to the baseline, or was not judged."""
    if row is None or row.in_baseline:
        return None
    vector, memory, diagnosis_state = found.vector(), None, None
    if vector is not None and row.averages is not None:
        memory = ChartState(
            index=found.set_index,
            vector=vector,
            averages={name: tuple(row.averages[name]) for name in (AVERAGE, CHART)},
            alarming=bool(row.chart_alarm),
        )
        diagnosis_state = restored_diagnosis_state(row.averages)
    origin = None if row.cause is None else origin_of(row.averages or {}, row.cause)
    return SetAssessment(
        outlier=row.outlier,
        outlier_paper=row.outlier_paper,
        reason=row.reason,
        memory=memory,
        diagnosis_state=diagnosis_state,
        origin=origin,
    )


def _averages(assessment: SetAssessment) -> dict[str, list[float]] | None:
    """Give everything that is remembered as averages, by name."""
    of_charts = {} if assessment.memory is None else assessment.memory.averages
    kept = {name: list(average) for name, average in of_charts.items()}
    kept |= {} if assessment.diagnosis_state is None else averages_of(assessment.diagnosis_state)
    return kept | ({} if assessment.origin is None else kept_origin(assessment.origin)) or None


def _feature_row(due: DueSet, shot: Shot, found: ShotFeatures) -> FeatureRow:
    return FeatureRow(
        id=None,
        set_index=due.set_index,
        position=shot.key.position,
        shot_index=shot.key.shot_index,
        sequence=shot.sequence,
        due_h=due.due_h,
        extractor_version=EXTRACTOR_VERSION,
        quality=found.quality,
        n_valid=int(found.valid),
        **found.values(),
    )


def _set_feature_row(position: str, due: DueSet, mean: SetFeatures) -> FeatureRow:
    return FeatureRow(
        id=None,
        set_index=due.set_index,
        position=position,
        shot_index=None,
        sequence=None,
        due_h=due.due_h,
        extractor_version=EXTRACTOR_VERSION,
        quality=mean.quality,
        n_valid=mean.n_valid,
        **mean.mean,
    )
