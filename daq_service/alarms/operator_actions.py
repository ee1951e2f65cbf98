"""What a person changes of an alarm: acknowledgement, reset, shelf and service (ISA-18.2). Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from daq_service.alarms.states import NOT_SUPPRESSED, RESPOND_WITHIN_H, Change, Moment, change_state
from daq_service.catalogue.rows import AlarmRow, AlarmState, Suppression
from hardware_drivers.nanoseconds import NS_PER_H

AFTER_ACKNOWLEDGEMENT: Mapping[str, AlarmState] = {
    "unacknowledged": "acknowledged",
    "returned_unacknowledged": "normal",
}
"""States that wait for an operator, and the state after the acknowledgement."""
LONGEST_SHELF_H = 72.0
"""Maximum time of a shelf: a weekend."""


def acknowledge_alarm(row: AlarmRow, author: str, note: str, moment: Moment) -> Change:
    """Return the change that acknowledges an alarm, with author, note and time.

    An unacknowledged alarm becomes ``acknowledged``; one whose condition has gone becomes ``normal``.

    Raises
    ------
    ValueError
        The alarm is not waiting for an acknowledgement.
    """
    if row.state not in AFTER_ACKNOWLEDGEMENT:
        raise ValueError(f"alarm {row.id} is {row.state}: there is nothing to acknowledge")
    return change_state(
        row,
        AFTER_ACKNOWLEDGEMENT[row.state],
        moment,
        "alarm_acknowledged",
        acknowledged_utc_ns=moment.utc_ns,
        acknowledged_by=author,
        note=note,
    )


def reset_alarm(row: AlarmRow, author: str, note: str, moment: Moment) -> Change:
    """Return the change that resets an alarm to normal, also a latched one, for a person (``author``).

    The person has removed its cause, or ends its monitoring. An earlier acknowledgement keeps its author and
    time; an empty note keeps the earlier note.

    Raises
    ------
    ValueError
        The alarm is normal already.
    """
    if row.state == "normal":
        raise ValueError(f"alarm {row.id} has ended already: there is nothing to reset")
    change = change_state(
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


def remove_expired_shelf(row: AlarmRow, *, utc_ns: int, wall_utc_ns: int) -> AlarmRow:
    """Return the row of an alarm at a moment: without its shelf if that has expired, else the same object.

    A shelf expires when either clock reaches its end.

    Parameters
    ----------
    utc_ns, wall_utc_ns
        Current time on the experiment's clock, and in real time, ns of UTC.
    """
    ends_ns, ends_wall_ns = row.shelved_until_utc_ns, row.shelved_until_wall_utc_ns
    if row.suppressed != "shelved" or ends_ns is None or ends_wall_ns is None:
        return row
    has_expired = utc_ns >= ends_ns or wall_utc_ns >= ends_wall_ns
    return replace(row, **NOT_SUPPRESSED) if has_expired else row


def end_expired_shelf(row: AlarmRow, moment: Moment, wall_utc_ns: int) -> Change | None:
    """Return the change that ends an expired shelf; None without a shelf, or while it runs.

    ``wall_utc_ns`` is real time, ns of UTC; the moment has the time on the experiment's clock.
    """
    current_row = remove_expired_shelf(row, utc_ns=moment.utc_ns, wall_utc_ns=wall_utc_ns)
    return None if current_row is row else change_state(current_row, row.state, moment, "alarm_shelf_expired")


def report_overdue_response(row: AlarmRow, moment: Moment) -> Change | None:
    """Return the change of an alarm that nobody acknowledged within its time to respond; None before that.

    It comes again after the same time. A suppressed alarm is not reported.
    """
    within_ns = RESPOND_WITHIN_H[row.priority] * NS_PER_H
    if row.state != "unacknowledged" or row.suppressed or moment.utc_ns - row.changed_utc_ns < within_ns:
        return None
    return change_state(row, row.state, moment, "alarm_response_overdue")


def shelve(row: AlarmRow, author: str, reason: str, for_h: float, moment: Moment, wall_utc_ns: int) -> Change:
    """Return the change that shelves an alarm for ``for_h`` hours of the test or of real time.

    The shelf ends when the first of the two is over. A running shelf is replaced. The limit `LONGEST_SHELF_H`
    is not checked. ``wall_utc_ns`` is the current real time, ns of UTC.

    Raises
    ------
    ValueError
        The alarm is normal, or out of service.
    """
    if row.state == "normal":
        raise ValueError(f"alarm {row.id} has ended: there is nothing to shelve")
    if row.suppressed == "out_of_service":
        raise ValueError(f"alarm {row.id} is out of service: return it to service first")
    length_ns = round(for_h * NS_PER_H)
    return change_state(
        row,
        row.state,
        moment,
        "alarm_shelved",
        suppressed="shelved",
        suppressed_by=author,
        suppressed_reason=reason,
        shelved_until_utc_ns=moment.utc_ns + length_ns,
        shelved_until_wall_utc_ns=wall_utc_ns + length_ns,
    )


def take_out_of_service(row: AlarmRow, author: str, reason: str, moment: Moment) -> Change:
    """Return the change that takes an alarm out of service until a person returns it; its shelf is removed.

    Raises
    ------
    ValueError
        The alarm is out of service already.
    """
    if row.suppressed == "out_of_service":
        raise ValueError(f"alarm {row.id} is out of service already: {row.suppressed_reason}")
    columns = {
        **NOT_SUPPRESSED,
        "suppressed": "out_of_service",
        "suppressed_by": author,
        "suppressed_reason": reason,
    }
    return change_state(row, row.state, moment, "alarm_out_of_service", **columns)


def end_suppression(row: AlarmRow, wanted: Suppression, author: str, note: str, moment: Moment) -> Change:
    """Return the change that unshelves an alarm, or returns it to service; author and note remain in the row.

    Parameters
    ----------
    wanted
        The suppression to end: ``shelved`` or ``out_of_service``.

    Raises
    ------
    ValueError
        The alarm is not suppressed in that way.
    """
    if row.suppressed != wanted:
        raise ValueError(f"alarm {row.id} is not {wanted.replace('_', ' ')}")
    event_kind = "alarm_unshelved" if wanted == "shelved" else "alarm_in_service"
    # The name of the person who ended it stays in the row until the next suppression.
    columns = {**NOT_SUPPRESSED, "suppressed_by": author, "suppressed_reason": note or None}
    return change_state(row, row.state, moment, event_kind, **columns)
