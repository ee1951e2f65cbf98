"""The test that orders act on: what is stored of any, and the one that the recorder runs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from daq_service.alarms.states import Change, Moment, as_it_stands
from daq_service.assessment.transaction import Transaction
from daq_service.catalogue.rows import AlarmRow, AnnotationRow, BaselineRow
from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Clock

AlarmKey = tuple[str | None, str]
Alarms = Mapping[AlarmKey, AlarmRow]


Awaited = Callable[[], str | None]
"""Returns an instrument's answer, None while there is none; a refusal is a ValueError."""


class SupplySwitch(Protocol):
    """Switches the corrosion drive without waiting for it; a refusal is a ValueError."""

    def supply_on(
        self, author: str, hour: float, *, voltage_v: float | None, current_limit_a: float | None
    ) -> Awaited:
        """Switch it on; voltage and limit as configured where not given."""
        ...

    def supply_off(self, author: str, hour: float) -> Awaited:
        """Switch it off."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredTest:
    """What an order may act on that changes rows only.

    Attributes
    ----------
    moment
        Tells the moment of what is told or changed now.
    alarms
        The current alarms by position and kind.
    annotations
        Reads them.
    store
        Stores a transaction and takes its alarms over.
    """

    moment: Callable[[], Moment]
    alarms: Alarms
    annotations: Callable[[], Sequence[AnnotationRow]]
    store: Callable[[Transaction], None]

    def tell(self, kind: str, payload: Mapping[str, Any]) -> None:
        """Store an event of the service itself."""
        transaction = Transaction()
        transaction.tell(kind, payload, self.moment())
        self.store(transaction)

    def annotate(self, row: AnnotationRow, kind: str) -> None:
        """Store an annotation, or what becomes of one."""
        transaction = Transaction()
        transaction.annotate(row, kind, self.moment())
        self.store(transaction)

    def alarm(self, alarm_id: int) -> AlarmRow:
        """Tell a current alarm, as it stands now."""
        (row,) = (row for row in self.alarms.values() if row.id == alarm_id)
        return as_it_stands(row, utc_ns=self.moment().utc_ns, wall_utc_ns=time.time_ns())

    def change_alarms(self, moment: Moment, *changes: Change) -> None:
        """Store what became of alarms, together."""
        transaction = Transaction()
        for change in changes:
            transaction.add_alarm(change, moment)
        self.store(transaction)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunningTest(StoredTest):
    """What an order to the recorder may act on.

    Attributes
    ----------
    reinstated
        Called with a position that may strike again.
    confirmation
        Makes what asks for a confirmation set, of position, author and reason; a refusal is a ValueError.
    positions
        The solitary-wave transducers.
    supply
        None where the test has no supply.
    settings
        What the test was begun with.
    next_set
        Index of the first planned set of which no shot is struck yet.
    baseline
        Newest baseline of a position, None while its first one is being recorded.
    renewed
        Called with a position that is judged against another baseline from its next set on.
    """

    clock: Clock
    stop: threading.Event
    reinstated: Callable[[str], None]
    confirmation: Callable[[str, str, str], Transaction]
    positions: Sequence[str]
    settings: Settings
    next_set: Callable[[], int]
    baseline: Callable[[str], BaselineRow | None]
    renewed: Callable[[str], None]
    supply: SupplySwitch | None = None

    def change_baselines(
        self, moment: Moment, *steps: tuple[BaselineRow, str], ended: Iterable[Change] = ()
    ) -> None:
        """Store what a person made of baselines, each with the kind of its event, and of alarms, together."""
        transaction = Transaction()
        for change in ended:
            transaction.add_alarm(change, moment)
        for row, kind in steps:
            transaction.change_baseline(row, kind, moment)
        self.store(transaction)

    @property
    def switch(self) -> SupplySwitch:
        """The supply of a test that has one."""
        assert self.supply is not None, "a test without one forbids the order"
        return self.supply
