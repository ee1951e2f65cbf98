"""When each set is due, scheduled or not; close those whose time is over."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence

from daq_service.acquisition.schedule import DueSet
from daq_service.recording.assembly import Parts
from hardware_drivers.nanoseconds import NS_PER_H


class DueSets:
    """Follows the schedule.

    Parameters
    ----------
    record_gap
        Called with a set whose time is over, and the reason.
    """

    def __init__(self, parts: Parts, record_gap: Callable[[DueSet, str], None]) -> None:
        self._plan, self._clock, self._in_real_time = parts.plan, parts.rig.clock, parts.in_real_time
        self._persistence, self._presence, self._waiting = parts.persistence, parts.presence, parts.waiting
        self._carried_over, self._unscheduled = parts.carried_over, parts.unscheduled
        self._self_calibration = parts.self_calibration
        self._stop, self._report, self._record_gap = parts.stop, parts.report, record_gap

    def follow(self, done: Collection[int], absences: Sequence[tuple[int, str]]) -> Iterator[DueSet]:
        """Yield each set when it is due: the caller takes it before it asks for the next one.

        Parameters
        ----------
        done
            Sets that have rows.
        absences
            Until when (ns of UTC) sets were missed for what reason, in order.
        """
        for number, due in enumerate(self._plan):
            if due.set_index in done:
                self._unscheduled.newest = due
                continue
            yield from self._unscheduled_before(due)
            self._unscheduled.next_set = due.set_index + self._carried_over.holds(due.set_index)
            if not (self._adopted(due) or self._closed_overdue(due, absences)):
                yield from self._when_due(due)
            self._unscheduled.newest = due
            if not self._stop.is_set() and not self._in_real_time:
                self._persistence.wait_for_the_disk(self._waiting.between_sets)
                self._persistence.wait_for_the_worker(self._waiting.between_sets)
            if self._stop.is_set():
                break
            self._report("progress", done=number + 1, planned=len(self._plan), due_h=due.due_h)
        yield from self._unscheduled_before(None)
        self._unscheduled.newest = None

    def _when_due(self, due: DueSet) -> Iterator[DueSet]:
        """Wait for a scheduled set; unscheduled ones that are asked for meanwhile come first."""
        self._self_calibration.before(due)
        self._presence.doing = f"waiting for set {due.set_index}"
        # Simulated time has no idle hours: there files are checked after the last set.
        self._waiting.free_until_ns = due.due_utc_ns if self._in_real_time else -math.inf
        while not self._clock.wait_until(due.due_utc_ns, self._idle_unless_asked):
            if self._stop.is_set():
                return
            yield from self._unscheduled_before(due)
            self._presence.doing = f"waiting for set {due.set_index}"
        if not self._closed_overdue(due):
            self._unscheduled.newest = due
            yield due

    def _idle_unless_asked(self) -> bool:
        return self._waiting.between_sets() and not self._unscheduled.waiting()

    def _unscheduled_before(self, due: DueSet | None) -> Iterator[DueSet]:
        return (one for one in self._unscheduled.before(due) if not self._adopted(one))

    def _adopted(self, due: DueSet) -> bool:
        """Give a file of the last recorder its rows; simulated time goes on where its set ended."""
        ended_ns = self._carried_over.adopt(due)
        if ended_ns is not None:
            self._clock.wait_until(ended_ns, self._waiting.between_sets)
        return ended_ns is not None

    def _closed_overdue(self, due: DueSet, absences: Sequence[tuple[int, str]] = ()) -> bool:
        """Close a set whose time is over, since the next one is due."""
        following = self._plan[due.set_index + 1 : due.set_index + 2]
        over_ns = following[0].due_utc_ns if following else due.due_utc_ns + NS_PER_H
        if self._clock.utc_ns() < over_ns:
            return False
        reason = next((reason for until_ns, reason in absences if due.due_utc_ns <= until_ns), "")
        self._record_gap(due, reason or self._persistence.overdue_reason(due.due_utc_ns))
        return True
