"""Alarm states after ISA-18.2 as pure functions over rows; the caller stores the rows.

::

               condition true                    acknowledge
    normal ───────────────────► unacknowledged ──────────────► acknowledged
      ▲                             │  ▲                            │
      │                condition    │  │ condition true             │ condition false
      │                false        ▼  │                            ▼
      └──────────── returned_unacknowledged                      normal
        acknowledge

An alarm may also be suppressed: shelved for a limited time, or out of service until a person returns it. Its
state changes as usual meanwhile (`operator_actions`).

A latched alarm (a hole does not heal) returns to normal only by a person's reset.
Priority is kept at the highest reached until the alarm is acknowledged.
Delays and deadbands are in `delays`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from daq_service.catalogue.rows import AlarmClass, AlarmRow, AlarmState, EventRow, Priority
from hardware_drivers.measurement import DueSet

PRIORITIES: tuple[Priority, ...] = ("low", "medium", "high", "critical")
SUPPRESSION = (
    *("suppressed", "suppressed_by", "suppressed_reason"),
    *("shelved_until_utc_ns", "shelved_until_wall_utc_ns"),
)
"""Columns of an alarm about its suppression."""
NOT_SUPPRESSED: Mapping[str, Any] = MappingProxyType(dict.fromkeys(SUPPRESSION))
RETIRING = ("no_reflection", "transducer_disabled")
"""Kinds of alarm that stop a transducer's strikes until a person enables it."""
ALARMS_OF_CHANGE = ("wall_change", "transducer_change")
"""Kinds of alarm with the result of a confirmation set in their evidence; the diagnosis selects one."""
NOT_ASSESSED = "not_assessed"
"""Kind of alarm of a baseline without limits, and status of a position that is not assessed."""
_AFTER_CONDITION: Mapping[str, AlarmState] = {
    "unacknowledged": "returned_unacknowledged",
    "acknowledged": "normal",
}
"""States of an active alarm, and the state after its condition has gone."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """Condition of one possible alarm after one assessment.

    Attributes
    ----------
    times_limit
        Measured quantity divided by its limit; None if it has no limit, or no value now.
    known
        Confirmed diagnosis, if it is at least as severe as the alarm; it is reported once while the alarm is
        active.
    """

    position: str | None = None
    kind: str
    alarm_class: AlarmClass = "diagnostic"
    priority: Priority
    present: bool
    message: str
    latched: bool = False
    times_limit: float | None = None
    known: str = ""
    evidence: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A row to store, and the kind of its event.

    Attributes
    ----------
    author
        Person who made the change, if the row may name another person, who acknowledged the alarm before.
    """

    row: AlarmRow
    event_kind: str
    author: str | None = None

    def event(self, moment: Moment) -> EventRow:
        """Return the event of the change: topic ``alarms``, kind, time, set, position, and author if known.

        The row is not in its payload: the commit adds it (`SetCommit.add_alarm`).
        """
        author = {} if self.author is None else {"author": self.author}
        return moment.event("alarms", self.event_kind, author, position=self.row.position)


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """Time of an assessment on the experiment's clock."""

    utc_ns: int
    due_h: float
    set_index: int | None
    unscheduled_index: int = 0

    @classmethod
    def of_set(cls, due: DueSet, utc_ns: int) -> Moment:
        """Create the moment of a set: its indices, its scheduled hour, and a time in ns of UTC."""
        return cls(
            utc_ns=utc_ns,
            due_h=due.due_h,
            set_index=due.set_index,
            unscheduled_index=due.unscheduled_index,
        )

    def event(
        self, topic: str, kind: str, payload: Mapping[str, Any], *, position: str | None = None
    ) -> EventRow:
        """Create an event row with the time and the set of this moment; the payload is copied."""
        return EventRow(
            utc_ns=self.utc_ns,
            topic=topic,
            kind=kind,
            position=position,
            set_index=self.set_index,
            unscheduled_index=self.unscheduled_index,
            payload=dict(payload),
        )


def find_disabled(alarms: Iterable[AlarmRow]) -> dict[str, str]:
    """Return the disabled transducers by position, each with the message of the alarm that disabled it.

    Parameters
    ----------
    alarms
        Alarm rows; only `RETIRING` kinds that have not returned to normal count, the last row of a position.
    """
    return {
        row.position: row.message
        for row in alarms
        if row.position is not None and row.kind in RETIRING and row.state != "normal"
    }


def update_alarm(row: AlarmRow | None, condition: Condition, moment: Moment) -> Change | None:
    """Return the change of an alarm by the condition of one assessment; None if nothing changes.

    It is raised, becomes active again, rises in priority or diagnosis (then it is unacknowledged again and no
    longer shelved), or is cleared. A latched alarm is never cleared. A new row keeps the suppression of
    ``row``.

    Parameters
    ----------
    row
        The latest alarm of this position and kind, or None. After a return to normal the next alarm has a new
        row.
    """
    if condition.present and (row is None or row.state == "normal"):
        # Suppression applies to position and kind, so it continues for the next alarm.
        suppressed = {name: getattr(row, name) for name in SUPPRESSION} if row is not None else {}
        return Change(row=replace(_build_new_row(condition, moment), **suppressed), event_kind="alarm_raised")
    if row is None:
        return None
    if condition.present:
        if row.state == "returned_unacknowledged":
            updated = _compute_updated_columns(row, condition)
            return change_state(
                row, "unacknowledged", moment, "alarm_reactivated", cleared_utc_ns=None, **updated
            )
        is_more_severe = PRIORITIES.index(condition.priority) > PRIORITIES.index(row.priority)
        if is_more_severe or condition.known not in ("", row.evidence.get("known")):
            return change_state(
                row,
                "unacknowledged",
                moment,
                "alarm_priority_raised",
                **_compute_updated_columns(row, condition),
                # The shelf does not cover the new priority or diagnosis.
                **(NOT_SUPPRESSED if row.suppressed == "shelved" else {}),
            )
        return None
    state = None if condition.latched else _AFTER_CONDITION.get(row.state)
    if state is None:
        return None
    return change_state(row, state, moment, "alarm_cleared", cleared_utc_ns=moment.utc_ns)


def add_evidence(row: AlarmRow, evidence: Mapping[str, object], moment: Moment) -> Change:
    """Return the change that adds later results to the evidence of an alarm, replacing keys of the same name.

    State, priority and message do not change.
    """
    return change_state(
        row, row.state, moment, "alarm_evidence_added", evidence=row.evidence | dict(evidence)
    )


def _build_new_row(condition: Condition, moment: Moment) -> AlarmRow:
    """Return the row of a new alarm, unacknowledged and not suppressed, that a condition raises."""
    return AlarmRow(
        position=condition.position,
        kind=condition.kind,
        alarm_class=condition.alarm_class,
        priority=condition.priority,
        state="unacknowledged",
        raised_utc_ns=moment.utc_ns,
        raised_h=moment.due_h,
        raised_set_index=moment.set_index,
        raised_unscheduled_index=moment.unscheduled_index,
        changed_utc_ns=moment.utc_ns,
        message=condition.message,
        evidence=_build_evidence(condition),
    )


def _compute_updated_columns(row: AlarmRow, condition: Condition) -> dict[str, Any]:
    """Return the updated priority (never lower), message and evidence of an alarm under its condition."""
    priority = max(row.priority, condition.priority, key=PRIORITIES.index)
    return {"priority": priority, "message": condition.message, "evidence": _build_evidence(condition)}


def _build_evidence(condition: Condition) -> dict[str, Any]:
    """Return a copy of a condition's evidence, with a confirmed diagnosis, if any, as the key ``known``."""
    return dict(condition.evidence) | ({"known": condition.known} if condition.known else {})


def change_state(row: AlarmRow, state: AlarmState, moment: Moment, event_kind: str, **changed: Any) -> Change:
    """Return the change of an alarm to a state at a moment, with new values of other columns (``changed``).

    The transition is not checked. Raise TypeError for an unknown column.
    """
    return Change(
        row=replace(row, **changed, state=state, changed_utc_ns=moment.utc_ns), event_kind=event_kind
    )
