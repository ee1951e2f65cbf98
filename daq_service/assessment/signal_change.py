"""Conditions of the alarms `wall_change` and `transducer_change`: messages and evidence.

The control chart or the diagnosis WALL raises them; or k of n sets above a limit, as configured. Where a
baseline has no chart, k of n always decides.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from analysis.assessment.step import Rules, State, wall_alarm_active
from analysis.diagnosis.hypotheses import WALL
from analysis.statistics.design import Design, contributions_of
from analysis.statistics.named_limits import CHART
from analysis.waves.features import EXTRACTOR_VERSION
from daq_service.alarms.states import Condition
from daq_service.assessment.diagnosis_texts import diagnosis_text
from daq_service.assessment.stored_limits import limits_by_name, statistic_of
from daq_service.catalogue.rows import AssessmentRow

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
    message += (
        diagnosis_text(assessment.diagnosis, assessment.diagnosis_probability, assessment.diagnosis_details)
        or REMEDY
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
    memory = state.memory
    assert memory is not None, "checked by the caller"
    limit, average = design.limits[CHART], np.array(memory.averages[CHART])
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
        "raised_by": CHART if memory.alarming else BY_DIAGNOSIS,
        "mewma_statistic": statistic,
        "limit_name": CHART,
        "limit": limit,
        "contributions": dict(zip(design.baseline.feature_names, parts.tolist(), strict=True)),
        "rate_verified": not design.rate_not_verified_reason,
        "rate_not_verified_reason": design.rate_not_verified_reason or None,
    }
    return wall_alarm_active(state, rules), statistic / limit, message, evidence


def _by_k_of_n(position: str, state: State, rules: Rules, assessment: AssessmentRow) -> AlarmBasis:
    alarm, rule = state.alarm, rules.alarm
    limit, value = (
        limits_by_name(assessment).get(assessment.limit_name),
        statistic_of(assessment, assessment.limit_name),
    )
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
