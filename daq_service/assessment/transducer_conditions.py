"""Conditions of a transducer's alarms: messages and evidence.

The control chart or the diagnosis WALL raises `wall_change` and `transducer_change`; or k of n sets above a
limit, as configured. Where a baseline has no chart, k of n always decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from analysis.assessment.step import Rules, State, wall_alarm_active
from analysis.diagnosis.hypotheses import WALL
from analysis.statistics.design import Design, contributions_of
from analysis.statistics.named_limits import DISTANCE, LIMITS, MEWMA
from analysis.statistics.rules import HoleRule
from analysis.waves.features import EXTRACTOR_VERSION
from daq_service.alarms.states import Condition
from daq_service.assessment.diagnosis_texts import diagnosis_text
from daq_service.catalogue.rows import AssessmentRow
from daq_service.settings.tree import QualitySettings
from hardware_drivers.measurement import DueSet

FORMULA = "D = (x - mean)^T K^-1 (x - mean), equation 16"
CHART_FORMULA = (
    "T = (2 - w)/w |z|^2, z = w u + (1 - w) z of the set before, w = 0.1; u: what is new in the set, "
    "whitened, cut back to the F limit of 1 %"
)
BY_DIAGNOSIS = "diagnosis"
"""Value of ``raised_by`` if the diagnosis raised the alarm."""
REMEDY = "wall or transducer has changed; inspect"


def wall_conditions(position: str, state: State, rules: Rules, assessment: AssessmentRow) -> list[Condition]:
    """Return the conditions of both alarms after a set; ``assessment`` is the row of that set.

    A change with a diagnosis other than the wall raises the transducer alarm; an undetermined one raises the
    wall alarm (`diagnosis.next_origin`).
    """
    design = None if state.baseline is None else state.baseline.design
    if rules.decides_by == "chart" and design is not None and state.memory is not None:
        present, times_limit, message, evidence = _by_chart(position, design, state, rules, assessment)
    else:
        present, times_limit, message, evidence = _by_k_of_n(position, state, rules, assessment)
    if assessment.diagnosis is None:
        message += REMEDY
    else:
        message += diagnosis_text(
            assessment.diagnosis, assessment.diagnosis_probability, assessment.diagnosis_details
        )
    not_wall = state.origin.not_wall
    wall = Condition(
        position=position,
        kind="wall_change",
        alarm_class="damage",
        priority="high",
        present=present and not not_wall,
        times_limit=times_limit,
        known=WALL if assessment.diagnosis == WALL else "",
        message=message if present else "",
        evidence=evidence | _common_evidence(assessment),
    )
    transducer = replace(
        wall,
        kind="transducer_change",
        known="",
        alarm_class="diagnostic",
        priority="medium",
        present=present and not_wall,
    )
    return [wall, transducer]


def _common_evidence(assessment: AssessmentRow) -> dict[str, Any]:
    """Return the evidence that every alarm of a signal change has."""
    return {
        "set_index": assessment.set_index,
        "distance_squared": assessment.distance_squared,
        "baseline_id": assessment.baseline_id,
        "extractor_version": EXTRACTOR_VERSION,
        "diagnosis": assessment.diagnosis,
        "diagnosis_probability": assessment.diagnosis_probability,
        "diagnosis_details": assessment.diagnosis_details,
    }


def describe_rate(design: Design, budget: float) -> str:
    """Describe the design false-alarm rate of the chart for a healthy sensor."""
    rate = f"{budget:g} false alarms a year"
    return (
        f"{rate}, not promised: {design.rate_not_verified_reason}"
        if design.rate_not_verified_reason
        else rate
    )


AlarmBasis = tuple[bool, float | None, str, dict[str, Any]]
"""Presence of the condition, multiple of the limit, first part of the message, and evidence."""


def _by_chart(
    position: str, design: Design, state: State, rules: Rules, assessment: AssessmentRow
) -> AlarmBasis:
    """Return the basis of the wall alarm if the control chart decides."""
    memory = state.memory
    assert memory is not None, "checked by the caller"
    limit, average = design.limits[MEWMA], np.array(memory.averages[MEWMA])
    parts = contributions_of(average)
    statistic = float(parts.sum())
    budget = rules.false_alarms_per_sensor_year
    message = (
        f"the chart of {position} stands at {statistic:.1f}, beyond its limit of {limit:.1f} "
        f"({describe_rate(design, budget)}): "
        if memory.alarming
        else f"the cause of a change at {position} is named, while the chart stands at {statistic:.1f}, "
        f"below its limit of {limit:.1f}: "
    )
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
    return wall_alarm_active(state, rules), statistic / limit, message, evidence


def _by_k_of_n(position: str, state: State, rules: Rules, assessment: AssessmentRow) -> AlarmBasis:
    """Return the basis of the wall alarm if k outliers of n sets decide."""
    alarm, rule = state.alarm, rules.alarm
    statistics = {
        DISTANCE: assessment.distance_squared,
        MEWMA: assessment.mewma_statistic,
        **(assessment.statistics or {}),
    }
    value = statistics.get(LIMITS[assessment.limit_name].of)
    limit = (assessment.limits or {}).get(assessment.limit_name)
    message = (
        f"{sum(alarm.recent)} of the last {len(alarm.recent)} judged sets at {position} lie beyond the limit "
        f"of {limit or 0.0:.1f} (rule: {rule.k} of {rule.n}): "
    )
    evidence = {
        "formula": FORMULA,
        "rule": {"k": rule.k, "n": rule.n},
        "limit_name": assessment.limit_name,
        "limit": limit,
        "contributions": assessment.contributions,
    }
    times_limit = None if value is None or limit is None else value / limit
    return alarm.active, times_limit, message, evidence


def hole_condition(
    position: str, due: DueSet, state: State, rule: HoleRule, flags: Sequence[Sequence[str]]
) -> Condition:
    """Return the condition of a wall without reflected wave; ``flags`` of each accepted shot."""
    n_without_psw = sum("no_psw" in of_shot for of_shot in flags)
    return Condition(
        position=position,
        kind="no_reflection",
        alarm_class="damage",
        priority="critical",
        present=state.hole.hole,
        latched=True,
        message=(
            f"no reflected wave at {position} in {n_without_psw} of {len(flags)} shots, "
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


def device_conditions(
    position: str, due: DueSet, state: State, rules: Rules, quality: QualitySettings, reason: str
) -> list[Condition]:
    """Return the conditions of too few valid shots: first an alarm, later the transducer is disabled.

    Parameters
    ----------
    reason
        Why the set's feature is bad or suspect.
    """
    poor = state.poor_sets
    finding = f"{poor} sets running with too few valid shots at {position} (last: {reason})"
    action = "check coil, striker, sensor and cable"
    few_valid_shots = Condition(
        position=position,
        kind="few_valid_shots",
        priority="medium",
        present=poor >= quality.no_data_sets,
        message=f"{finding}; {action}",
        evidence={
            "set_index": due.set_index,
            "consecutive_poor_sets": poor,
            "minimum_valid_shots": rules.minimum_valid_shots,
        },
    )
    disabled = replace(
        few_valid_shots,
        kind="transducer_disabled",
        priority="high",
        present=0 < quality.retire_after_sets <= poor,
        latched=True,
        message=f"{finding}: the transducer strikes no more; {action}, then enable it",
    )
    return [few_valid_shots, disabled]


def not_assessed_reason(state: State) -> str:
    """Return why a set cannot be compared with a baseline; empty if it can."""
    if state.baseline is None:
        return "it has no baseline yet; wait until it is recorded"
    return state.baseline.reason or ""


def not_assessed_condition(position: str, due: DueSet, state: State, baseline_id: int) -> Condition:
    """Return the condition of a frozen baseline without limits."""
    return Condition(
        position=position,
        kind="not_assessed",
        priority="medium",
        present=state.baseline is not None and state.baseline.fitted is None,
        message=f"nothing is judged at {position}: {not_assessed_reason(state)}",
        evidence={"set_index": due.set_index, "baseline_id": baseline_id},
    )
