"""Alarm states after ISA-18.2 as pure functions over rows; the caller stores the rows.

::

               condition true                    acknowledge
    normal ───────────────────► unacknowledged ──────────────► acknowledged
      ▲                             │  ▲                            │
      │                condition    │  │ condition true             │ condition false
      │                false        ▼  │                            ▼
      └──────────── returned_unacknowledged                      normal
        acknowledge

Beside its state an alarm may be suppressed: shelved for a bounded time, or out of service until a person
returns it. It goes on through its states meanwhile, and is told apart (`as_it_stands`).

A latched alarm (a hole does not heal) never leaves by its condition, only by a person's reset.
Severity is kept at the highest reached until the alarm is acknowledged.
What holds an alarm back before it follows its condition is in `delays`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from daq_service.catalogue.rows import AlarmRow, AlarmState, Family, Severity, Suppression
from hardware_drivers.nanoseconds import NS_PER_H

SEVERITIES: tuple[Severity, ...] = ("low", "medium", "high", "critical")
AFTER_ACKNOWLEDGEMENT: Mapping[str, AlarmState] = {
    "unacknowledged": "acknowledged",
    "returned_unacknowledged": "normal",
}
"""States that wait for an operator, and what follows."""
SUPPRESSION = (
    *("suppressed", "suppressed_by", "suppressed_because"),
    *("shelved_until_utc_ns", "shelved_until_wall_utc_ns"),
)
"""Columns of an alarm that say whether, and how, it is suppressed."""
NOT_SUPPRESSED: Mapping[str, Any] = MappingProxyType(dict.fromkeys(SUPPRESSION))
LONGEST_SHELF_H = 72.0
"""A weekend: what is not put right by then is out of service, or an alarm again."""
RETIRING = ("hole", "retired")
"""Kinds of alarm at which a transducer strikes no more, until a person reinstates it."""
ALARMS_OF_CHANGE = ("wall_change", "transducer_change")
"""Kinds of alarm whose proof says what a confirmation set says: one turns into the other with the cause."""
NOT_ASSESSED = "not_judged"
"""Kind of alarm while a baseline without limits stands, and the word for a position that is not judged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """What one assessment says of one possible alarm.

    Attributes
    ----------
    times_limit
        The measured quantity as a multiple of its limit, above 1 beyond it; None: it has none, or none now.
    known
        What is known for sure of its cause now, where that is as grave as was feared or graver: told once,
        however long the alarm has stood.
    """

    position: str | None = None
    kind: str
    family: Family = "device"
    severity: Severity
    present: bool
    message: str
    latched: bool = False
    times_limit: float | None = None
    known: str = ""
    proof: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A row to store, and the event that tells of it.

    Attributes
    ----------
    author
        Whose deed it is, where the row may name somebody else: who saw the alarm first.
    """

    row: AlarmRow
    event_kind: str
    author: str | None = None


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
        # A shelf, or a sensor under repair, is about the position and the kind: the next alarm stays on it.
        suppressed = {name: getattr(row, name) for name in SUPPRESSION} if row is not None else {}
        return Change(row=replace(_new_row(condition, moment), **suppressed), event_kind="alarm_raised")
    if row is None:
        return None
    if condition.present:
        if row.state == "returned_unacknowledged":
            told = _as_told(row, condition)
            return _to(row, "unacknowledged", moment, "alarm_returned", cleared_utc_ns=None, **told)
        graver = SEVERITIES.index(condition.severity) > SEVERITIES.index(row.severity)
        if graver or condition.known not in ("", row.proof.get("known")):
            return _to(
                row,
                "unacknowledged",
                moment,
                "alarm_worsened",
                **_as_told(row, condition),
                # It was shelved for what was known then.
                **(NOT_SUPPRESSED if row.suppressed == "shelved" else {}),
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
    """End an alarm by a person's word: what it stood for was put right, or is no longer watched.

    Raises
    ------
    ValueError
        The alarm has ended already.
    """
    if row.state == "normal":
        raise ValueError(f"alarm {row.id} has ended already: there is nothing to reset")
    change = _to(
        row,
        "normal",
        moment,
        "alarm_reset",
        cleared_utc_ns=moment.utc_ns,
        acknowledged_utc_ns=row.acknowledged_utc_ns or moment.utc_ns,
        acknowledged_by=row.acknowledged_by or author,
        note=note or row.note,
    )
    return replace(change, author=author)


def proven_by(row: AlarmRow, proof: Mapping[str, Any], moment: Moment) -> Change:
    """Add to the proof of an alarm what was found out since; its state stays."""
    return _to(row, row.state, moment, "alarm_proof_added", proof=row.proof | dict(proof))


def as_it_stands(row: AlarmRow, *, utc_ns: int, wall_utc_ns: int) -> AlarmRow:
    """Return the row as it is at a moment: a shelf that has expired is none, whoever has noted that.

    Parameters
    ----------
    utc_ns, wall_utc_ns
        Now on the experiment's clock, and in real time.
    """
    ends_ns, ends_wall_ns = row.shelved_until_utc_ns, row.shelved_until_wall_utc_ns
    if row.suppressed != "shelved" or ends_ns is None or ends_wall_ns is None:
        return row
    expired = utc_ns >= ends_ns or wall_utc_ns >= ends_wall_ns
    return replace(row, **NOT_SUPPRESSED) if expired else row


def expired(row: AlarmRow, moment: Moment, wall_utc_ns: int) -> Change | None:
    """End a shelf whose time is over; None where there is none."""
    after = as_it_stands(row, utc_ns=moment.utc_ns, wall_utc_ns=wall_utc_ns)
    return None if after is row else _to(after, row.state, moment, "alarm_shelf_expired")


def shelve(
    row: AlarmRow, author: str, because: str, for_h: float, moment: Moment, wall_utc_ns: int
) -> Change:
    """Tell nobody of an alarm for so many hours, of the test or in real time, whichever pass first.

    Raises
    ------
    ValueError
        The alarm has ended, or is out of service.
    """
    if row.state == "normal":
        raise ValueError(f"alarm {row.id} has ended: there is nothing to shelve")
    if row.suppressed == "out_of_service":
        raise ValueError(f"alarm {row.id} is out of service: return it to service first")
    length_ns = round(for_h * NS_PER_H)
    return _to(
        row,
        row.state,
        moment,
        "alarm_shelved",
        suppressed="shelved",
        suppressed_by=author,
        suppressed_because=because,
        shelved_until_utc_ns=moment.utc_ns + length_ns,
        shelved_until_wall_utc_ns=wall_utc_ns + length_ns,
    )


def take_out_of_service(row: AlarmRow, author: str, because: str, moment: Moment) -> Change:
    """Tell nobody of an alarm until a person returns it to service.

    Raises
    ------
    ValueError
        It is out of service already.
    """
    if row.suppressed == "out_of_service":
        raise ValueError(f"alarm {row.id} is out of service already: {row.suppressed_because}")
    out = {
        **NOT_SUPPRESSED,
        "suppressed": "out_of_service",
        "suppressed_by": author,
        "suppressed_because": because,
    }
    return _to(row, row.state, moment, "alarm_out_of_service", **out)


def end_suppression(row: AlarmRow, wanted: Suppression, author: str, note: str, moment: Moment) -> Change:
    """Tell of an alarm again: unshelve it, or return it to service.

    Raises
    ------
    ValueError
        It is not suppressed in that way.
    """
    if row.suppressed != wanted:
        raise ValueError(f"alarm {row.id} is not {wanted.replace('_', ' ')}")
    event_kind = "alarm_unshelved" if wanted == "shelved" else "alarm_in_service"
    # Who ended it stays beside, until it is suppressed anew.
    ended = {**NOT_SUPPRESSED, "suppressed_by": author, "suppressed_because": note or None}
    return _to(row, row.state, moment, event_kind, **ended)


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
        proof=_proof(condition),
    )


def _as_told(row: AlarmRow, condition: Condition) -> dict[str, Any]:
    """Give an alarm that is there already what is known of it now."""
    severity = max(row.severity, condition.severity, key=SEVERITIES.index)
    return {"severity": severity, "message": condition.message, "proof": _proof(condition)}


def _proof(condition: Condition) -> dict[str, Any]:
    return dict(condition.proof) | ({"known": condition.known} if condition.known else {})


def _to(row: AlarmRow, state: AlarmState, moment: Moment, event_kind: str, **changed: Any) -> Change:
    return Change(
        row=replace(row, **changed, state=state, changed_utc_ns=moment.utc_ns), event_kind=event_kind
    )
