"""How far a baseline can be trusted, as it is stored with it: size, memory, tails, what stands out of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from analysis.statistics.baseline import ADVISED_SETS
from analysis.statistics.baseline_check import Anomaly, find_anomalies
from daq_service.assessment.solitary_wave_step import Rules, State

GOOD_SETS = 200
"""From so many on the chart sees what it can, and slow memory shows."""

ALIKE = "a feature is the same in most of its sets: what stands out of them cannot be told"


def advice(n_sets: int) -> str | None:
    """Say what a baseline of so many sets lacks; None: nothing."""
    if n_sets >= GOOD_SETS:
        return None
    warned = f"fewer than {ADVISED_SETS} sets: the rate of false alarms is uncertain; "
    few = warned if n_sets < ADVISED_SETS else ""
    return f"{few}{GOOD_SETS} sets and more are advised, {n_sets} are there"


def readiness_of(state: State, rules: Rules) -> dict[str, Any] | None:
    """Tell it of a baseline that was just frozen; None: there is none.

    Sets are told by their index; ``rate_guaranteed`` is whether the chart keeps to its budget.
    """
    baseline = state.baseline
    if baseline is None or baseline.fitted is None or baseline.design is None:
        return None
    design, indices = baseline.design, baseline.fitted.set_indices
    lacking, named = advice(baseline.fitted.n), _named(state)
    if named is None:
        lacking = f"{lacking + '; ' if lacking else ''}{ALIKE}"
    return {
        "n": baseline.fitted.n,
        "n_left_out": state.n_left_out,
        "advice": lacking,
        "n_eff": design.n_eff,
        "phi_pooled": design.phi_pooled,
        "tail": design.by_default.tail,
        "named": [
            {"kind": one.kind, "set_indices": [indices[row] for row in one.rows]} for one in named or ()
        ],
        "default_because": design.by_default.reason,
        "false_alarms_per_sensor_year": rules.false_alarms_per_sensor_year,
        "rate_guaranteed": not design.why_not_guaranteed,
        "why_not_guaranteed": design.why_not_guaranteed or None,
    }


def _named(state: State) -> tuple[Anomaly, ...] | None:
    """Name what stands out; None: most of the sets do not scatter in some direction."""
    try:
        return find_anomalies(np.array([found.vector() for found in state.healthy]))
    except np.linalg.LinAlgError:  # as of records that are played back again and again
        return None
