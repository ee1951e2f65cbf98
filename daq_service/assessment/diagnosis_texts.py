"""Texts of a diagnosis for operators: observation and action."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from analysis.diagnosis.diagnose import UNDETERMINED, Diagnosis
from analysis.diagnosis.hypotheses import CAUSES, OK
from daq_service.alarms.states import TEXTS, format_probability


def build_operator_texts(cause: str, abrupt: float) -> tuple[str, str]:
    """Return the observation and the recommended action of a diagnosis, as clauses for operators.

    Parameters
    ----------
    cause
        A key of the table ``diagnoses``.
    abrupt
        Probability of a step; above 0.5, an undetermined diagnosis has texts of its own.

    Raises
    ------
    KeyError
        There is no such diagnosis.
    """
    observation, action = TEXTS["diagnoses"]["abrupt" if cause == UNDETERMINED and abrupt > 0.5 else cause]
    return observation, action


def build_diagnosis_details(assessment: Diagnosis) -> dict[str, Any]:
    """Return the details of a diagnosis for an assessment row: texts, probabilities, changes, confirmation.

    ``probabilities`` are by cause, ``abrupt`` is the probability of a step. Cause and its probability have
    columns of their own. Raise KeyError for an unknown cause.
    """
    sentence, action = build_operator_texts(assessment.cause, assessment.abrupt)
    return {
        "sentence": sentence,
        "action": action,
        "probabilities": dict(assessment.probabilities),
        "abrupt": assessment.abrupt,
        "changes": dict(assessment.changes),
        "confirmed": assessment.confirmed,
    }


def format_diagnosis(
    row_cause: str | None, probability: float | None, details: Mapping[str, Any] | None
) -> str:
    """Return cause, model probability, observation and action as one text; empty if a part is missing.

    An undetermined diagnosis has no percentage.
    """
    if row_cause is None or details is None or probability is None:
        return ""
    # If undetermined, the probability is that of the likeliest cause, which is not shown.
    percent = f" (model: {format_probability(probability)})" if row_cause in (OK, *CAUSES) else ""
    return f"{row_cause.upper()}{percent}: {details['sentence']}; {details['action']}"
