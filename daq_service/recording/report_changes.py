"""Report the stored changes of a set to the program that started the test."""

from __future__ import annotations

from collections.abc import Callable

from daq_service.catalogue import SetCommit
from hardware_drivers.nanoseconds import NS_PER_H


def report_changes(transaction: SetCommit, news: Callable[..., None]) -> None:
    """Call ``news`` with "gap" for each set, state and reason, and with "alarm" for each changed alarm.

    Unscheduled sets have no gaps.
    """
    lacking: dict[tuple[int, str, str], list[str]] = {}
    for row in transaction.sets:
        if row.state in ("missed", "partial") and row.purpose is None:
            lacking.setdefault((row.set_index, row.state, row.reason or ""), []).append(row.position)
    for (set_index, state, reason), positions in lacking.items():
        news("gap", set_index=set_index, state=state, reason=reason, positions=positions)
    for at, row_at in transaction.alarm_of_event.items():
        alarm = transaction.alarms[row_at]
        since_h = (alarm.changed_utc_ns - alarm.raised_utc_ns) / NS_PER_H
        news(
            "alarm",
            change=transaction.events[at].kind,
            hour=alarm.raised_h + since_h,
            priority=alarm.priority,
            message=alarm.message,
        )
