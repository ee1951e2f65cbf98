"""Confirmation sets of a transducer: when a set requests one, and whether it confirms the change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.assessment.step import AssessedSet, Rules, SetAssessment, State, is_wall_alarm_active
from analysis.statistics.baseline import Baseline
from analysis.statistics.distance import distance_squared

ALARM = "the change of the wall became an alarm with it"
STEP = "it is the first set above the limit"


def explain_confirmation_request(before: State, after: State, assessment: SetAssessment, rules: Rules) -> str:
    """Return why a scheduled set requests a confirmation set (English text); empty if it requests none.

    A set requests one when it is an outlier after `alarms.n` sets without one, and when the wall alarm
    becomes active. Each requests again only after its condition has returned to normal (hysteresis).
    ``before`` and ``after`` are the states before and after the set.
    """
    if assessment.in_baseline or assessment.outlier is None:
        return ""
    if is_wall_alarm_active(after, rules) and not is_wall_alarm_active(before, rules):
        return ALARM
    return STEP if assessment.outlier and not any(before.alarm.recent) else ""


def confirms_change(
    assessed: Sequence[AssessedSet], baseline: Baseline, vector: Sequence[float]
) -> bool | None:
    """Check whether a confirmation set is nearer to the suspect scheduled sets than to the baseline.

    Both are normal populations with the baseline's covariance; the likelier one has the nearer mean by the
    Mahalanobis distance.
    Return None if no scheduled set was assessed.

    Parameters
    ----------
    assessed
        The last scheduled sets, at most n. Suspect are those above the limit; if none is, all of them,
        because the chart has detected a change that no single set shows.
    vector
        The confirmation set's five features.
    """
    suspects = [assessed_set.vector for assessed_set in assessed if assessed_set.outlier] or [
        assessed_set.vector for assessed_set in assessed
    ]
    if not suspects:
        return None
    shift = np.mean(np.array(suspects), axis=0) - baseline.mean
    features = np.array(vector)
    from_baseline, from_suspects = distance_squared(np.stack([features, features - shift]), baseline)
    return bool(from_suspects < from_baseline)
