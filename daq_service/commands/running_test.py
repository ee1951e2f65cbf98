"""The test that commands change: its stored rows, and the running one of the recorder."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from daq_service.alarms.operator_actions import remove_expired_shelf
from daq_service.alarms.states import AlarmKey, Change, Moment
from daq_service.catalogue import SetCommit
from daq_service.catalogue.rows import AlarmRow, AnnotationRow, BaselineRow
from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Clock

Alarms = Mapping[AlarmKey, AlarmRow]


PendingAnswer = Callable[[], str | None]
"""Function that returns an instrument's answer, None while there is none; a rejection raises ValueError."""


class SupplySwitch(Protocol):
    """Switch of the supply that does not wait for it; a rejection raises ValueError."""

    def supply_on(
        self, author: str, hour: float, *, voltage_v: float | None, current_limit_a: float | None
    ) -> PendingAnswer:
        """Send the command on without waiting; return a function that polls for the answer.

        Voltage in V and current limit in A are as configured if None; ``hour`` is the test hour of the
        command. Raise ValueError if it is rejected.
        """
        ...

    def supply_off(self, author: str, hour: float) -> PendingAnswer:
        """Send the command off without waiting; return a function that polls for the answer.

        ``hour`` is the test hour of the command. Raise ValueError if it is rejected.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredTest:
    """A stored test, for commands that only change rows.

    Attributes
    ----------
    moment
        Returns the time of a change.
    alarms
        The current alarms by position and kind.
    annotations
        Reads the annotations.
    store
        Stores a transaction and updates the current alarms.
    """

    moment: Callable[[], Moment]
    alarms: Alarms
    annotations: Callable[[], Sequence[AnnotationRow]]
    store: Callable[[SetCommit], None]

    def store_event(self, kind: str, payload: Mapping[str, object]) -> None:
        """Store one event of this kind, topic ``service``, at the present moment in its own transaction.

        ``payload`` is the event's data. Errors of `store` pass through.
        """
        self.store(SetCommit(events=[self.moment().event("service", kind, payload)]))

    def store_annotation(self, row: AnnotationRow, kind: str) -> None:
        """Store a new or changed annotation together with its event of this kind in one transaction.

        Errors of `store` pass through.
        """
        transaction = SetCommit()
        transaction.add_annotation(row, self.moment().event("annotations", kind, {}, position=row.position))
        self.store(transaction)

    def find_alarm(self, alarm_id: int) -> AlarmRow:
        """Return the current alarm with this id, without its shelf if that has expired; nothing is stored.

        Raise ValueError if no current alarm has the id.
        """
        (row,) = (row for row in self.alarms.values() if row.id == alarm_id)
        return remove_expired_shelf(row, utc_ns=self.moment().utc_ns, wall_utc_ns=time.time_ns())

    def store_alarm_changes(self, moment: Moment, *changes: Change) -> None:
        """Store changed alarms with their events in one transaction, also without any change.

        Errors of `store` pass through.
        """
        transaction = SetCommit()
        for change in changes:
            transaction.add_alarm(change.row, change.event(moment))
        self.store(transaction)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunningTest(StoredTest):
    """A running test, for commands that the recorder executes.

    Attributes
    ----------
    enabled
        Called with a position that may strike again.
    confirmation
        Returns the request for a confirmation set, from position, author and reason; may raise ValueError.
    positions
        The solitary-wave transducers.
    supply
        None where the test has no supply.
    settings
        Settings of the test.
    next_set
        Returns the index of the first scheduled set without a shot.
    baseline
        Returns the newest baseline of a position, None while its first one is collected.
    renewed
        Called with a position that has another baseline from its next set on.
    """

    clock: Clock
    stop: threading.Event
    enabled: Callable[[str], None]
    confirmation: Callable[[str, str, str], SetCommit]
    positions: Sequence[str]
    settings: Settings
    next_set: Callable[[], int]
    baseline: Callable[[str], BaselineRow | None]
    renewed: Callable[[str], None]
    supply: SupplySwitch | None = None

    def change_baselines(
        self, moment: Moment, *steps: tuple[BaselineRow, str], ended: Iterable[Change] = ()
    ) -> None:
        """Store changed baselines, each with its kind of event, and changed alarms in one transaction.

        Parameters
        ----------
        steps
            Baselines and the kind of their event, in the order of their events.
        ended
            Changes of alarms; their events come first.
        """
        transaction = SetCommit()
        for change in ended:
            transaction.add_alarm(change.row, change.event(moment))
        for row, kind in steps:
            transaction.add_baseline(row, moment.event("assessments", kind, {}, position=row.position))
        self.store(transaction)

    @property
    def switch(self) -> SupplySwitch:
        """Return the switch of the supply; AssertionError if the test has no supply."""
        assert self.supply is not None, "a test without one forbids the command"
        return self.supply
