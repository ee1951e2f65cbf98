"""What a change comes from, for the recorder: memory of `analysis.diagnosis`, and words for operators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analysis.diagnosis.diagnose import UNDETERMINED, Diagnosis, diagnosis_of, state_with_diagnosis
from analysis.diagnosis.hypotheses import CAUSES, COUPLING, ENVIRONMENT, OK, SENSOR, WALL
from analysis.diagnosis.parameters import DiagnosisParameters, diagnosis_parameters, logs_of
from analysis.diagnosis.slopes import COMPONENTS
from analysis.diagnosis.state import RATES, DiagnosisState, with_confirmation, with_set
from analysis.errors import SingularCovarianceError
from analysis.statistics.rules import MINIMUM_SETS

NOT_THE_WALL = frozenset({SENSOR, COUPLING, ENVIRONMENT})
"""A change that surely comes from one of these is no alarm of the wall."""
ASKED_TWICE = frozenset({WALL, COUPLING})
"""Causes that two sets running or a confirmation set have named."""

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
"""By cause: what is seen, and what to do."""
ABRUPT = (
    "something has changed from one set to the next",
    "abrupt: inspect the contact first; where it sits well, treat it as the wall",
)
"""In place of `UNDETERMINED` where a step is likelier than not."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Where the change of a transducer comes from, as its alarm tells it.

    Attributes
    ----------
    elsewhere
        From one of `NOT_THE_WALL`.
    otherwise
        Sets running whose cause says otherwise.
    """

    elsewhere: bool = False
    otherwise: int = 0


def next_origin(before: Origin, cause: str, *, stood: bool, n: int) -> Origin:
    """Take in the cause of one more set, so that no alarm changes its kind with each set of an unsure cause.

    Parameters
    ----------
    stood
        An alarm of the change stood before this set: then only what was asked twice, or n sets running,
        make it another one, and `OK` says nothing.
    """
    if stood and cause == OK:
        return before
    says = cause in NOT_THE_WALL
    if says == before.elsewhere:
        return Origin(elsewhere=says)
    otherwise = before.otherwise + 1
    if not stood or cause in ASKED_TWICE or otherwise >= n:
        return Origin(elsewhere=says)
    return replace(before, otherwise=otherwise)


def averages_of(memory: DiagnosisState) -> dict[str, list[float]]:
    """Give what is remembered as averages by name, beside those of the charts."""
    changes = {name: list(change) for name, change in zip(_NAMES, memory.changes, strict=True)}
    index = -1 if memory.index is None else memory.index
    found = {
        _COUNT: [float(memory.n), float(memory.wall), float(memory.likely)],
        **changes,
        _PLACE: [float(number) for number in (index, memory.gap, memory.gap_ago, memory.confirmation_ago)],
    }
    if memory.confirmation:
        found[_CONFIRMATION] = list(memory.confirmation)
    return found | ({_MOVED: list(memory.moved)} if memory.moved else {})


_COUNT, _PLACE, _CONFIRMATION, _MOVED = "changes_count", "changes_place", "changes_beside", "changes_moved"
_ORIGIN = "origin"
_NAMES = tuple(f"changes_{rate:g}" for rate in RATES)


def restored_diagnosis_state(averages: Mapping[str, Sequence[float]]) -> DiagnosisState | None:
    """Give back what `averages_of` gave; None: an earlier version kept none."""
    if _COUNT not in averages:
        return None
    n, wall, *likely = averages[_COUNT]  # an earlier version kept two
    index, gap, gap_ago, confirmation_ago = (int(number) for number in averages.get(_PLACE, (-1, 0, 0, 0)))
    return DiagnosisState(
        n=int(n),
        wall=bool(wall),
        likely=likely == [1.0],
        changes=tuple(tuple(averages[name]) for name in _NAMES),
        index=None if index < 0 else index,
        gap=gap,
        gap_ago=gap_ago,
        confirmation=tuple(averages.get(_CONFIRMATION, ())),
        confirmation_ago=confirmation_ago,
        moved=tuple(averages.get(_MOVED, ())),
    )


def kept_origin(origin: Origin) -> dict[str, list[float]]:
    """Give what is kept of it, beside the averages."""
    return {_ORIGIN: [float(origin.elsewhere), float(origin.otherwise)]}


def origin_of(averages: Mapping[str, Sequence[float]], cause: str) -> Origin:
    """Give back what `kept_origin` gave; an earlier version kept none, and went by the last cause."""
    if _ORIGIN not in averages:
        return Origin(elsewhere=cause in NOT_THE_WALL)
    elsewhere, otherwise = averages[_ORIGIN]
    return Origin(elsewhere=bool(elsewhere), otherwise=int(otherwise))


def design_of_causes(healthy: Sequence[tuple[int, Values]]) -> DiagnosisParameters | None:
    """Design from a baseline's sets and their indices; None: too few, or a feature is constant."""
    logs = [(index, found) for index, values in healthy if (found := logs_of(values)) is not None]
    if len(logs) < MINIMUM_SETS:
        return None
    first = logs[0][0]
    history = np.full((logs[-1][0] - first + 1, len(COMPONENTS)), np.nan)
    for index, found in logs:
        history[index - first] = found
    try:
        return diagnosis_parameters(history, first)
    except SingularCovarianceError:
        return None


def cause_after(
    memory: DiagnosisState, design: DiagnosisParameters, index: int, values: Values, *, suspicious: bool
) -> tuple[DiagnosisState, Diagnosis | None]:
    """Take in one more set of the plan and say what the sets so far mean; None: it lacks a feature."""
    logs = logs_of(values)
    if logs is None:
        return memory, None
    return _said(with_set(memory, design.mean, logs, index), design, suspicious=suspicious)


def cause_confirmed(
    memory: DiagnosisState, design: DiagnosisParameters, values: Values
) -> tuple[DiagnosisState, Diagnosis | None]:
    """Take in a set struck beside the plan because of the last planned ones, and say what they mean now."""
    logs = logs_of(values)
    if logs is None:
        return memory, None
    return _said(with_confirmation(memory, design.mean, logs), design, suspicious=True)


def _said(
    memory: DiagnosisState, design: DiagnosisParameters, *, suspicious: bool
) -> tuple[DiagnosisState, Diagnosis]:
    assessment = diagnosis_of(memory, design, suspicious=suspicious)
    return state_with_diagnosis(memory, assessment), assessment


def words_of(cause: str, abrupt: float) -> tuple[str, str]:
    """Say for operators what is seen and what to do."""
    return ABRUPT if cause == UNDETERMINED and abrupt > 0.5 else SENTENCES[cause]


def experiment_text(assessment: Diagnosis) -> dict[str, Any]:
    """Give what stands in a verdict's row beside cause and probability."""
    sentence, action = words_of(assessment.cause, assessment.abrupt)
    return {
        "sentence": sentence,
        "action": action,
        "probabilities": dict(assessment.probabilities),
        "abrupt": assessment.abrupt,
        "changes": dict(assessment.changes),
        "confirmed": assessment.confirmed,
    }


def said(row_cause: str | None, probability: float | None, told: Mapping[str, Any] | None) -> str:
    """Say cause, probability, sentence and action in one; empty where nothing is known."""
    if row_cause is None or told is None or probability is None:
        return ""
    # Of what cannot be told the probability is that of the likeliest cause, which is not named.
    sure = f" ({100.0 * probability:.0f} %)" if row_cause in (OK, *CAUSES) else ""
    return f"{row_cause.upper()}{sure}: {told['sentence']}; {told['action']}"
