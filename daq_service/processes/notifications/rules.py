"""Who is told of what, and when: rules, delays, storms. Pure: no clock, no thread, nothing stored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from daq_service.alarms.states import SEVERITIES
from daq_service.processes.notifications.messages import News
from daq_service.settings.notifications import RuleSettings
from hardware_drivers.nanoseconds import NS_PER_S


def rule_of(news: News, receiver: str, rules: Sequence[RuleSettings]) -> int | None:
    """Find the first rule that fits an alarm and a receiver, by its number; None: it is not told."""
    for number, rule in enumerate(rules):
        if (
            (not rule.receivers or receiver in rule.receivers)
            and SEVERITIES.index(news.severity) >= SEVERITIES.index(rule.severity)
            and (not rule.positions or news.position in rule.positions)
            and (not rule.kinds or news.kind in rule.kinds)
        ):
            return number
    return None


@dataclass(frozen=True, slots=True)
class _Item:
    news: News
    rule: int
    due_s: float


class Waiting:
    """News that wait for their delay, or for others to go out with.

    Parameters
    ----------
    rules
        Of the configuration.
    """

    def __init__(self, rules: Sequence[RuleSettings]) -> None:
        self._rules = rules
        self._items: dict[int, _Item] = {}

    def __len__(self) -> int:
        return len(self._items)

    def event_ids(self) -> list[int]:
        """Events that wait, in order."""
        return sorted(self._items)

    def add(self, news: News, rule: int, *, now_s: float, age_s: float) -> list[int]:
        """Take in news of an alarm.

        Parameters
        ----------
        now_s, age_s
            The time, and for how long the event is stored already: a restart begins no delay anew.

        Returns
        -------
        list of int
            Events that nobody is told of: the alarm was over within its delay, or its end is not wanted.
        """
        wanted = self._rules[rule]
        if news.what != "over":
            # Whatever the clocks do, nothing waits for longer than its delay.
            left_s = min(wanted.delay_s, max(0.0, wanted.delay_s - age_s))
            self._items[news.event_id] = _Item(news, rule, now_s + left_s)
            return []
        its = [item for item in self._items.values() if item.news.alarm_id == news.alarm_id]
        began = its[0].news if its else None
        stood_s = 0.0 if began is None else (news.wall_utc_ns - began.wall_utc_ns) / NS_PER_S
        if began is not None and began.what in ("raised", "back") and stood_s < wanted.delay_s:
            return [*self.take([item.news for item in its]), news.event_id]
        if not wanted.returned:
            return [news.event_id]
        self._items[news.event_id] = _Item(news, rule, now_s)
        return []

    def due(self, now_s: float) -> list[News]:
        """News that go out now as one message, in order; empty: none do yet."""
        for rule in range(len(self._rules)):
            if (closes_s := self._closes_s(rule)) is not None and closes_s <= now_s:
                its = [i.news for i in self._items.values() if i.rule == rule and i.due_s <= now_s]
                return sorted(its, key=lambda news: news.event_id)
        return []

    def next_s(self) -> float | None:
        """When the next message goes out; None where nothing waits."""
        closing = [self._closes_s(rule) for rule in range(len(self._rules))]
        return min((at_s for at_s in closing if at_s is not None), default=None)

    def take(self, news: Sequence[News]) -> list[int]:
        """Take news out, and return their events."""
        for item in news:
            del self._items[item.event_id]
        return [item.event_id for item in news]

    def _closes_s(self, rule: int) -> float | None:
        first_s = min((item.due_s for item in self._items.values() if item.rule == rule), default=None)
        return None if first_s is None else first_s + self._rules[rule].group_s
