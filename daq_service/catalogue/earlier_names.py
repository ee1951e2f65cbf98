"""Read rows of earlier schemas: columns, nested keys, kinds and states to 0016, set numbers to 0015.

The migration stores them with the current names; the history keeps its lines, which are converted as they
are read. No current name is also an earlier one of the same table, so current rows stay as they are.
"""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from daq_service.settings.alarm_delays import EARLIER_ALARM_KINDS
from hardware_drivers.measurement import SetKey

COMMAND_KINDS: Mapping[str, str] = MappingProxyType(
    {
        "hold": "pause",
        "release": "resume",
        "retire": "disable",
        "reinstate": "enable",
        "confirm": "strike",
    }
)
TOPICS: Mapping[str, str] = MappingProxyType({"verdicts": "assessments"})
EVENT_KINDS: Mapping[str, str] = MappingProxyType(
    {
        "set_retired": "set_disabled",
        "set_judged": "set_assessed",
        "alarm_returned": "alarm_reactivated",
        "alarm_worsened": "alarm_priority_raised",
        "alarm_proof_added": "alarm_evidence_added",
        "data_damaged": "data_corrupt",
        "hold": "pause",
        "release": "resume",
    }
)
_DIAGNOSIS = {
    "cause": "diagnosis",
    "cause_probability": "diagnosis_probability",
    "cause_told": "diagnosis_details",
    "chart": "mewma_statistic",
}
_RATE = {"rate_guaranteed": "rate_verified", "why_not_guaranteed": "rate_not_verified_reason"}
_LIMITS = {"limit_f": "limit_f_predictive", "limit_paper": "limit_mean_3sd"}
_LIMIT_NAMES = {"chart": "mewma"}
COLUMNS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "baselines": {**_LIMITS, "readiness": "baseline_quality", "retired_because": "retired_reason"},
        "assessments": {
            **_DIAGNOSIS,
            **_LIMITS,
            "outlier_paper": "outlier_mean_3sd",
            "chart_alarm": "mewma_alarm",
        },
        "alarms": {
            "family": "alarm_class",
            "severity": "priority",
            "proof": "evidence",
            "suppressed_because": "suppressed_reason",
        },
    }
)
"""Earlier and current names of the columns of each table."""
_KEYS: Mapping[str, Mapping[str, str]] = {
    **COLUMNS,
    "baseline_quality": {**_RATE, "default_because": "default_reason"},
    "evidence": {**_DIAGNOSIS, **_RATE, "poor_sets_running": "consecutive_poor_sets"},
    "confirmation": {"why_not": "reason"},
    "service": {"because": "reason", "told": "description", "held": "paused"},
    "sets": {"cause": "reason"},
    "audit": {"who": "author", "why": "reason"},
    "limits": _LIMIT_NAMES,
    "averages": _LIMIT_NAMES,
}
_VALUES: Mapping[tuple[str, str], Mapping[str, str]] = {
    ("sets", "state"): {"retired": "disabled"},
    ("assessments", "diagnosis"): {"cannot tell": "undetermined"},
    ("evidence", "diagnosis"): {"cannot tell": "undetermined"},
    ("evidence", "raised_by"): {"cause": "diagnosis", **_LIMIT_NAMES},
    ("evidence", "limit_name"): _LIMIT_NAMES,
    ("assessments", "limit_name"): _LIMIT_NAMES,
    ("alarms", "kind"): EARLIER_ALARM_KINDS,
    ("alarms", "alarm_class"): {"device": "diagnostic"},
    ("events", "topic"): TOPICS,
    ("events", "kind"): EVENT_KINDS,
    ("commands", "kind"): COMMAND_KINDS,
    ("commands", "state"): {"refused": "rejected"},
    ("audit", "result"): {"refused": "rejected"},
    **{
        (table, name): {"lost": "no_communication"}
        for table in ("environment", "evidence")
        for name in ("supply_quality", "climate_quality")
    },
}
_NESTED = ("baseline_quality", "evidence", "confirmation", "limits", "averages")
SET_COLUMNS: Mapping[str, str] = MappingProxyType(
    {
        name: name.replace("set_index", "unscheduled_index")
        for name in ("set_index", "raised_set_index", "confirmation_set_index")
    }
)
"""Columns and keys that identified any set by one number, and the second part of the key that replaces it."""


def derived_uuid(configuration_hash: str, epoch_utc_ns: int) -> str:
    """Return the UUID of a test that was created without one: every copy of its folder derives the same."""
    return str(uuid.uuid5(uuid.NAMESPACE_OID, f"solimon/{configuration_hash}/{epoch_utc_ns}"))


def current_row(table: str, row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row, or a nested value, with current names."""
    keys = _KEYS.get(table, {})
    current = {keys.get(name, name): value for name, value in row.items()}
    for name, value in [*current.items()]:
        if name in _NESTED and isinstance(value, Mapping):
            current[name] = current_row(name, value)
        elif isinstance(value, str):
            current[name] = _VALUES.get((table, name), {}).get(value, value)
        elif name in SET_COLUMNS and isinstance(value, int):
            key = SetKey.of_number(value)
            if key.unscheduled_index:
                current |= {name: key.set_index, SET_COLUMNS[name]: key.unscheduled_index}
    if table == "experiment":
        current.setdefault("uuid", derived_uuid(row["configuration_hash"], row["epoch_utc_ns"]))
    elif table == "events" and "payload" in current:
        current["payload"] = current_payload(current["topic"], current["kind"], current["payload"])
    return current


def current_payload(topic: str, kind: str, payload: Mapping[str, Any]) -> dict[str, Any]:
    """Return the payload of an event with current names; the topic and the kind are current ones."""
    is_baseline = topic == "assessments" and kind != "set_assessed"
    return current_row("baselines" if is_baseline else topic, payload)
