"""Age of the stored data on the test clock and on the wall clock, for the command line and the web."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from daq_service.alarms.operator_actions import remove_expired_shelf
from daq_service.catalogue import Catalogue
from daq_service.catalogue.reader import LatestRows
from daq_service.catalogue.rows import AlarmRow, EventRow
from daq_service.processes.heartbeat import compute_test_time_ns
from daq_service.processes.recorder_state import PROCESS_EVENTS, read_recorder_state
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S

LOOK_BACK_EVENTS = 20
"""Events are not in the order of test time: the latest of this many gives the time of the test."""


class Freshness:
    """Recorder status, time and age of a test at a moment, read once for one answer.

    Parameters
    ----------
    clock
        ``simulated`` or ``wall``.

    Attributes
    ----------
    recorder
        State of the recorder.
    now_utc_ns, now_h
        Time of the test, and hours since its epoch. On a simulated clock, or where no recorder of this boot
        reports it: the newest known time.
    system_ahead_s
        How far the computer's clock is ahead of the test's time; None where that is unknown.
    written_ns, wall_age_s
        Time at which the newest event was written, and its age; None before the first.
    """

    def __init__(self, folder: Path, catalogue: Catalogue, clock: str) -> None:
        self.epoch_utc_ns = catalogue.read_experiment().epoch_utc_ns
        self.clock = clock
        self.last_event_id = catalogue.last_event_id()
        after_id = max(0, self.last_event_id - LOOK_BACK_EVENTS)
        times = ("utc_ns", "wall_utc_ns")
        newest = catalogue.columns(EventRow, times, after_id=after_id, limit=LOOK_BACK_EVENTS)
        utc_ns, wall_utc_ns = (newest[name] for name in times)
        recorder_event = catalogue.read_last_service_event(*PROCESS_EVENTS)
        wall_ns = time.time_ns()
        self.recorder = read_recorder_state(folder, [recorder_event.kind] if recorder_event else [])
        test_time_ns = compute_test_time_ns(self.recorder.beat) if clock == "wall" else None
        # A simulated clock stops while no recorder runs: the newest events give its time. The same holds for
        # an unverified real clock, and then the system's time may be earlier.
        self.now_utc_ns = max(utc_ns, default=self.epoch_utc_ns)
        if clock == "wall":
            self.now_utc_ns = max(wall_ns, self.now_utc_ns) if test_time_ns is None else test_time_ns
        self.now_h = (self.now_utc_ns - self.epoch_utc_ns) / NS_PER_H
        self.system_ahead_s = None if test_time_ns is None else (wall_ns - test_time_ns) / NS_PER_S
        self.written_ns = wall_utc_ns[-1] if wall_utc_ns else None
        self.wall_age_s = None
        if wall_utc_ns:
            ages_ns = [wall_ns - wall_utc_ns[-1]]
            if test_time_ns is not None:  # the system's clock was set
                ages_ns.append(test_time_ns - utc_ns[-1])
            self.wall_age_s = min((age_ns for age_ns in ages_ns if age_ns >= 0), default=0) / NS_PER_S

    def expire_shelf(self, row: AlarmRow) -> AlarmRow:
        """Return an alarm's row without its shelving if that has expired on the test's or the wall clock.

        Else the same object is returned. The catalogue is not changed; this works while no recorder runs.
        """
        return remove_expired_shelf(row, utc_ns=self.now_utc_ns, wall_utc_ns=time.time_ns())

    def expire_shelves(self, last: LatestRows) -> LatestRows:
        """Return the newest rows of a position with expired shelves removed from its active alarms."""
        return replace(last, active_alarms=[self.expire_shelf(row) for row in last.active_alarms])

    def age_h(self, due_h: float) -> float:
        """Return how long ago an hour of the test was, in h on the test's clock; 0 for future hours."""
        return max(0.0, self.now_h - due_h)
