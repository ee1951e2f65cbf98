"""When each set is due, scheduled or not; sets whose time is over are closed."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Collection, Iterator, Sequence

from daq_service.assessment.confirmation import explain_overlap
from daq_service.commands.execution import CommandExecutor
from daq_service.errors import RigError
from daq_service.recording.carried_over import CarriedOver
from daq_service.recording.opening import is_transient
from daq_service.recording.persistence import Persistence
from daq_service.recording.resources import Resources
from daq_service.recording.set_assessor import SetAssessor
from daq_service.recording.waiting import Waiting
from hardware_drivers.errors import InstrumentError
from hardware_drivers.measurement import DueSet, SetKey
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S

log = logging.getLogger(__name__)

SELF_CALIBRATION_TAKES_NS = 180 * NS_PER_S
"""A board's self-calibration takes up to two minutes: it is started only when there is time for it. The first
one comes at once, since it is unknown how long the boards have been warm."""


class DueSets:
    """Follows the schedule; unscheduled sets are taken between scheduled ones.

    Parameters
    ----------
    record_gap
        Called with a set whose time is over, and the reason.
    """

    def __init__(
        self,
        resources: Resources,
        assessor: SetAssessor,
        persistence: Persistence,
        carried_over: CarriedOver,
        waiting: Waiting,
        record_gap: Callable[[DueSet, str], None],
        commands: CommandExecutor,
    ) -> None:
        """Keep the parts of the recorder; no set is started, and the boards count as not calibrated."""
        self._resources, self._plan, self._rig = resources, resources.plan, resources.rig
        self._clock, self._stop = resources.rig.clock, resources.stop
        self._set_assessor, self._persistence = assessor, persistence
        self._carried_over, self._waiting, self._record_gap = carried_over, waiting, record_gap
        self._commands = commands
        self._started_unscheduled: set[SetKey] = set()
        self._calibrated_ns: int | None = None
        self._reported_due = not resources.in_real_time

    def follow(self, done: Collection[SetKey], absences: Sequence[tuple[int, str]]) -> Iterator[DueSet]:
        """Yield each set when it is due: the caller takes it before it asks for the next one.

        It blocks in between, stores rows of files that have none, closes sets whose time is over, and ends
        when the recorder stops. Raises RigError if a self-calibration fails for good.

        Parameters
        ----------
        done
            Sets that have rows.
        absences
            Until when (ns of UTC) sets were missed for what reason, in order.
        """
        for number, due in enumerate(self._plan):
            if due.set_key in done:
                self._waiting.newest = due
                continue
            yield from self._yield_unscheduled_sets(due)
            self._waiting.next_set = due.set_index + self._carried_over.has_strikes_of(due.set_key)
            if not (self._store_rows_of_file(due) or self._close_if_overdue(due, absences)):
                yield from self._wait_for_scheduled_set(due)
            self._waiting.newest = due
            if not self._stop.is_set() and not self._resources.in_real_time:
                self._waiting.wait_until_stored()
                self._waiting.wait_for_worker()
            if self._stop.is_set():
                break
            self._resources.report("progress", done=number + 1, planned=len(self._plan), due_h=due.due_h)
        yield from self._yield_unscheduled_sets(None)
        self._waiting.newest = None

    def _wait_for_scheduled_set(self, due: DueSet) -> Iterator[DueSet]:
        """Block until a scheduled set is due and yield it; unscheduled ones requested meanwhile come first.

        Yields nothing more if the recorder stops, or if the set's time is over after these. Boards calibrate
        themselves before, if that is due (RigError).
        """
        if not self._reported_due:
            self._reported_due = True
            in_s = max(0.0, (due.due_utc_ns - self._clock.utc_ns()) / NS_PER_S)
            which = {"set_index": due.set_index, "due_h": due.due_h, "due_utc_ns": due.due_utc_ns}
            self._resources.report("due", **which, in_s=in_s)
        self._self_calibrate_if_due(due)
        # Simulated time has no idle hours: there files are checked after the last set.
        self._waiting.free_until_ns = due.due_utc_ns if self._resources.in_real_time else -math.inf
        self._waiting.activity.doing = f"waiting for set {due.set_index}"
        while not self._clock.wait_until(due.due_utc_ns, self._is_still_idle):
            if self._stop.is_set():
                return
            yield from self._yield_unscheduled_sets(due)
            self._waiting.activity.doing = f"waiting for set {due.set_index}"
        if not self._close_if_overdue(due):
            self._waiting.newest = due
            yield due

    def _store_rows_of_file(self, due: DueSet) -> bool:
        """Store the rows of a set that the last recorder left as a file; return False if there is none.

        Simulated time continues where that set ended. Raises ArchiveError if the file cannot be read.
        """
        ended_ns = self._carried_over.adopt(due)
        if ended_ns is not None:
            self._clock.wait_until(ended_ns, self._waiting.run_between_sets)
        return ended_ns is not None

    def _close_if_overdue(self, due: DueSet, absences: Sequence[tuple[int, str]] = ()) -> bool:
        """Record a set as missed if the next one is due already; return whether it was.

        The last set has one hour. The reason is that of the first absence (ns of UTC, text) that covers it,
        else trouble of the disk, else sleep of the computer.
        """
        following = self._plan[due.set_index + 1 : due.set_index + 2]
        over_ns = following[0].due_utc_ns if following else due.due_utc_ns + NS_PER_H
        if self._clock.utc_ns() < over_ns:
            return False
        reason = next((reason for until_ns, reason in absences if due.due_utc_ns <= until_ns), "")
        self._record_gap(due, reason or self._waiting.storage.find_overdue_reason(due.due_utc_ns))
        return True

    def _self_calibrate_if_due(self, due: DueSet) -> None:
        """Run the self-calibration of the boards, if its interval is over and three minutes are left.

        Blocks meanwhile; the first one needs no such time. Raises RigError if it fails for good; a transient
        failure is logged. The result is stored as an event.
        """
        self_calibrating, interval_h = self._rig.self_calibrating, self._rig.self_calibration_interval_h
        if self_calibrating is None or not interval_h:
            return
        now_ns = self._clock.utc_ns()
        age_h = math.inf if self._calibrated_ns is None else (now_ns - self._calibrated_ns) / NS_PER_H
        has_time = due.due_utc_ns - now_ns > SELF_CALIBRATION_TAKES_NS or self._calibrated_ns is None
        if age_h < interval_h or not has_time:
            return
        self._waiting.activity.announce(f"self-calibration before set {due.set_index}")
        try:
            result = self_calibrating.self_calibrate()
        except InstrumentError as error:
            if not is_transient(error, proven=self._set_assessor.proven):
                raise RigError(f"self-calibration before set {due.set_index} failed: {error}") from error
            log.warning("self-calibration before set %d failed: %s", due.set_index, error)
            result = {"failed": str(error)}
        self._calibrated_ns = now_ns
        self._persistence.say("self_calibrated", dict(result))

    # Unscheduled sets -----------------------------------------------------------------------------

    def _list_requested_sets(self) -> list[DueSet]:
        """List the requested unscheduled sets that this recorder has not started, by key."""
        found = {due.set_key: due for due in self._carried_over.list_unscheduled_sets()}
        found |= {key: one.due for key, one in self._set_assessor.confirmations.waiting.items()}
        return [found[key] for key in sorted(found.keys() - self._started_unscheduled)]

    def _is_still_idle(self) -> bool:
        """Run the work between sets; return False at a stop or a request for an unscheduled set."""
        return self._waiting.run_between_sets() and not self._list_requested_sets()

    def _yield_unscheduled_sets(self, scheduled: DueSet | None) -> Iterator[DueSet]:
        """Yield the unscheduled sets that precede a scheduled one (None: all that are requested), by key.

        Each is yielded once; one whose file exists only gets its rows. After a stop none is yielded.
        """
        for due in self._list_requested_sets():
            if not self._stop.is_set() and (scheduled is None or due.set_index < scheduled.set_index):
                self._started_unscheduled.add(due.set_key)
                if not self._store_rows_of_file(due):
                    yield due

    def find_skip_reason(self, due: DueSet) -> str:
        """Return why a due set is not acquired (paused, full memory, no time); empty if it is acquired."""
        if due.position is not None and (reason := self._find_unscheduled_skip_reason(due, due.position)):
            return reason
        if self._commands.paused or self._persistence.trouble is None or self._persistence.has_room:
            return self._commands.paused
        return f"the memory for what waits is full: {self._persistence.trouble.message}"

    def _find_unscheduled_skip_reason(self, due: DueSet, position: str) -> str:
        """Return why an unscheduled set is not acquired; empty if it is.

        Its transducer is disabled, it is more than an hour late, or the next scheduled set is too near.
        """
        if reason := self._set_assessor.disabled().get(position):
            return reason
        now_ns = self._clock.utc_ns()
        if now_ns > due.due_utc_ns + NS_PER_H:
            return self._waiting.storage.find_overdue_reason(due.due_utc_ns)
        confirmations = self._set_assessor.confirmations
        return explain_overlap(
            confirmations.compute_time_to_next_set_ns(self._plan[due.set_index], now_ns), confirmations.set_ns
        )
