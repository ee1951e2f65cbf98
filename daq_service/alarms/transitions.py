"""Transitions of an alarm from its events, with person and reason."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from daq_service.catalogue.rows import EventRow

_AUTHOR_AND_REASON: Mapping[str, tuple[str, str]] = {
    "alarm_acknowledged": ("acknowledged_by", "note"),
    "alarm_reset": ("acknowledged_by", "note"),
    **dict.fromkeys(
        ("alarm_shelved", "alarm_unshelved", "alarm_out_of_service", "alarm_in_service"),
        ("suppressed_by", "suppressed_reason"),
    ),
}
"""Columns of person and reason by kind of event; other transitions are caused by no person."""
_BY_THEMSELVES = ("alarm_raised", "alarm_reactivated", "alarm_priority_raised")


def build_transition(event: EventRow) -> dict[str, Any]:
    """Convert an event of the topic ``alarms`` to a transition of the alarm for the API, as a dict.

    It has id and kind of the event, times in ns of UTC, state, priority, suppression, author, reason and end
    of the shelf; missing values are None. The reason is that of the person, or the alarm's message where it
    was raised, became active again or rose in priority.
    """
    payload = event.payload
    author, reason = _AUTHOR_AND_REASON.get(event.kind, ("", ""))
    return {
        "event_id": event.id,
        "kind": event.kind,
        "utc_ns": event.utc_ns,
        "wall_utc_ns": event.wall_utc_ns,
        "state": payload.get("state"),
        "priority": payload.get("priority"),
        "suppressed": payload.get("suppressed"),
        "author": payload.get("author") or payload.get(author),
        "reason": payload.get("message") if event.kind in _BY_THEMSELVES else payload.get(reason),
        "shelved_until_utc_ns": payload.get("shelved_until_utc_ns"),
    }
