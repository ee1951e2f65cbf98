"""Diagnosis of a change for the recorder: the origin of an alarm, and texts for operators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analysis.diagnosis.diagnose import UNDETERMINED, Diagnosis, diagnosis_of, state_with_diagnosis
from analysis.diagnosis.hypotheses import CAUSES, COUPLING, ENVIRONMENT, OK, SENSOR, WALL
from analysis.diagnosis.parameters import DiagnosisParameters, diagnosis_parameters, logs_of
from analysis.diagnosis.slopes import COMPONENTS
from analysis.diagnosis.state import DiagnosisState, with_confirmation, with_set
from analysis.errors import SingularCovarianceError
from analysis.statistics.rules import MINIMUM_SETS

NOT_THE_WALL = frozenset({SENSOR, COUPLING, ENVIRONMENT})
"""A change with one of these diagnoses raises no wall alarm."""
ASKED_TWICE = frozenset({WALL, COUPLING})
"""Diagnoses that two consecutive sets or a confirmation set have confirmed."""

Values = Mapping[str, float | None]

SENTENCES: Mapping[str, tuple[str, str]] = {
    OK: ("the transducer is as in its baseline", "nothing to do"),
    WALL: (
        "the reflected wave has changed as under a thinning wall, and the incident wave has not",
        "have the wall inspected here",
    ),
    SENSOR: (
        "the incident wave has changed as by striker, beads, tilt or gain, which no wall does",
        "check striker, beads, sensor and cable; then record a new baseline",
    ),
    COUPLING: (
        "the waves have changed as by contacts that sit differently",
        "see how the chain stands on the wall, then record a new baseline",
    ),
    ENVIRONMENT: (
        "the waves have changed as by temperature",
        "compare with the temperature and with the other transducers; wait for a day",
    ),
    UNDETERMINED: (
        "something has changed, and no cause is sure",
        "treat it as the wall until it is known: compare with the control position, then inspect",
    ),
}
"""By diagnosis: observation and action."""
ABRUPT = (
    "something has changed from one set to the next",
    "abrupt: inspect the contact first; where it sits well, treat it as the wall",
)
"""In place of `UNDETERMINED` where a step is likelier than not."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Class of a transducer's change on which its alarm is based.

    Attributes
    ----------
    not_wall
        The diagnosis is one of `NOT_THE_WALL`.
    n_contrary
        Consecutive sets with a contrary diagnosis.
    """

    not_wall: bool = False
    n_contrary: int = 0


def next_origin(before: Origin, cause: str, *, was_active: bool, n: int) -> Origin:
    """Update the origin with the diagnosis of one more set; an uncertain diagnosis does not switch the alarm.

    Parameters
    ----------
    was_active
        The alarm was active before this set. Then only a confirmed diagnosis or n consecutive sets change
        its kind, and `OK` changes nothing.
    """
    if was_active and cause == OK:
        return before
    not_wall = cause in NOT_THE_WALL
    if not_wall == before.not_wall:
        return Origin(not_wall=not_wall)
    n_contrary = before.n_contrary + 1
    if not was_active or cause in ASKED_TWICE or n_contrary >= n:
        return Origin(not_wall=not_wall)
    return replace(before, n_contrary=n_contrary)


def fit_diagnosis_parameters(healthy: Sequence[tuple[int, Values]]) -> DiagnosisParameters | None:
    """Fit the parameters to a baseline's sets by index; None if too few, or a feature is constant."""
    logs = [(index, components) for index, values in healthy if (components := logs_of(values)) is not None]
    if len(logs) < MINIMUM_SETS:
        return None
    first = logs[0][0]
    history = np.full((logs[-1][0] - first + 1, len(COMPONENTS)), np.nan)
    for index, components in logs:
        history[index - first] = components
    try:
        return diagnosis_parameters(history, first)
    except SingularCovarianceError:
        return None


def diagnose_scheduled(
    memory: DiagnosisState, design: DiagnosisParameters, index: int, values: Values, *, suspicious: bool
) -> tuple[DiagnosisState, Diagnosis | None]:
    """Update the state with a scheduled set and diagnose; None if the set lacks a feature."""
    logs = logs_of(values)
    if logs is None:
        return memory, None
    return _diagnose(with_set(memory, design.mean, logs, index), design, suspicious=suspicious)


def diagnose_confirmation(
    memory: DiagnosisState, design: DiagnosisParameters, values: Values
) -> tuple[DiagnosisState, Diagnosis | None]:
    """Update the state with a confirmation set and diagnose; None if the set lacks a feature."""
    logs = logs_of(values)
    if logs is None:
        return memory, None
    return _diagnose(with_confirmation(memory, design.mean, logs), design, suspicious=True)


def _diagnose(
    memory: DiagnosisState, design: DiagnosisParameters, *, suspicious: bool
) -> tuple[DiagnosisState, Diagnosis]:
    assessment = diagnosis_of(memory, design, suspicious=suspicious)
    return state_with_diagnosis(memory, assessment), assessment


def operator_texts(cause: str, abrupt: float) -> tuple[str, str]:
    """Return observation and action of a diagnosis, for operators."""
    return ABRUPT if cause == UNDETERMINED and abrupt > 0.5 else SENTENCES[cause]


def diagnosis_details(assessment: Diagnosis) -> dict[str, Any]:
    """Return the details of a diagnosis for an assessment row, besides cause and probability."""
    sentence, action = operator_texts(assessment.cause, assessment.abrupt)
    return {
        "sentence": sentence,
        "action": action,
        "probabilities": dict(assessment.probabilities),
        "abrupt": assessment.abrupt,
        "changes": dict(assessment.changes),
        "confirmed": assessment.confirmed,
    }


def diagnosis_text(
    row_cause: str | None, probability: float | None, details: Mapping[str, Any] | None
) -> str:
    """Return cause, probability, observation and action as one text; empty if there is no diagnosis."""
    if row_cause is None or details is None or probability is None:
        return ""
    # If undetermined, the probability is that of the likeliest cause, which is not shown.
    percent = f" ({100.0 * probability:.0f} %)" if row_cause in (OK, *CAUSES) else ""
    return f"{row_cause.upper()}{percent}: {details['sentence']}; {details['action']}"
