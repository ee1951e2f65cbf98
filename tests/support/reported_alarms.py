"""A receiver's line over a real catalogue, with clocks and a door that the test holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from daq_service.alarms.operator_actions import reset_alarm
from daq_service.alarms.states import Condition, Moment, update_alarm
from daq_service.catalogue import SetCommit
from daq_service.catalogue.rows import AlarmRow, EventRow
from daq_service.catalogue.writer import build_event_payload
from daq_service.processes.notifications.delivery_log import DeliveryLog
from daq_service.processes.notifications.messages import Message
from daq_service.processes.notifications.receiver import ReceiverQueue
from daq_service.processes.notifications.source import Source
from daq_service.processes.notifications.webhook import Outcome
from daq_service.settings.tree import Settings
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S
from support.machine import clock_in_seconds
from support.new_experiment import new_catalogue

TAKEN = Outcome(ok=True, description="taken (204)", status=204)
DEAD = Outcome(ok=False, description="no answer within 15 s")
BEGAN_NS = 1_700_000_000 * NS_PER_S
DUTY = {"url": "http://127.0.0.1:1/hook", "secret_env": "DUTY_SECRET"}


def notifying(receivers: dict[str, Any] | None = None, **further: Any) -> Settings:
    """Return settings with receivers; by default one that is notified at once."""
    return Settings(notifications={"receivers": receivers or {"duty": DUTY}, **further})


class Alarms:
    """Alarms raised and ended as by a recorder, at the wall time of `now_ns`."""

    def __init__(self, folder: Path, now_ns: Callable[[], int]) -> None:
        self.catalogue = new_catalogue(folder)
        self._now_ns = now_ns

    def change(self, kind: str = "wall_change", *, present: bool = True, **further: Any) -> int:
        """Update an alarm by an assessment; return the id of its event."""
        condition = Condition(
            **{
                "position": "B",
                "alarm_class": "damage",
                "priority": "high",
                **further,
            },
            kind=kind,
            present=present,
        )
        rows = self.catalogue.rows(AlarmRow, position=condition.position, kind=kind)
        moment = Moment(utc_ns=36 * NS_PER_H, due_h=36.0, set_index=72)
        change = update_alarm(rows[-1] if rows else None, condition, moment)
        assert change is not None, "nothing changes"
        return self._commit(change.row, change.event_kind)

    def reset(self, kind: str) -> int:
        """Reset a latched alarm as an operator does."""
        (row,) = self.catalogue.rows(AlarmRow, kind=kind, active=True)
        change = reset_alarm(row, "ann", "put right", Moment(utc_ns=0, due_h=0.0, set_index=None))
        return self._commit(change.row, change.event_kind)

    def _commit(self, row: AlarmRow, kind: str) -> int:
        event = EventRow(
            utc_ns=row.changed_utc_ns,
            wall_utc_ns=self._now_ns(),
            topic="alarms",
            kind=kind,
            position=row.position,
            payload=build_event_payload(row, last="id"),
        )
        commit = SetCommit(alarms=[row], events=[event], alarm_of_event={0: 0})
        (event_id,) = self.catalogue.commit_set(commit).event_ids
        return event_id


class Bench:
    """Bench with one receiver called duty: `run` lets time pass, `sent` is what was sent."""

    def __init__(self, folder: Path, settings: Settings | None = None) -> None:
        self.folder, self.settings = folder, settings or notifying()
        self.mono_s, self.sent, self.outcomes = 0.0, list[Message](), list[Outcome]()
        self.alarms = Alarms(folder, self.now_ns)
        self.log = DeliveryLog(folder)
        self.line = self.restarted()

    def now_ns(self) -> int:
        return BEGAN_NS + round(self.mono_s * NS_PER_S)

    def restarted(self, *, name: str = "duty") -> ReceiverQueue:
        """Restart as a new process that knows only the data on disk."""
        self.line = ReceiverQueue(
            name,
            self.settings.notifications,
            Source(self.settings, self.folder, lambda: self.alarms.catalogue),
            self.log,
            self._send,
            self._send,
            machine=replace(clock_in_seconds(lambda: self.mono_s), utc_ns=self.now_ns),
            random_fraction=lambda: 0.5,
        )
        return self.line

    def _send(self, message: Message) -> Outcome:
        self.sent.append(message)
        return self.outcomes.pop(0) if self.outcomes else TAKEN

    def run(self, seconds: float = 0.0, *, at_least_s: float = 0.0) -> list[Message]:
        """Let time pass with a minimum step; return the notifications sent meanwhile."""
        before, end_s = len(self.sent), self.mono_s + seconds
        while True:
            pause_s = max(at_least_s, self.line.step())
            if self.mono_s + pause_s > end_s:
                break
            self.mono_s += pause_s
        self.mono_s = end_s
        self.line.step()
        return self.sent[before:]

    def log_lines(self, what: str) -> list[Any]:
        """Return lines of the log of one kind, the oldest first."""
        found, _ = self.log.read(limit=1000)
        return [line for _, line in reversed(found) if line.what == what]
