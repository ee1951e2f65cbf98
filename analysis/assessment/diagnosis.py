"""Diagnosis of a transducer's sets, and the class of the change on which its alarm is based."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.diagnosis.diagnose import Diagnosis, add_diagnosis, diagnose_latest_set
from analysis.diagnosis.hypotheses import COUPLING, ENVIRONMENT, OK, SENSOR, WALL
from analysis.diagnosis.parameters import DiagnosisParameters, compute_diagnosis_parameters, log_features
from analysis.diagnosis.slopes import COMPONENTS
from analysis.diagnosis.state import DiagnosisState, add_confirmation_set, add_set
from analysis.errors import SingularCovarianceError
from analysis.statistics.rules import MINIMUM_SETS

NOT_THE_WALL = frozenset({SENSOR, COUPLING, ENVIRONMENT})
"""A change with one of these diagnoses raises no wall alarm."""
ASKED_TWICE = frozenset({WALL, COUPLING})
"""Diagnoses that two consecutive sets or a confirmation set have confirmed."""

Values = Mapping[str, float | None]


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


def update_origin(before: Origin, cause: str, *, was_active: bool, n: int) -> Origin:
    """Return the class of a transducer's change (wall or not) after the diagnosis ``cause`` of one more set.

    While the alarm is inactive, the diagnosis sets the class. While it was active before this set
    (``was_active``), only WALL, COUPLING or the n-th consecutive contrary diagnosis changes the class, and
    `OK` changes nothing.
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
    """Fit the diagnosis parameters to a baseline's sets; None for fewer than 15 complete ones.

    ``healthy`` holds schedule index and features of each set, in the order of time. Return None also if a
    feature is constant or a combination of others.
    """
    logs = [
        (index, components) for index, values in healthy if (components := log_features(values)) is not None
    ]
    if len(logs) < MINIMUM_SETS:
        return None
    first = logs[0][0]
    history = np.full((logs[-1][0] - first + 1, len(COMPONENTS)), np.nan)
    for index, components in logs:
        history[index - first] = components
    try:
        return compute_diagnosis_parameters(history, first)
    except SingularCovarianceError:
        return None


def diagnose_scheduled(
    memory: DiagnosisState,
    design: DiagnosisParameters,
    index: int,
    values: Values,
    *,
    suspicious: bool,
    lost_probability: float = 0.0,
) -> tuple[DiagnosisState, Diagnosis | None]:
    """Add a scheduled set to the diagnosis state and diagnose it; return the next state and the diagnosis.

    ``suspicious`` and ``lost_probability`` are those of `diagnose_latest_set`. If a feature is missing or
    not positive, return the state unchanged and None.
    """
    logs = log_features(values)
    if logs is None:
        return memory, None
    memory = add_set(memory, design.mean, logs, index)
    return _diagnose_newest_set(memory, design, lost_probability, suspicious=suspicious)


def diagnose_confirmation(
    memory: DiagnosisState, design: DiagnosisParameters, values: Values, lost_probability: float = 0.0
) -> tuple[DiagnosisState, Diagnosis | None]:
    """Add a confirmation set to the diagnosis state and diagnose it; return next state and diagnosis.

    ``lost_probability`` is that of `diagnose_latest_set`. If a feature is missing or not positive, return
    the state unchanged and None.
    """
    logs = log_features(values)
    if logs is None:
        return memory, None
    memory = add_confirmation_set(memory, design.mean, logs)
    return _diagnose_newest_set(memory, design, lost_probability, suspicious=True)


def _diagnose_newest_set(
    memory: DiagnosisState, design: DiagnosisParameters, lost_probability: float, *, suspicious: bool
) -> tuple[DiagnosisState, Diagnosis]:
    """Diagnose the latest set in the state; return the state for the next set, and the diagnosis."""
    assessment = diagnose_latest_set(memory, design, suspicious=suspicious, lost_probability=lost_probability)
    return add_diagnosis(memory, assessment), assessment
