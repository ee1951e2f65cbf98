"""Transitions of an alarm, as its events tell them: who and why."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq_service.catalogue.rows import EventRow

_WHO_AND_WHY: Mapping[str, tuple[str, str]] = {
    "alarm_acknowledged": ("acknowledged_by", "note"),
    "alarm_reset": ("acknowledged_by", "note"),
    **dict.fromkeys(
        ("alarm_shelved", "alarm_unshelved", "alarm_out_of_service", "alarm_in_service"),
        ("suppressed_by", "suppressed_because"),
    ),
}
"""Columns of the alarm that name who changed it, and why; other transitions have nobody behind them."""
_BY_THEMSELVES = ("alarm_raised", "alarm_returned", "alarm_worsened")


def transition(event: EventRow) -> dict[str, Any]:
    """Tell an event of the topic ``alarms`` as a transition; times in ns of UTC."""
    told = event.payload
    who, why = _WHO_AND_WHY.get(event.kind, ("", ""))
    return {
        "event_id": event.id,
        "kind": event.kind,
        "utc_ns": event.utc_ns,
        "wall_utc_ns": event.wall_utc_ns,
        "state": told.get("state"),
        "severity": told.get("severity"),
        "suppressed": told.get("suppressed"),
        "who": told.get("author") or told.get(who),
        "why": told.get("message") if event.kind in _BY_THEMSELVES else told.get(why),
        "shelved_until_utc_ns": told.get("shelved_until_utc_ns"),
    }
