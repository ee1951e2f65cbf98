"""One receiver's line: reads the events of alarms behind its own cursor, and tells what is wanted, in order.

What waits is read again from the catalogue after a restart, so nothing is queued but there. A message is
noted before its first attempt and after its last one (`delivery_log`).
"""

from __future__ import annotations

import logging
import random
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from daq_service.errors import BusyError, UsageError
from daq_service.processes.notifications.delivery_log import Delivery, DeliveryLog, Place, What
from daq_service.processes.notifications.messages import (
    Message,
    News,
    alarm_message,
    heartbeat_message,
    key_of,
    news_of,
    trial_message,
)
from daq_service.processes.notifications.rules import Waiting, rule_of
from daq_service.processes.notifications.source import Source
from daq_service.processes.notifications.webhook import Outcome
from daq_service.settings.notifications import SHORTEST_FOR_PEOPLE_S, NotificationSettings
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S

log = logging.getLogger(__name__)

LOOK_EVERY_S = 0.5
PAGE_EVENTS = 200
MOST_WAITING = 500
"""So many news are kept in memory; what comes behind them waits in the catalogue."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 2.0, 300.0
"""Between two attempts: doubled each time, half of it to one and a half by chance."""
MOST_REFUSALS = 5
"""Then a message that the receiver will not have makes way for those behind it."""
DEAD_AFTER_S = 600.0
"""A receiver that takes nothing for so long is shown as a warning."""

Send = Callable[[Message], Outcome]


@dataclass(slots=True, kw_only=True, eq=False)
class State:
    """What is told of a receiver; times are of the wall clock."""

    sent: int = 0
    failed: int = 0
    gave_up: int = 0
    waiting: int = 0
    last_sent_utc_ns: int | None = None
    last_failure_utc_ns: int | None = None
    last_failure: str = ""
    failing_since_utc_ns: int | None = None
    next_attempt_utc_ns: int | None = None
    began: str = ""
    heartbeat: str = "off"
    heartbeat_result: str = ""
    last_heartbeat_utc_ns: int | None = None
    next_heartbeat_utc_ns: int | None = None


@dataclass(slots=True, kw_only=True, eq=False)
class _Open:
    """The message that is under way."""

    news: Sequence[News]
    key: str
    attempts: int = 0
    next_s: float = 0.0


class ReceiverLine:
    """A receiver's news, one step after the other; `step` and `test` may run in two threads.

    Parameters
    ----------
    send, try_out
        Deliver a message once and bounded in time; the second one beside the first, for trials.
    """

    def __init__(
        self,
        name: str,
        settings: NotificationSettings,
        source: Source,
        deliveries: DeliveryLog,
        send: Send,
        try_out: Send,
        *,
        mono_s: Callable[[], float] = time.monotonic,
        now_ns: Callable[[], int] = time.time_ns,
        chance: Callable[[], float] = random.random,
    ) -> None:
        self.name, self.state = name, State()
        self._settings, self._own = settings, settings.receivers[name]
        self._source, self._log, self._send, self._try_out = source, deliveries, send, try_out
        self._mono_s, self._now_ns, self._chance = mono_s, now_ns, chance
        self._waiting = Waiting(settings.rules)
        self._open: _Open | None = None
        self._began = False
        self._seen = 0
        self._settled: set[int] = set()
        self._beat_s = mono_s()
        self._trying = threading.Lock()

    def begin(self, place: Place | None) -> None:
        """Go on where the log says, or begin at the present: old alarms are no news."""
        if place is not None and self._source.written_ns(place.cursor) == place.cursor_wall_utc_ns:
            self._seen, self._settled = place.cursor, set(place.settled)
            self.state.began = f"went on behind event {place.cursor}"
            self._resume(place.sending)
        elif place is None and not self._source.has_started():
            self._report_start("begins with the test's first event")
        else:
            self._seen = self._source.last_event_id()
            why = (
                "these notifications are new to the test"
                if place is None
                else f"the catalogue does not have event {place.cursor} as it was told: it was made again"
            )
            self._report_start(
                f"begins at the present, behind event {self._seen}: {why}; "
                f"{self._source.standing()} alarms that stand already are not sent"
            )
        self._began = True

    def step(self) -> float:
        """Do what is due, at most one message and one sign of life; return how long nothing else is, in s.

        Raises
        ------
        StorageError
            The catalogue cannot be read now.
        """
        if not self._began:
            self._resume_heartbeat()
            self.begin(self._log.places([self.name]).get(self.name))
        self._take_in()
        self._beat()
        self._deliver()
        self.state.waiting = len(self._waiting) + (len(self._open.news) if self._open else 0)
        return self._pause_s()

    def test(self, author: str) -> Outcome:
        """Send a message that is marked as a trial, once.

        Raises
        ------
        BusyError
            Another trial is under way.
        """
        if not self._trying.acquire(blocking=False):
            raise BusyError(f"a trial of {self.name} is under way; wait for its result")
        try:
            message = trial_message(self._source.test(), self.name, author, now_ns=self._now_ns())
            outcome = self._attempted(self._try_out, message)
            what: What = "tested" if outcome.ok else "test_failed"
            self._note(what, outcome.told, key=message.key, attempts=1, moved=False)
            return outcome
        finally:
            self._trying.release()

    # What comes in

    def _take_in(self) -> None:
        if len(self._waiting) >= MOST_WAITING:
            return
        rows = self._source.alarm_events(self._seen, PAGE_EVENTS)
        passed: list[int] = []
        held_back: list[int] = []
        too_old: list[int] = []
        for row in rows:
            assert row.id is not None, "it is stored"
            self._seen = row.id
            try:
                news = news_of(row)
            except (KeyError, TypeError, ValueError, AttributeError):
                log.exception("event %s cannot be read and is not sent", row.id)
                news = None
            rule = None if news is None else rule_of(news, self.name, self._settings.rules)
            if row.id in self._settled:
                continue
            if news is None or rule is None:
                passed.append(row.id)
            elif self._is_too_old(news):
                too_old.append(row.id)
            else:
                age_s = (self._now_ns() - news.wall_utc_ns) / NS_PER_S
                held_back += self._waiting.add(news, rule, now_s=self._mono_s(), age_s=age_s)
        self._settled |= {*passed, *held_back, *too_old}
        if too_old:
            self._gave_up(too_old, f"{len(too_old)} news are older than {self._settings.give_up_h:g} h")
        if held_back:
            self._note("held_back", "over within its delay, or its end is not wanted", held_back)
        if passed and not held_back and not too_old:
            self._note("passed", "not for this receiver", passed)

    def _is_too_old(self, news: News) -> bool:
        return self._now_ns() - news.wall_utc_ns > self._settings.give_up_h * NS_PER_H

    # What goes out

    def _deliver(self) -> None:
        if self._open is None:
            news = self._waiting.due(self._mono_s())
            if not news:
                return
            self._waiting.take(news)
            self._open = self._opened(news)
            self._note("sending", "", [item.event_id for item in news], key=self._open.key)
        opened = self._open
        if self._mono_s() < opened.next_s:
            return
        event_ids = [item.event_id for item in opened.news]
        outcome = self._attempted(self._send, self._message(opened.news))
        opened.attempts += 1
        if outcome.ok:
            self._sent(opened, event_ids, outcome)
            return
        self._failed(outcome)
        if outcome.refused and opened.attempts >= MOST_REFUSALS:
            self._close(event_ids)
            self._gave_up(event_ids, f"refused {opened.attempts} times: {outcome.told}")
        elif any(map(self._is_too_old, opened.news)):
            self._close(event_ids)
            self._gave_up(event_ids, f"not delivered within {self._settings.give_up_h:g} h: {outcome.told}")
        else:
            if opened.attempts == 1:
                self._note("failing", outcome.told, event_ids, key=opened.key, attempts=1)
            pause_s = min(LONGEST_PAUSE_S, FIRST_PAUSE_S * 2.0 ** min(opened.attempts - 1, 20))
            pause_s = max(outcome.retry_after_s, pause_s * (0.5 + self._chance()))
            opened.next_s = self._mono_s() + pause_s
            self.state.next_attempt_utc_ns = self._now_ns() + round(pause_s * NS_PER_S)

    def _sent(self, opened: _Open, event_ids: list[int], outcome: Outcome) -> None:
        self._close(event_ids)
        self.state.sent += 1
        self.state.last_sent_utc_ns = self._now_ns()
        self.state.failing_since_utc_ns = None
        self._note("sent", outcome.told, event_ids, key=opened.key, attempts=opened.attempts)

    def _failed(self, outcome: Outcome) -> None:
        self.state.failed += 1
        self.state.last_failure, self.state.last_failure_utc_ns = outcome.told, self._now_ns()
        if self.state.failing_since_utc_ns is None:
            self.state.failing_since_utc_ns = self._now_ns()
            log.warning("notifications do not reach %s, tried again: %s", self.name, outcome.told)

    def _close(self, event_ids: list[int]) -> None:
        self._settled |= set(event_ids)
        self._open = None
        self.state.next_attempt_utc_ns = None

    def _gave_up(self, event_ids: list[int], told: str) -> None:
        self.state.gave_up += 1
        log.error("notifications for %s are given up: %s", self.name, told)
        self._note("gave_up", told, event_ids)

    def _message(self, news: Sequence[News]) -> Message:
        qualities = self._source.qualities(news)
        return alarm_message(self._source.test(), self.name, news, qualities, now_ns=self._now_ns())

    def _opened(self, news: Sequence[News]) -> _Open:
        return _Open(news=news, key=key_of(self._source.test(), self.name, [one.event_id for one in news]))

    def _attempted(self, send: Send, message: Message) -> Outcome:
        try:
            return send(message)
        except UsageError as error:  # a secret that is gone meanwhile: it may come back
            return Outcome(ok=False, told=str(error))
        except Exception as error:  # noqa: BLE001 - of a package or a reply; its text may repeat the address
            return Outcome(ok=False, told=f"it could not be sent ({type(error).__name__})")

    # Signs of life

    def _beat(self) -> None:
        every_s = self._own.heartbeat_s
        if every_s is None or self._mono_s() < self._beat_s:
            return
        self._beat_s = self._mono_s() + every_s
        now_ns = self._now_ns()
        self.state.next_heartbeat_utc_ns = now_ns + round(every_s * NS_PER_S)
        facts = self._source.signs_of_life()
        if facts["recorder"] in ("silent", "absent"):
            self._beaten("withheld", f"the recorder is {facts['recorder']}: {facts['doing']}")
            return
        message = heartbeat_message(self._source.test(), self.name, facts, now_ns=now_ns)
        outcome = self._attempted(self._send, message)
        if outcome.ok:
            self.state.last_heartbeat_utc_ns = now_ns
        self._beaten("ok" if outcome.ok else "failing", outcome.told)

    @property
    def _notes_each_heartbeat(self) -> bool:
        """Only where they are hours apart: their distance then holds across restarts, too."""
        return (self._own.heartbeat_s or 0.0) >= SHORTEST_FOR_PEOPLE_S

    def _resume_heartbeat(self) -> None:
        every_s = self._own.heartbeat_s
        if every_s is not None and self._notes_each_heartbeat:
            last_ns = self._log.last_heartbeat_ns(self.name)
            past_s = every_s if last_ns is None else (self._now_ns() - last_ns) / NS_PER_S
            self._beat_s = self._mono_s() + min(every_s, max(0.0, every_s - past_s))

    def _beaten(self, state: str, told: str) -> None:
        if state != self.state.heartbeat or (self._notes_each_heartbeat and state != "withheld"):
            self._note("heartbeat", f"{state}: {told}", moved=False)
        self.state.heartbeat, self.state.heartbeat_result = state, told

    # How far it has got

    def _resume(self, event_ids: list[int]) -> None:
        """Take up the message that a crash may have cut off behind its receiver's answer."""
        found = [news_of(row) for row in self._source.events(event_ids)]
        news = [item for item in found if item is not None]
        if news:
            self._open = self._opened(news)
            self._settled |= set(event_ids)  # not read a second time

    def _place(self) -> Place:
        under_way = [item.event_id for item in self._open.news] if self._open else []
        unsettled = [*self._waiting.event_ids(), *under_way]
        cursor = min(unsettled) - 1 if unsettled else self._seen
        settled = {event_id for event_id in self._settled if event_id > cursor}
        self._settled = settled
        return Place(
            cursor=cursor,
            cursor_wall_utc_ns=self._source.written_ns(cursor) or 0,
            settled=sorted(settled - set(under_way)),
            sending=under_way,
        )

    def _report_start(self, told: str) -> None:
        self.state.began = told
        log.info("notifications for %s: %s", self.name, told)
        self._note("began", told)

    def _note(
        self,
        what: What,
        told: str,
        event_ids: Sequence[int] = (),
        *,
        key: str = "",
        attempts: int = 0,
        moved: bool = True,
    ) -> None:
        self._log.tell(
            Delivery(
                receiver=self.name,
                what=what,
                told=told,
                event_ids=list(event_ids),
                key=key,
                attempts=attempts,
                place=self._place() if moved else None,
                utc_ns=self._now_ns(),
            )
        )

    def _pause_s(self) -> float:
        """Until something is due, at most until the next look at the catalogue."""
        now_s = self._mono_s()
        due = [LOOK_EVERY_S + now_s]
        if self._open is not None:
            due.append(self._open.next_s)
        elif (next_s := self._waiting.next_s()) is not None:
            due.append(next_s)
        if self._own.heartbeat_s is not None:
            due.append(self._beat_s)
        return max(0.0, min(due) - now_s)


def is_dead(state: State, now_ns: int) -> bool:
    """Tell that a receiver has taken nothing for long."""
    since = state.failing_since_utc_ns
    return since is not None and now_ns - since > DEAD_AFTER_S * NS_PER_S
