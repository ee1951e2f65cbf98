"""Which unscheduled sets wait, whether there is time for one, and a person's request for one."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence

from daq_service.acquisition.schedule import DueSet
from daq_service.alarms.states import Moment
from daq_service.assessment.confirmation import overlap_reason
from daq_service.assessment.transaction import Transaction
from daq_service.recording.carried_over import CarriedOver
from daq_service.recording.persistence import Persistence
from daq_service.recording.set_assessor import SetAssessor
from hardware_drivers.measurement import in_order
from hardware_drivers.nanoseconds import NS_PER_H


class UnscheduledSets:
    """Unscheduled sets that are asked for.

    Attributes
    ----------
    newest
        Scheduled set that was taken last; None before the first one and after the last one.
    next_set
        Index of the first scheduled set of which no shot is struck yet.
    """

    def __init__(
        self,
        plan: Sequence[DueSet],
        assessor: SetAssessor,
        persistence: Persistence,
        carried_over: CarriedOver,
        moment: Callable[[], Moment],
        stop: threading.Event,
    ) -> None:
        self._plan, self._set_assessor, self._persistence = plan, assessor, persistence
        self._carried_over, self._moment, self._stop = carried_over, moment, stop
        self._started: set[int] = set()
        self.newest: DueSet | None = None
        self.next_set = 0

    def waiting(self) -> list[DueSet]:
        """List what waits, in the order of the sets; what was started waits for the disk at most."""
        asked = {index: one.due for index, one in self._set_assessor.confirmations.waiting.items()}
        asked = {due.set_index: due for due in self._carried_over.unscheduled()} | asked
        return [asked[index] for index in sorted(asked.keys() - self._started, key=in_order)]

    def before(self, scheduled: DueSet | None) -> Iterator[DueSet]:
        """Yield what to take before a scheduled set; None: after the last one."""
        for due in self.waiting():
            after, _ = in_order(due.set_index)
            if not self._stop.is_set() and (scheduled is None or after < scheduled.set_index):
                self._started.add(due.set_index)
                yield due

    def hindrance(self, due: DueSet) -> str:
        """State why a set comes too late, or strikes a disabled transducer; empty: it may be taken."""
        assert due.position is not None, "it is unscheduled"
        if retired := self._set_assessor.retired().get(due.position):
            return retired
        now_ns = self._moment().utc_ns
        if now_ns > due.due_utc_ns + NS_PER_H:
            return self._persistence.overdue_reason(due.due_utc_ns)
        after, _ = in_order(due.set_index)
        confirmations = self._set_assessor.confirmations
        return overlap_reason(confirmations.room_ns(self._plan[after], now_ns), confirmations.set_ns)

    def request(self, position: str, author: str, note: str) -> Transaction:
        """Ask for a set by a person's command; it is taken once the line is free.

        Raises
        ------
        ValueError
            It cannot be taken, and why.
        """
        if self.newest is None:
            raise ValueError(
                "no planned set was taken yet, or none is left: nothing is struck beside the plan"
            )
        return self._set_assessor.order_confirmation(self.newest, position, author, note, self._moment())
