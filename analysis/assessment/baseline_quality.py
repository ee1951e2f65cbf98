"""Quality of a baseline, as stored with it: size, autocorrelation, tail factor and anomalies."""

from __future__ import annotations

import numpy as np

from analysis.assessment.step import Rules, State
from analysis.statistics.baseline import ADVISED_SETS
from analysis.statistics.baseline_check import Anomaly, find_anomalies

GOOD_SETS = 200
"""From this number on, the chart has its full sensitivity and slow drift is measurable."""

ALIKE = "a feature is the same in most of its sets: anomalies among them cannot be found"


def advise_on_baseline(n_sets: int) -> str | None:
    """Return the advice (English text) to extend a baseline of ``n_sets`` sets; None from 200 sets on.

    Below 48 sets it also warns that the false-alarm rate is uncertain.
    """
    if n_sets >= GOOD_SETS:
        return None
    warned = f"fewer than {ADVISED_SETS} sets: the rate of false alarms is uncertain; "
    few = warned if n_sets < ADVISED_SETS else ""
    return f"{few}{GOOD_SETS} sets and more are advised, {n_sets} are there"


def assess_baseline(state: State, rules: Rules) -> dict[str, object] | None:
    """Return the quality of a frozen baseline as a JSON object; None if it has no fit or no chart parameters.

    It holds the numbers of sets used, left out and effective, autocorrelation, tail factor, advice, the
    anomalies (``named``, by set index), the reason for the default limit, the design false-alarm rate, and
    whether that rate is verified, else why not.
    """
    baseline = state.baseline
    if baseline is None or baseline.fitted is None or baseline.design is None:
        return None
    design, indices = baseline.design, baseline.fitted.set_indices
    shortcoming, anomalies = advise_on_baseline(baseline.fitted.n), _find_anomalies(state)
    if anomalies is None:
        shortcoming = f"{shortcoming + '; ' if shortcoming else ''}{ALIKE}"
    return {
        "n": baseline.fitted.n,
        "n_left_out": state.n_left_out,
        "advice": shortcoming,
        "n_eff": design.n_eff,
        "phi_pooled": design.phi_pooled,
        "tail": design.by_default.tail,
        "named": [
            {"kind": anomaly.kind, "set_indices": [indices[row] for row in anomaly.rows]}
            for anomaly in anomalies or ()
        ],
        "default_reason": design.by_default.reason,
        "false_alarms_per_sensor_year": rules.false_alarms_per_sensor_year,
        "rate_verified": not design.rate_not_verified_reason,
        "rate_not_verified_reason": design.rate_not_verified_reason or None,
    }


def _find_anomalies(state: State) -> tuple[Anomaly, ...] | None:
    """Find the anomalies among a state's baseline sets; None if the covariance of most sets is singular.

    Rows of an anomaly are indices into ``state.healthy``.
    """
    try:
        return find_anomalies(np.array([healthy_set.vector() for healthy_set in state.healthy]))
    except np.linalg.LinAlgError:  # as of records that are played back again and again
        return None
