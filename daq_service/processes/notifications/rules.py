"""Rules, delays and grouping of notifications. Pure: no clock, no thread, nothing stored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from daq_service.alarms.states import PRIORITIES
from daq_service.processes.notifications.messages import ENDED, AlarmChange
from daq_service.settings.notifications import RuleSettings
from hardware_drivers.nanoseconds import NS_PER_S


def find_matching_rule(change: AlarmChange, receiver: str, rules: Sequence[RuleSettings]) -> int | None:
    """Return the index, from 0, of the first rule that matches a change and a receiver; None if none does."""
    for number, rule in enumerate(rules):
        if (
            (not rule.receivers or receiver in rule.receivers)
            and PRIORITIES.index(change.priority) >= PRIORITIES.index(rule.priority)
            and (not rule.positions or change.position in rule.positions)
            and (not rule.kinds or change.kind in rule.kinds)
        ):
            return number
    return None


@dataclass(frozen=True, slots=True)
class _Item:
    change: AlarmChange
    rule: int
    due_s: float


class WaitingChanges:
    """Queue of changes that wait for their delay, or for others of their group.

    Parameters
    ----------
    rules
        Rules of the configuration.
    """

    def __init__(self, rules: Sequence[RuleSettings]) -> None:
        self._rules = rules
        self._items: dict[int, _Item] = {}

    def __len__(self) -> int:
        """Return the number of waiting changes."""
        return len(self._items)

    def event_ids(self) -> list[int]:
        """Return the ids of the waiting events, ascending."""
        return sorted(self._items)

    def add(self, change: AlarmChange, rule: int, *, now_s: float, age_s: float) -> list[int]:
        """Add a change of an alarm to the waiting ones, or remove those of one that ended within its delay.

        Parameters
        ----------
        rule
            Index of the matching rule.
        now_s, age_s
            Monotonic time, and age of the stored event: a restart does not restart its delay.

        Returns
        -------
        list of int
            Events that are not sent: the alarm ended within its delay, or the rule excludes its end.
        """
        its_rule = self._rules[rule]
        if change.change not in ENDED:
            # Independent of steps of the clocks, nothing waits longer than its delay.
            remaining_s = min(its_rule.delay_s, max(0.0, its_rule.delay_s - age_s))
            self._items[change.event_id] = _Item(change, rule, now_s + remaining_s)
            return []
        waiting = [item for item in self._items.values() if item.change.alarm_id == change.alarm_id]
        first = waiting[0].change if waiting else None
        active_s = 0.0 if first is None else (change.wall_utc_ns - first.wall_utc_ns) / NS_PER_S
        if first is not None and first.change in ("raised", "active again") and active_s < its_rule.delay_s:
            return [*self.remove([item.change for item in waiting]), change.event_id]
        if not its_rule.returned:
            return [change.event_id]
        self._items[change.event_id] = _Item(change, rule, now_s)
        return []

    def due(self, now_s: float) -> list[AlarmChange]:
        """Return the changes of the first rule whose group is complete at ``now_s``, by event id.

        ``now_s`` is monotonic time, s. The changes form one message and stay in the queue; empty if none is
        due.
        """
        for rule in range(len(self._rules)):
            if (group_end_s := self._compute_group_end_s(rule)) is not None and group_end_s <= now_s:
                changes = [i.change for i in self._items.values() if i.rule == rule and i.due_s <= now_s]
                return sorted(changes, key=lambda change: change.event_id)
        return []

    def next_s(self) -> float | None:
        """Return the monotonic time at which the next message is due, s; None if nothing waits."""
        group_ends_s = [self._compute_group_end_s(rule) for rule in range(len(self._rules))]
        return min((at_s for at_s in group_ends_s if at_s is not None), default=None)

    def remove(self, changes: Sequence[AlarmChange]) -> list[int]:
        """Remove waiting changes, and return their event ids; raise KeyError for one that does not wait."""
        for item in changes:
            del self._items[item.event_id]
        return [item.event_id for item in changes]

    def _compute_group_end_s(self, rule: int) -> float | None:
        """Return when the changes of a rule (index) are due as one message, monotonic s; None without any."""
        first_s = min((item.due_s for item in self._items.values() if item.rule == rule), default=None)
        return None if first_s is None else first_s + self._rules[rule].group_s
