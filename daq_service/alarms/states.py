"""Alarm states after ISA-18.2 as pure functions over rows; the caller stores the rows.

::

               condition true                    acknowledge
    normal ───────────────────► unacknowledged ──────────────► acknowledged
      ▲                             │  ▲                            │
      │                condition    │  │ condition true             │ condition false
      │                false        ▼  │                            ▼
      └──────────── returned_unacknowledged                      normal
        acknowledge

A latched alarm (a hole does not heal) never leaves by its condition, only by a person's reset.
Severity is kept at the highest reached until the alarm is acknowledged.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from daq_service.catalogue.rows import AlarmRow, AlarmState, Family, Severity

SEVERITIES: tuple[Severity, ...] = ("low", "medium", "high", "critical")
AFTER_ACKNOWLEDGEMENT: Mapping[str, AlarmState] = {
    "unacknowledged": "acknowledged",
    "returned_unacknowledged": "normal",
}
"""States that wait for an operator, and what follows."""
RETIRING = ("hole", "retired")
"""Kinds of alarm at which a transducer strikes no more, until a person reinstates it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """What one assessment says of one possible alarm."""

    position: str | None
    kind: str
    family: Family
    severity: Severity
    present: bool
    message: str
    latched: bool = False
    proof: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A row to store, and the event that tells of it."""

    row: AlarmRow
    event_kind: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """When an assessment was made, on the experiment's clock."""

    utc_ns: int
    due_h: float
    set_index: int | None


def retired_positions(alarms: Iterable[AlarmRow]) -> dict[str, str]:
    """Transducers that strike no more, and the alarm's message that says why.

    Parameters
    ----------
    alarms
        Rows; those that are back to normal retire nobody.
    """
    return {
        row.position: row.message
        for row in alarms
        if row.position is not None and row.kind in RETIRING and row.state != "normal"
    }


def update(row: AlarmRow | None, condition: Condition, moment: Moment) -> Change | None:
    """Carry an alarm over one assessment; None where nothing changes.

    Parameters
    ----------
    row
        The latest alarm of this position and kind, or None. A closed one (state normal) stays in
        the history: its next appearance is a new alarm with a new row.
    """
    if condition.present and (row is None or row.state == "normal"):
        return Change(row=_new_row(condition, moment), event_kind="alarm_raised")
    if row is None:
        return None
    if condition.present:
        if row.state == "returned_unacknowledged":
            return _to(row, "unacknowledged", moment, "alarm_returned", cleared_utc_ns=None)
        if SEVERITIES.index(condition.severity) > SEVERITIES.index(row.severity):
            return _to(
                row,
                "unacknowledged",
                moment,
                "alarm_worsened",
                severity=condition.severity,
                message=condition.message,
            )
        return None
    if condition.latched:
        return None
    if row.state == "unacknowledged":
        return _to(row, "returned_unacknowledged", moment, "alarm_cleared", cleared_utc_ns=moment.utc_ns)
    if row.state == "acknowledged":
        return _to(row, "normal", moment, "alarm_cleared", cleared_utc_ns=moment.utc_ns)
    return None


def acknowledge(row: AlarmRow, author: str, note: str, moment: Moment) -> Change:
    """Note that an operator has seen the alarm.

    Raises
    ------
    ValueError
        The alarm is not waiting for an acknowledgement.
    """
    if row.state not in AFTER_ACKNOWLEDGEMENT:
        raise ValueError(f"alarm {row.id} is {row.state}: there is nothing to acknowledge")
    return _to(
        row,
        AFTER_ACKNOWLEDGEMENT[row.state],
        moment,
        "alarm_acknowledged",
        acknowledged_utc_ns=moment.utc_ns,
        acknowledged_by=author,
        note=note,
    )


def reset(row: AlarmRow, author: str, note: str, moment: Moment) -> Change:
    """End a latched alarm by a person's word: what it stood for was put right.

    Raises
    ------
    ValueError
        The alarm has ended already.
    """
    if row.state == "normal":
        raise ValueError(f"alarm {row.id} has ended already: there is nothing to reset")
    return _to(
        row,
        "normal",
        moment,
        "alarm_reset",
        cleared_utc_ns=moment.utc_ns,
        acknowledged_utc_ns=row.acknowledged_utc_ns or moment.utc_ns,
        acknowledged_by=row.acknowledged_by or author,
        note=note or row.note,
    )


def _new_row(condition: Condition, moment: Moment) -> AlarmRow:
    return AlarmRow(
        position=condition.position,
        kind=condition.kind,
        family=condition.family,
        severity=condition.severity,
        state="unacknowledged",
        raised_utc_ns=moment.utc_ns,
        raised_h=moment.due_h,
        raised_set_index=moment.set_index,
        changed_utc_ns=moment.utc_ns,
        message=condition.message,
        proof=dict(condition.proof),
    )


def _to(row: AlarmRow, state: AlarmState, moment: Moment, event_kind: str, **changed: Any) -> Change:
    return Change(
        row=replace(row, **changed, state=state, changed_utc_ns=moment.utc_ns), event_kind=event_kind
    )
