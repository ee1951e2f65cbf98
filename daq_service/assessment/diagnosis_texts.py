"""Texts of a diagnosis for operators: observation and action."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from analysis.diagnosis.diagnose import UNDETERMINED, Diagnosis
from analysis.diagnosis.hypotheses import CAUSES, COUPLING, ENVIRONMENT, OK, SENSOR, WALL

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


def build_operator_texts(cause: str, abrupt: float) -> tuple[str, str]:
    """Return the observation and the recommended action of a diagnosis, as clauses for operators.

    Parameters
    ----------
    cause
        A key of `SENTENCES`.
    abrupt
        Probability of a step; above 0.5, an undetermined diagnosis has texts of its own.

    Raises
    ------
    KeyError
        There is no such diagnosis.
    """
    return ABRUPT if cause == UNDETERMINED and abrupt > 0.5 else SENTENCES[cause]


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
    """Return cause, probability in percent, observation and action as one text; empty if a part is missing.

    An undetermined diagnosis has no percentage.
    """
    if row_cause is None or details is None or probability is None:
        return ""
    # If undetermined, the probability is that of the likeliest cause, which is not shown.
    percent = f" ({100.0 * probability:.0f} %)" if row_cause in (OK, *CAUSES) else ""
    return f"{row_cause.upper()}{percent}: {details['sentence']}; {details['action']}"
