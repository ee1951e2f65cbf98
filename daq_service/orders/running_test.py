"""The test that the recorder runs, as its orders meet it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from daq_service.alarms.states import Change, Moment
from daq_service.catalogue.rows import AlarmRow
from daq_service.judgement.transaction import Transaction
from hardware_drivers.instruments import Clock

AlarmKey = tuple[str | None, str]
Alarms = Mapping[AlarmKey, AlarmRow]


class SupplySwitch(Protocol):
    """Who switches the corrosion drive; a refusal is a ValueError."""

    def supply_on(
        self, author: str, hour: float, *, voltage_v: float | None, current_limit_a: float | None
    ) -> str:
        """Switch it on; voltage and limit as configured where not given."""
        ...

    def supply_off(self, author: str, hour: float) -> str:
        """Switch it off."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class RunningTest:
    """What an order may act on.

    Attributes
    ----------
    hour
        Tells the hour of the experiment.
    alarms
        The recorder's current alarms by position and kind.
    store
        Stores a transaction and takes its alarms over.
    reinstated
        Called with a position that may strike again.
    positions
        The solitary-wave transducers.
    supply
        None where the test has no supply.
    """

    clock: Clock
    hour: Callable[[], float]
    stop: threading.Event
    alarms: Alarms
    store: Callable[[Transaction], None]
    reinstated: Callable[[str], None]
    positions: Sequence[str]
    supply: SupplySwitch | None = None

    @property
    def switch(self) -> SupplySwitch:
        """The supply of a test that has one."""
        assert self.supply is not None, "a test without one forbids the order"
        return self.supply

    def moment(self) -> Moment:
        """Return the moment of what is told or changed now."""
        return Moment(utc_ns=self.clock.utc_ns(), due_h=self.hour(), set_index=None)

    def tell(self, kind: str, payload: Mapping[str, Any]) -> None:
        """Store an event of the service itself."""
        transaction = Transaction()
        transaction.tell(kind, payload, self.moment())
        self.store(transaction)

    def change_alarms(self, moment: Moment, *changes: Change) -> None:
        """Store what became of alarms, together."""
        transaction = Transaction()
        for change in changes:
            transaction.add_alarm(change, moment)
        self.store(transaction)
