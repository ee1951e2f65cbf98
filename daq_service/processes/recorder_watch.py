"""Monitor for a missing recorder, run by a process that remains.

The web service, or the supervisor where there is none, raises ``recorder_not_running`` and changes no other
row of the catalogue. A recorder takes over the alarm.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from daq_service.acquisition.schedule import list_due_hours
from daq_service.alarms.process_trouble import RECORDER_NOT_RUNNING, build_reason_condition
from daq_service.alarms.states import Moment, update_alarm
from daq_service.catalogue import Catalogue, SetCommit
from daq_service.catalogue.rows import AlarmRow
from daq_service.catalogue.store import NoDataYetError, open_for_command
from daq_service.clock import MACHINE, MachineClock
from daq_service.processes.freshness import Freshness
from daq_service.settings.tree import ScheduleSettings
from hardware_drivers.nanoseconds import NS_PER_H

MOST_RESTARTS, RESTARTS_WITHIN_S = 3, 600.0
MOST_INTERVALS = 2
"""Intervals that may pass without a stored set: one set may fail, or take as long as its interval."""
STARTING_S = 60.0
"""After a start of the computer the recorder may come later than the process that watches it."""


class RecorderWatch:
    """Periodic check that raises or clears the alarm ``recorder_not_running``.

    Parameters
    ----------
    clock
        Kind of the test's clock.
    catalogue
        Opens the catalogue, or returns the open one; `NoDataYetError` before the first record.
    """

    def __init__(
        self,
        schedule: ScheduleSettings,
        clock: Literal["simulated", "wall"],
        folder: Path,
        catalogue: Callable[[], Catalogue],
        *,
        machine: MachineClock = MACHINE,
    ) -> None:
        self._schedule, self._clock, self._folder, self._catalogue = schedule, clock, folder, catalogue
        self._machine, self._first_s = machine, machine.mono_s()
        self._process, self._process_since_s, self._ended = 0, 0.0, True
        self._restarts: deque[float] = deque(maxlen=MOST_RESTARTS)
        self._attended_h = 0.0

    def check(self) -> None:
        """Raise the alarm if the recorder is missing; clear it once a scheduled set is stored.

        It is also cleared when the test has finished. Does nothing before the first record.

        Raises
        ------
        StorageError
            The catalogue cannot be read or written now.
        """
        try:
            catalogue = self._catalogue()
        except NoDataYetError:
            return
        fresh = Freshness(self._folder, catalogue, self._clock)
        recorded, rows = catalogue.read_newest_recorded(), catalogue.rows(AlarmRow, kind=RECORDER_NOT_RUNNING)
        stored_ns = (recorded and recorded.ended_utc_ns) or 0
        self._count_restarts(fresh)
        stored_h = (stored_ns - fresh.epoch_utc_ns) / NS_PER_H
        finding = self._find_missing_reason(fresh, stored_h, is_paused=catalogue.paused() is not None)
        is_active = bool(rows) and rows[-1].state in ("unacknowledged", "acknowledged")
        is_over = is_active and (fresh.recorder.status == "finished" or stored_ns > rows[-1].changed_utc_ns)
        if is_over or (finding and not is_active):
            self._update_alarm("" if is_over else finding, fresh)

    def _count_restarts(self, fresh: Freshness) -> None:
        """Record a restart if the process of the heartbeat changed without an announced end.

        A recorder that runs after an announced end counts as started by a person: the next set is then
        expected 2 intervals after this moment.
        """
        beat = fresh.recorder.beat
        if beat is None:
            return
        if beat.process != self._process:
            if not self._ended:
                self._restarts.append(self._machine.mono_s())
            elif fresh.recorder.status == "running":
                self._attended_h = fresh.now_h  # started by a person, or with its computer
            self._process, self._process_since_s = beat.process, self._machine.mono_s()
        self._ended = beat.stage == "ended" or fresh.recorder.beat_age_s is None

    def _find_missing_reason(self, fresh: Freshness, stored_h: float, *, is_paused: bool) -> str:
        """Return the evidence that the recorder is missing; empty without evidence.

        Evidence is 3 restarts within 600 s, or on a wall clock no stored set for 2 scheduled intervals.
        Pauses, the end of the test, the first 60 s and a process that has run for 2 intervals are no
        evidence. Updates the restarts and the hour from which intervals count.
        """
        now_s, status = self._machine.mono_s(), fresh.recorder.status
        if is_paused or status == "finished":
            self._attended_h = fresh.now_h
            self._restarts.clear()
        elif len(self._restarts) == MOST_RESTARTS and now_s - self._restarts[0] <= RESTARTS_WITHIN_S:
            self._restarts.clear()
            return f"{MOST_RESTARTS} restarts in {RESTARTS_WITHIN_S / 60.0:.0f} min"
        due_h = list_due_hours(self._schedule.phases, end_h=self._schedule.end_h)
        since_h = max(stored_h, self._attended_h, due_h[0])
        following = bisect_left(due_h, since_h)
        index = min(max(following, 1), len(due_h) - 1)
        allowed_h = MOST_INTERVALS * (due_h[index] - due_h[index - 1] if index else 1.0)
        if status == "running" and now_s - self._process_since_s > 3600.0 * allowed_h:
            self._attended_h = fresh.now_h  # it is alive: its own alarms state what it waits for
        is_due = following < len(due_h) and since_h + allowed_h < fresh.now_h <= due_h[-1] + 2.0 * allowed_h
        may_come = status != "running" and now_s - self._first_s < min(STARTING_S, 3600.0 * allowed_h)
        # Simulated time stands still without a recorder: no set is missed.
        if fresh.clock == "wall" and is_due and not may_come:
            return f"No scheduled set stored for {MOST_INTERVALS} intervals"
        return ""

    def _update_alarm(self, finding: str, fresh: Freshness) -> None:
        """Raise the alarm ``recorder_not_running`` in the catalogue; an empty finding clears it.

        Writes nothing if the alarm does not change. Raises StorageError if the catalogue cannot be written
        now.
        """
        moment = Moment(utc_ns=fresh.now_utc_ns, due_h=fresh.now_h, set_index=None)
        with open_for_command(self._folder) as catalogue:
            rows = catalogue.rows(AlarmRow, kind=RECORDER_NOT_RUNNING)
            condition = build_reason_condition(RECORDER_NOT_RUNNING, finding)
            if change := update_alarm(rows[-1] if rows else None, condition, moment):
                commit = SetCommit()
                commit.add_alarm(change.row, change.event(moment))
                catalogue.commit_set(commit)
