"""Queue of one receiver: reads events of alarms after its cursor, and sends the selected ones in order.

After a restart, waiting events are read again from the catalogue: there is no other queue. A message is
logged before its first attempt and after its last one (`delivery_log`).
"""

from __future__ import annotations

import logging
import random
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from daq_service.clock import MACHINE, MachineClock
from daq_service.errors import BusyError, UsageError
from daq_service.processes.notifications import messages
from daq_service.processes.notifications.delivery_log import Delivery, DeliveryKind, DeliveryLog, Progress
from daq_service.processes.notifications.rules import WaitingChanges, find_matching_rule
from daq_service.processes.notifications.source import Source
from daq_service.processes.notifications.webhook import Outcome
from daq_service.settings.notifications import SHORTEST_FOR_PEOPLE_S, NotificationSettings
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S

log = logging.getLogger(__name__)

LOOK_EVERY_S = 0.5
PAGE_EVENTS = 200
MOST_WAITING = 500
"""Changes kept in memory; later ones wait in the catalogue."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 2.0, 300.0
"""Between two attempts: doubled each time, times a random factor of 0.5 to 1.5."""
MOST_REFUSALS = 5
"""After this many refusals, a message is dropped and the next one is sent."""
DEAD_AFTER_S = 600.0
"""A receiver that accepts nothing for this time is shown as a warning."""

Send = Callable[[messages.Message], Outcome]


@dataclass(slots=True, kw_only=True, eq=False)
class State:
    """State of a receiver for page and metrics; times are of the wall clock."""

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
class _OpenMessage:
    """Message in progress."""

    changes: Sequence[messages.AlarmChange]
    key: str
    attempts: int = 0
    next_s: float = 0.0

    @property
    def event_ids(self) -> list[int]:
        """Return the ids of the events in the message, in the order of its changes."""
        return [change.event_id for change in self.changes]


class ReceiverQueue:
    """Queue of a receiver, advanced by `step`; `test` may run in another thread at the same time."""

    def __init__(
        self,
        name: str,
        settings: NotificationSettings,
        source: Source,
        deliveries: DeliveryLog,
        send: Send,
        send_test: Send,
        *,
        machine: MachineClock = MACHINE,
        random_fraction: Callable[[], float] = random.random,
    ) -> None:
        self.name, self.state = name, State()
        self._settings, self._receiver = settings, settings.receivers[name]
        self._source, self._delivery_log, self._send, self._send_test = source, deliveries, send, send_test
        self._machine, self._random_fraction = machine, random_fraction
        self._waiting = WaitingChanges(settings.rules)
        self._current: _OpenMessage | None = None
        self._started = False
        self._last_read_id = 0
        self._settled: set[int] = set()
        self._heartbeat_due_s = machine.mono_s()
        self._test_lock = threading.Lock()

    def start(self, progress: Progress | None) -> None:
        """Start at the logged progress, else after the newest event, or at the first of a new test."""
        if progress is not None and self._source.written_ns(progress.cursor) == progress.cursor_wall_utc_ns:
            self._last_read_id, self._settled = progress.cursor, set(progress.settled)
            self.state.began = f"went on behind event {progress.cursor}"
            self._resume_message(progress.sending)
        elif progress is None and not self._source.has_started():
            self._report_start("starts with the test's first event")
        else:
            self._last_read_id = self._source.last_event_id()
            reason = (
                "these notifications are new to the test"
                if progress is None
                else f"the catalogue does not have event {progress.cursor} as it was reported: it was rebuilt"
            )
            self._report_start(
                f"starts at the present, after event {self._last_read_id}: {reason}; "
                f"{self._source.count_active_alarms()} alarms that are already active are not sent"
            )
        self._started = True

    def step(self) -> float:
        """Read new events, send at most one due message and one heartbeat; return the s to the next step.

        Raises StorageError if the catalogue cannot be read now, and OSError if the delivery log cannot.
        """
        if not self._started:
            self._resume_heartbeat()
            self.start(self._delivery_log.read_progress([self.name]).get(self.name))
        self._read_events()
        self._send_heartbeat()
        self._deliver_due()
        self.state.waiting = len(self._waiting) + (len(self._current.changes) if self._current else 0)
        return self._compute_pause_s()

    def test(self, author: str) -> Outcome:
        """Send a test message once; return its outcome, or raise BusyError if another one is in progress."""
        if not self._test_lock.acquire(blocking=False):
            raise BusyError(f"a trial of {self.name} is under way; wait for its result")
        try:
            now_ns = self._machine.utc_ns()
            message = messages.build_test_message(self._source.test(), self.name, author, now_ns=now_ns)
            outcome = self._try_delivery(self._send_test, message)
            kind: DeliveryKind = "tested" if outcome.ok else "test_failed"
            attempt = _OpenMessage(changes=(), key=message.key, attempts=1)
            self._log_delivery(kind, outcome.description, message=attempt, with_progress=False)
            return outcome
        finally:
            self._test_lock.release()

    # Incoming events

    def _read_events(self) -> None:
        """Read up to 200 new alarm events unless 500 changes wait; settle and log those not sent."""
        if len(self._waiting) >= MOST_WAITING:
            return
        rows = self._source.alarm_events(self._last_read_id, PAGE_EVENTS)
        skipped_ids: list[int] = []
        not_sent_ids: list[int] = []
        outdated_ids: list[int] = []
        for row in rows:
            assert row.id is not None, "it is stored"
            self._last_read_id = row.id
            try:
                change = messages.parse_alarm_change(row)
            except (KeyError, TypeError, ValueError, AttributeError):
                log.exception("event %s cannot be read and is not sent", row.id)
                change = None
            rule = None if change is None else find_matching_rule(change, self.name, self._settings.rules)
            if row.id in self._settled:
                continue
            if change is None or rule is None:
                skipped_ids.append(row.id)
            elif self._is_too_old(change):
                outdated_ids.append(row.id)
            else:
                age_s = (self._machine.utc_ns() - change.wall_utc_ns) / NS_PER_S
                not_sent_ids += self._waiting.add(change, rule, now_s=self._machine.mono_s(), age_s=age_s)
        self._settled |= {*skipped_ids, *not_sent_ids, *outdated_ids}
        if outdated_ids:
            self._give_up(
                outdated_ids, f"{len(outdated_ids)} news are older than {self._settings.give_up_h:g} h"
            )
        if not_sent_ids:
            self._log_delivery("held_back", "over within its delay, or its end is not wanted", not_sent_ids)
        if skipped_ids and not not_sent_ids and not outdated_ids:
            self._log_delivery("passed", "not for this receiver", skipped_ids)

    def _is_too_old(self, change: messages.AlarmChange) -> bool:
        """Return whether a change was written more than ``give_up_h`` ago, by the wall clock."""
        return self._machine.utc_ns() - change.wall_utc_ns > self._settings.give_up_h * NS_PER_H

    # Outgoing messages

    def _deliver_due(self) -> None:
        """Send due changes as one message or retry it; give up after 5 refusals or ``give_up_h``."""
        if self._current is None:
            changes = self._waiting.due(self._machine.mono_s())
            if not changes:
                return
            self._waiting.remove(changes)
            self._current = self._build_open_message(changes)
            self._log_delivery("sending", "", message=self._current)
        current = self._current
        if self._machine.mono_s() < current.next_s:
            return
        test, qualities = self._source.test(), self._source.read_qualities(current.changes)
        now_ns = self._machine.utc_ns()
        message = messages.build_alarm_message(test, self.name, current.changes, qualities, now_ns=now_ns)
        outcome = self._try_delivery(self._send, message)
        current.attempts += 1
        if outcome.ok:
            self._close(current)
            self.state.sent += 1
            self.state.last_sent_utc_ns = self._machine.utc_ns()
            self.state.failing_since_utc_ns = None
            self._log_delivery("sent", outcome.description, message=current)
            return
        self._record_failure(outcome)
        if outcome.refused and current.attempts >= MOST_REFUSALS:
            self._close(current)
            self._give_up(current.event_ids, f"refused {current.attempts} times: {outcome.description}")
        elif any(map(self._is_too_old, current.changes)):
            self._close(current)
            late = f"not delivered within {self._settings.give_up_h:g} h: {outcome.description}"
            self._give_up(current.event_ids, late)
        else:
            if current.attempts == 1:
                self._log_delivery("failing", outcome.description, message=current)
            pause_s = min(LONGEST_PAUSE_S, FIRST_PAUSE_S * 2.0 ** min(current.attempts - 1, 20))
            pause_s = max(outcome.retry_after_s, pause_s * (0.5 + self._random_fraction()))
            current.next_s = self._machine.mono_s() + pause_s
            self.state.next_attempt_utc_ns = self._machine.utc_ns() + round(pause_s * NS_PER_S)

    def _record_failure(self, outcome: Outcome) -> None:
        """Add a failed attempt to the state; log a warning at the first one since a success."""
        self.state.failed += 1
        self.state.last_failure, self.state.last_failure_utc_ns = outcome.description, self._machine.utc_ns()
        if self.state.failing_since_utc_ns is None:
            self.state.failing_since_utc_ns = self._machine.utc_ns()
            log.warning("notifications do not reach %s, tried again: %s", self.name, outcome.description)

    def _close(self, message: _OpenMessage) -> None:
        """Mark the events of the message in progress as settled and end it; the next one can be sent."""
        self._settled |= set(message.event_ids)
        self._current = None
        self.state.next_attempt_utc_ns = None

    def _give_up(self, event_ids: list[int], description: str) -> None:
        """Count a dropped message and log the reason, as an error and in the delivery log."""
        self.state.gave_up += 1
        log.error("notifications for %s are given up: %s", self.name, description)
        self._log_delivery("gave_up", description, event_ids)

    def _build_open_message(self, changes: Sequence[messages.AlarmChange]) -> _OpenMessage:
        """Build the message in progress for these changes, with its key and no attempt yet."""
        key = messages.derive_key(self._source.test(), self.name, [change.event_id for change in changes])
        return _OpenMessage(changes=changes, key=key)

    def _try_delivery(self, send: Send, message: messages.Message) -> Outcome:
        """Try once to deliver a message; return every exception as a failed outcome."""
        try:
            return send(message)
        except UsageError as error:  # a secret that is missing now: it may come back
            return Outcome(ok=False, description=str(error))
        except Exception as error:  # noqa: BLE001 - of any package; its text may repeat the address
            return Outcome(ok=False, description=f"it could not be sent ({type(error).__name__})")

    # Heartbeats

    def _send_heartbeat(self) -> None:
        """Send a heartbeat message if one is due; withhold it while the recorder does not respond."""
        every_s = self._receiver.heartbeat_s
        if every_s is None or self._machine.mono_s() < self._heartbeat_due_s:
            return
        self._heartbeat_due_s = self._machine.mono_s() + every_s
        now_ns = self._machine.utc_ns()
        self.state.next_heartbeat_utc_ns = now_ns + round(every_s * NS_PER_S)
        facts = self._source.read_heartbeat_facts()
        if facts["recorder"] in ("not_responding", "not_started"):
            self._report_heartbeat("withheld", f"the recorder is {facts['recorder']}: {facts['doing']}")
            return
        message = messages.build_heartbeat_message(self._source.test(), self.name, facts, now_ns=now_ns)
        outcome = self._try_delivery(self._send, message)
        if outcome.ok:
            self.state.last_heartbeat_utc_ns = now_ns
        self._report_heartbeat("ok" if outcome.ok else "failing", outcome.description)

    @property
    def _logs_each_heartbeat(self) -> bool:
        """Return whether each heartbeat is logged: at intervals of 3600 s or more."""
        return (self._receiver.heartbeat_s or 0.0) >= SHORTEST_FOR_PEOPLE_S

    def _resume_heartbeat(self) -> None:
        """Compute the due time of the next heartbeat from the last logged one, if each is logged."""
        every_s = self._receiver.heartbeat_s
        if every_s is not None and self._logs_each_heartbeat:
            last_ns = self._delivery_log.find_last_heartbeat_ns(self.name)
            past_s = every_s if last_ns is None else (self._machine.utc_ns() - last_ns) / NS_PER_S
            self._heartbeat_due_s = self._machine.mono_s() + min(every_s, max(0.0, every_s - past_s))

    def _report_heartbeat(self, state: str, description: str) -> None:
        """Store the result of a heartbeat; log a change of state, or each one at long intervals."""
        if state != self.state.heartbeat or (self._logs_each_heartbeat and state != "withheld"):
            self._log_delivery("heartbeat", f"{state}: {description}", with_progress=False)
        self.state.heartbeat, self.state.heartbeat_result = state, description

    # Progress

    def _resume_message(self, event_ids: list[int]) -> None:
        """Make stored events the message in progress; ids without an alarm change are left out."""
        found = map(messages.parse_alarm_change, self._source.events(event_ids))
        changes = [change for change in found if change is not None]
        if changes:
            self._current = self._build_open_message(changes)
            self._settled |= set(event_ids)  # not read a second time

    def _build_progress(self) -> Progress:
        """Build the present progress; settled ids up to the cursor are deleted from memory."""
        ids_in_progress = self._current.event_ids if self._current else []
        unsettled = [*self._waiting.event_ids(), *ids_in_progress]
        cursor = min(unsettled) - 1 if unsettled else self._last_read_id
        settled = {event_id for event_id in self._settled if event_id > cursor}
        self._settled = settled
        return Progress(
            cursor=cursor,
            cursor_wall_utc_ns=self._source.written_ns(cursor) or 0,
            settled=sorted(settled - set(ids_in_progress)),
            sending=ids_in_progress,
        )

    def _report_start(self, description: str) -> None:
        """Store and log where notifications start, also in the delivery log."""
        self.state.began = description
        log.info("notifications for %s: %s", self.name, description)
        self._log_delivery("began", description)

    def _log_delivery(
        self,
        kind: DeliveryKind,
        description: str,
        event_ids: Sequence[int] = (),
        *,
        message: _OpenMessage | None = None,
        with_progress: bool = True,
    ) -> None:
        """Append a line to the delivery log, with the present progress unless excluded."""
        self._delivery_log.append(
            Delivery(
                receiver=self.name,
                what=kind,
                result=description,
                event_ids=list(event_ids) if message is None else message.event_ids,
                key="" if message is None else message.key,
                attempts=0 if message is None else message.attempts,
                place=self._build_progress() if with_progress else None,
                utc_ns=self._machine.utc_ns(),
            )
        )

    def _compute_pause_s(self) -> float:
        """Return the time until something can be due, s, from 0 to 0.5."""
        now_s = self._machine.mono_s()
        due = [LOOK_EVERY_S + now_s]
        if self._current is not None:
            due.append(self._current.next_s)
        elif (next_s := self._waiting.next_s()) is not None:
            due.append(next_s)
        if self._receiver.heartbeat_s is not None:
            due.append(self._heartbeat_due_s)
        return max(0.0, min(due) - now_s)


def is_receiver_dead(state: State, now_ns: int) -> bool:
    """Return whether every attempt has failed for more than 600 s; ``now_ns`` is the present UTC in ns."""
    since = state.failing_since_utc_ns
    return since is not None and now_ns - since > DEAD_AFTER_S * NS_PER_S
