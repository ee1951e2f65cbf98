"""From the features of a set to its verdict and to the conditions of alarms, one memory a position.

The memory holds what later sets are judged by: the baseline, the last verdicts, the sets without a
reflected wave. `restore` rebuilds it from catalogue rows, so a restarted recorder judges as the old
one would have. Nothing here reads a clock or a file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from analysis.errors import NotEnoughSetsError, SingularCovarianceError
from analysis.statistics.baseline import Baseline, fit_baseline
from analysis.statistics.distance import distance_squared, named_contributions
from analysis.statistics.limits import f_predictive_limit, paper_limit
from analysis.statistics.rules import (
    AlarmRule,
    AlarmState,
    HoleRule,
    HoleState,
    next_alarm_state,
    next_hole_state,
    next_poor_sets,
)
from analysis.waves.features import (
    EXTRACTOR_VERSION,
    FEATURE_NAMES,
    SetFeatures,
    ShotFeatures,
    extract_from_average,
    mean_features,
)
from analysis.waves.quality_gate import ACCEPTED
from daq_service.acquisition.schedule import DueSet
from daq_service.alarms.states import Condition
from daq_service.catalogue.rows import BaselineRow, FeatureRow, SetRow, ThicknessRow, VerdictRow, values
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import Shot

FORMULA = "D = (x - mean)^T K^-1 (x - mean), equation 16"


@dataclass(frozen=True, slots=True, kw_only=True)
class Assessment:
    """What a set says of one position: rows for the catalogue, conditions for the alarms.

    Attributes
    ----------
    baseline
        Row of a baseline that this set completed, else None.
    verdicts
        This set's row, and those of the baseline's sets when it was completed.
    shot_flags, invalid
        Flags of each record by its sequence, and the sequences of those without trustworthy features.
    note
        What the reader of the result should know, empty if nothing.
    """

    features: Sequence[FeatureRow] = ()
    thickness: Sequence[ThicknessRow] = ()
    baseline: BaselineRow | None = None
    verdicts: Sequence[VerdictRow] = ()
    conditions: Sequence[Condition] = ()
    n_valid: int = 0
    shot_flags: Mapping[int, Sequence[str]] = field(default_factory=dict)
    invalid: frozenset[int] = frozenset()
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Limits:
    """The two limits of a baseline, or why there are none."""

    f_predictive: float | None = None
    paper: float | None = None
    reason: str | None = None

    def by_name(self, name: str) -> float | None:
        return self.f_predictive if name == "f_predictive" else self.paper


@dataclass(slots=True, kw_only=True)
class _Memory:
    healthy: list[tuple[int, float, list[float]]] = field(default_factory=list)  # set, due_h, vector
    healthy_refused: int = 0
    baseline: Baseline | None = None
    baseline_id: int | None = None
    closed: bool = False
    limits: _Limits = field(default_factory=_Limits)
    alarm: AlarmState = field(default_factory=AlarmState)
    hole: HoleState = field(default_factory=HoleState)
    poor_sets: int = 0


class SolitaryWaveAssessor:
    """Judges the sets of one solitary-wave transducer.

    Parameters
    ----------
    last_baseline_set
        Index of the last set that belongs to the baseline.
    baseline_id
        Id that this position's baseline will have.
    """

    def __init__(
        self, position: str, settings: Settings, *, last_baseline_set: int, baseline_id: int
    ) -> None:
        self.position = position
        self._settings = settings
        self._last_baseline_set = last_baseline_set
        self._baseline_id = baseline_id
        self._alarm_rule = AlarmRule(k=settings.alarms.k, n=settings.alarms.n)
        self._hole_rule = HoleRule(
            shots=settings.alarms.hole_shots, consecutive_sets=settings.alarms.hole_sets
        )
        self._memory = _Memory()

    def restore(
        self,
        *,
        set_features: Sequence[FeatureRow],
        verdicts: Sequence[VerdictRow],
        baseline: BaselineRow | None,
        flags_by_set: Sequence[Sequence[Sequence[str]]],
        sets: Sequence[SetRow] = (),
    ) -> None:
        """Rebuild the memory from catalogue rows, all in the order of sets.

        Parameters
        ----------
        flags_by_set
            Flags of the accepted shots of the position's last sets (as many as the hole rule looks at,
            none from before it was last reinstated).
        sets
            Rows of the position's sets since it was last reinstated.
        """
        memory = _Memory()
        for row in set_features:
            if row.set_index <= self._last_baseline_set:
                self._remember_healthy(memory, row.set_index, row.due_h, row.quality, values(row))
        if baseline is not None:
            self._freeze(memory, baseline.name)
        for verdict in verdicts:
            if not verdict.in_baseline:
                memory.alarm = next_alarm_state(memory.alarm, verdict.outlier, self._alarm_rule)
        for flags in flags_by_set:
            memory.hole = next_hole_state(memory.hole, flags, self._hole_rule)
        for its_set in sets:
            n_tried = its_set.n_taken + its_set.n_missed - its_set.n_restrikes
            memory.poor_sets = self._poor_sets(memory, its_set.n_valid, n_tried)
        self._memory = memory

    def reinstate(self) -> None:
        """Forget what retired the transducer: a person says that it may strike again."""
        self._memory.hole = HoleState()
        self._memory.poor_sets = 0

    def assess(
        self,
        due: DueSet,
        shots: Sequence[Shot],
        features: Sequence[ShotFeatures],
        *,
        outcomes: Sequence[str] | None = None,
        n_tried: int | None = None,
    ) -> Assessment:
        """Judge one set.

        Parameters
        ----------
        shots, features
            What was taken, in order, every attempt.
        outcomes
            ``accepted`` or ``superseded`` for each of them (`quality_gate.outcomes`); None: all
            accepted. Only accepted shots are averaged and judged; all have rows.
        n_tried
            Shots that were struck, with or without a record; None: those that have one.
        """
        rows = [_feature_row(due, shot, found) for shot, found in zip(shots, features, strict=True)]
        outcomes = [ACCEPTED] * len(shots) if outcomes is None else outcomes
        accepted = [number for number, outcome in enumerate(outcomes) if outcome == ACCEPTED]
        counting = [features[number] for number in accepted]
        mean = self._set_features([shots[number] for number in accepted], counting)
        memory = self._memory
        tried = len({shot.key.shot_index for shot in shots}) if n_tried is None else n_tried
        memory.poor_sets = self._poor_sets(memory, mean.n_valid, tried)
        if not shots:
            return Assessment(conditions=self._device_conditions(due, mean), note=mean.reason)
        rows.append(_set_feature_row(self.position, due, mean))
        memory.hole = next_hole_state(memory.hole, [found.flags for found in counting], self._hole_rule)
        baseline_row, verdicts = self._verdicts(due, mean)
        # Strikes that come back without a reflection tell of the wall, not of the transducer.
        conditions = [] if memory.hole.sets_running else self._device_conditions(due, mean)
        conditions += [self._wall_condition(due, verdicts[-1]), self._hole_condition(due, counting)]
        return Assessment(
            features=rows,
            baseline=baseline_row,
            verdicts=verdicts,
            conditions=conditions,
            n_valid=mean.n_valid,
            shot_flags={shot.sequence: found.flags for shot, found in zip(shots, features, strict=True)},
            invalid=frozenset(
                shot.sequence for shot, found in zip(shots, features, strict=True) if not found.valid
            ),
            note=mean.reason,
        )

    def _set_features(self, shots: Sequence[Shot], features: Sequence[ShotFeatures]) -> SetFeatures:
        """Average the valid shots' features, or take those of their averaged record (the paper's way)."""
        mean = mean_features(features, self._settings.baseline.minimum_valid_shots)
        if self._settings.features.of_set == "mean_of_shots" or mean.quality == "bad":
            return mean
        valid = [shot.waveform for shot, found in zip(shots, features, strict=True) if found.valid]
        averaged = extract_from_average(valid)
        if not averaged.valid:
            return replace(mean, quality="bad", reason=f"the averaged record is {', '.join(averaged.flags)}")
        return replace(mean, mean=averaged.values())

    def _verdicts(self, due: DueSet, mean: SetFeatures) -> tuple[BaselineRow | None, list[VerdictRow]]:
        memory = self._memory
        if due.set_index > self._last_baseline_set and not memory.closed:
            # The last set of the baseline was missed: it ends here all the same.
            baseline_row, healthy = self._close_baseline()
            return baseline_row, [*healthy, self._judged(due, mean)]
        if due.set_index > self._last_baseline_set:
            return None, [self._judged(due, mean)]
        self._remember_healthy(memory, due.set_index, due.due_h, mean.quality, mean.mean)
        if due.set_index < self._last_baseline_set:
            return None, [
                self._row(due.set_index, due.due_h, in_baseline=True, reason="the baseline is being recorded")
            ]
        return self._close_baseline(last=due)

    def _remember_healthy(
        self, memory: _Memory, set_index: int, due_h: float, quality: str, values: Mapping[str, Any]
    ) -> None:
        vector = [values[name] for name in FEATURE_NAMES]
        if quality == "bad" or any(value is None or not math.isfinite(value) for value in vector):
            memory.healthy_refused += 1
        else:
            memory.healthy.append((set_index, due_h, [float(value) for value in vector]))

    def _freeze(self, memory: _Memory, name: str) -> None:
        """Fit the baseline from the remembered sets; the same sets always give the same bits."""
        memory.closed = True
        memory.baseline_id = self._baseline_id
        minimum = self._settings.baseline.minimum_sets
        try:
            if len(memory.healthy) < minimum:
                raise NotEnoughSetsError(
                    f"a baseline of {len(memory.healthy)} sets; baseline.minimum_sets asks for {minimum}: "
                    "let the baseline run longer"
                )
            memory.baseline = fit_baseline(
                np.array([vector for _, _, vector in memory.healthy]),
                [index for index, _, _ in memory.healthy],
                name=name,
            )
        except (NotEnoughSetsError, SingularCovarianceError) as error:
            memory.limits = _Limits(reason=str(error))
            return
        rate = self._settings.novelty.false_alarm_rate
        memory.limits = _Limits(
            f_predictive=f_predictive_limit(memory.baseline.n, memory.baseline.p, rate),
            paper=paper_limit(memory.baseline.distances_squared),
        )

    def _close_baseline(self, last: DueSet | None = None) -> tuple[BaselineRow, list[VerdictRow]]:
        """Row of the baseline, and the verdict rows of its sets with the distances now known."""
        memory = self._memory
        name = f"{self.position}-baseline-1"
        self._freeze(memory, name)
        healthy = memory.healthy
        fitted = memory.baseline
        indices = [index for index, _, _ in healthy]
        p = len(FEATURE_NAMES)
        row = BaselineRow(
            id=self._baseline_id,
            name=name,
            position=self.position,
            first_set_index=indices[0] if indices else 0,
            last_set_index=self._last_baseline_set,
            n_sets=len(indices),
            feature_names=list(FEATURE_NAMES),
            mean=[None] * p if fitted is None else fitted.mean.tolist(),
            covariance=[[None] * p] * p if fitted is None else fitted.covariance.tolist(),
            limit_f=memory.limits.f_predictive,
            limit_paper=memory.limits.paper,
            limit_reason=memory.limits.reason,
            approval=self._settings.baseline.approval,
            provenance={
                "set_indices": indices,
                "sets_left_out": memory.healthy_refused,
                "suspects": [] if fitted is None else list(fitted.suspects),
                "warnings": [] if fitted is None else list(fitted.warnings),
                "extractor_version": EXTRACTOR_VERSION,
                "false_alarm_rate": self._settings.novelty.false_alarm_rate,
            },
        )
        distances = [None] * len(healthy) if fitted is None else fitted.distances_squared.tolist()
        rows = [
            self._row(index, due_h, in_baseline=True, distance=distance, reason="part of the baseline")
            for (index, due_h, _), distance in zip(healthy, distances, strict=True)
        ]
        if last is not None and (not indices or indices[-1] != last.set_index):
            rows.append(
                self._row(
                    last.set_index,
                    last.due_h,
                    in_baseline=True,
                    reason="left out of the baseline: too few valid shots",
                )
            )
        return row, rows

    def _judged(self, due: DueSet, mean: SetFeatures) -> VerdictRow:
        memory = self._memory
        if memory.baseline is None:
            return self._row(due.set_index, due.due_h, reason=memory.limits.reason)
        vector = mean.vector()
        if mean.quality == "bad" or not np.isfinite(vector).all():
            memory.alarm = next_alarm_state(memory.alarm, None, self._alarm_rule)
            return self._row(due.set_index, due.due_h, reason=mean.reason or "a feature is not available")
        distance = float(distance_squared(vector, memory.baseline))
        row = self._row(
            due.set_index,
            due.due_h,
            distance=distance,
            contributions=named_contributions(vector, memory.baseline),
        )
        memory.alarm = next_alarm_state(memory.alarm, row.outlier, self._alarm_rule)
        return row

    def _row(
        self,
        set_index: int,
        due_h: float,
        *,
        in_baseline: bool = False,
        distance: float | None = None,
        reason: str | None = None,
        contributions: Mapping[str, float] | None = None,
    ) -> VerdictRow:
        memory = self._memory
        name = self._settings.novelty.limit
        return VerdictRow(
            set_index=set_index,
            position=self.position,
            due_h=due_h,
            baseline_id=memory.baseline_id,
            in_baseline=in_baseline,
            distance_squared=distance,
            limit_name=name,
            limit_f=memory.limits.f_predictive,
            limit_paper=memory.limits.paper,
            outlier=None if in_baseline else _beyond(distance, memory.limits.by_name(name)),
            outlier_paper=None if in_baseline else _beyond(distance, memory.limits.paper),
            reason=reason,
            contributions=None if contributions is None else dict(contributions),
        )

    def _poor_sets(self, memory: _Memory, n_valid: int, n_tried: int) -> int:
        """Count the sets running with too few valid shots, after one with these numbers."""
        return next_poor_sets(
            memory.poor_sets,
            n_valid=n_valid,
            n_tried=n_tried,
            n_planned=self._settings.schedule.shots_per_set,
            minimum_valid=self._settings.baseline.minimum_valid_shots,
        )

    def _device_conditions(self, due: DueSet, mean: SetFeatures) -> list[Condition]:
        """Too few valid shots, set after set: first an alarm, then the transducer retires."""
        quality, poor = self._settings.quality, self._memory.poor_sets
        told = f"{poor} sets running with too few valid shots at {self.position} (last: {mean.reason})"
        check = "check coil, striker, sensor and cable"
        proof = {
            "set_index": due.set_index,
            "poor_sets_running": poor,
            "minimum_valid_shots": self._settings.baseline.minimum_valid_shots,
        }
        return [
            Condition(
                position=self.position,
                kind="no_data",
                family="device",
                severity="medium",
                present=poor >= quality.no_data_sets,
                message=f"{told}; {check}",
                proof=proof,
            ),
            Condition(
                position=self.position,
                kind="retired",
                family="device",
                severity="high",
                present=0 < quality.retire_after_sets <= poor,
                latched=True,
                message=f"{told}: the transducer strikes no more; {check}, then reinstate it",
                proof=proof,
            ),
        ]

    def _wall_condition(self, due: DueSet, verdict: VerdictRow) -> Condition:
        state, rule = self._memory.alarm, self._alarm_rule
        limit = self._memory.limits.by_name(self._settings.novelty.limit)
        return Condition(
            position=self.position,
            kind="wall_change",
            family="damage",
            severity="high",
            present=state.active,
            message=(
                f"{sum(state.recent)} of the last {len(state.recent)} judged sets at {self.position} lie "
                f"beyond the limit of {limit:.1f} (rule: {rule.k} of {rule.n}): wall or transducer has "
                "changed; inspect"
                if state.active and limit is not None
                else ""
            ),
            proof={
                "formula": FORMULA,
                "rule": {"k": rule.k, "n": rule.n},
                "set_index": due.set_index,
                "distance_squared": verdict.distance_squared,
                "limit_name": verdict.limit_name,
                "limit": limit,
                "baseline_id": verdict.baseline_id,
                "contributions": verdict.contributions,
                "extractor_version": EXTRACTOR_VERSION,
            },
        )

    def _hole_condition(self, due: DueSet, features: Sequence[ShotFeatures]) -> Condition:
        rule = self._hole_rule
        silent = sum("no_psw" in found.flags for found in features)
        return Condition(
            position=self.position,
            kind="hole",
            family="damage",
            severity="critical",
            present=self._memory.hole.hole,
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


def _beyond(distance: float | None, limit: float | None) -> bool | None:
    return None if distance is None or limit is None else distance > limit


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
