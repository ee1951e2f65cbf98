"""Read rows of earlier schemas: columns, nested keys, kinds and states to 0016, set numbers to 0015.

The migration stores them with the current names; the history keeps its lines, which are converted as they
are read. No current name is also an earlier one of the same table, so current rows stay as they are.
"""

from __future__ import annotations

import tomllib
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from daq_service.settings.alarm_delays import EARLIER_ALARM_KINDS
from hardware_drivers.measurement import SetKey

_NAMES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
COMMAND_KINDS: Mapping[str, str] = _NAMES["command_kinds"]
TOPICS: Mapping[str, str] = _NAMES["topics"]
EVENT_KINDS: Mapping[str, str] = _NAMES["event_kinds"]
COLUMNS: Mapping[str, Mapping[str, str]] = _NAMES["columns"]
"""Earlier and current names of the columns of each table."""
_KEYS: Mapping[str, Mapping[str, str]] = {**COLUMNS, **_NAMES["keys"]}
_VALUES: Mapping[tuple[str, str], Mapping[str, str]] = {
    **{
        (table, name): names for table, columns in _NAMES["values"].items() for name, names in columns.items()
    },
    ("alarms", "kind"): EARLIER_ALARM_KINDS,
    ("commands", "kind"): COMMAND_KINDS,
    ("events", "topic"): TOPICS,
    ("events", "kind"): EVENT_KINDS,
}
_NESTED = ("baseline_quality", "evidence", "confirmation", "limits", "averages")
SET_COLUMNS: Mapping[str, str] = {
    name: name.replace("set_index", "unscheduled_index")
    for name in ("set_index", "raised_set_index", "confirmation_set_index")
}
"""Columns and keys that identified any set by one number, and the second part of the key that replaces it."""


def derive_uuid(configuration_hash: str, epoch_utc_ns: int) -> str:
    """Derive the UUID (version 5) of a test that has none; every copy of its folder derives the same one."""
    return str(uuid.uuid5(uuid.NAMESPACE_OID, f"solimon/{configuration_hash}/{epoch_utc_ns}"))


def to_current_row(table: str, row: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the column names and values of a stored row, or of nested values, to the current names.

    Returns a new dictionary; a row with current names keeps its values. A row of the experiment without UUID
    gets the derived one.
    """
    keys = _KEYS.get(table, {})
    current = {keys.get(name, name): value for name, value in row.items()}
    for name, value in [*current.items()]:
        if name in _NESTED and isinstance(value, Mapping):
            current[name] = to_current_row(name, value)
        elif isinstance(value, str):
            current[name] = _VALUES.get((table, name), {}).get(value, value)
        elif name in SET_COLUMNS and isinstance(value, int):
            key = SetKey.from_number(value)
            if key.unscheduled_index:
                current |= {name: key.set_index, SET_COLUMNS[name]: key.unscheduled_index}
    if table == "experiment":
        current.setdefault("uuid", derive_uuid(row["configuration_hash"], row["epoch_utc_ns"]))
    elif table == "events" and "payload" in current:
        current["payload"] = to_current_payload(current["topic"], current["kind"], current["payload"])
    return current


def to_current_payload(topic: str, kind: str, payload: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the payload of an event to current names, as a new dictionary.

    ``topic`` and ``kind`` must be current names already.
    """
    is_baseline = topic == "assessments" and kind != "set_assessed"
    return to_current_row("baselines" if is_baseline else topic, payload)
