"""How old what a folder says is, on the test's clock and on the wall's: for the command line and the web."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from daq_service.alarms.states import without_expired_shelf
from daq_service.catalogue import Catalogue
from daq_service.catalogue.reader import LastWord
from daq_service.catalogue.rows import AlarmRow, EventRow
from daq_service.processes.heartbeat import time_now_ns
from daq_service.processes.recorder_state import PROCESS_EVENTS, look_at_recorder
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S

LOOK_BACK_EVENTS = 20
"""Events are not written in the order of the test's time: the newest of so many tells it."""


class Freshness:
    """Recorder, time and age of a test at a moment, taken once for all that is told of it.

    Parameters
    ----------
    clock
        ``simulated`` or ``wall``.

    Attributes
    ----------
    recorder
        Its state.
    now_utc_ns, now_h
        Time of the test, and hours since its epoch; of a simulated one, or where no recorder of this boot
        tells it, the newest known.
    system_ahead_s
        How far the computer's clock is ahead of the test's time; None where nobody tells that.
    written_ns, wall_age_s
        When the newest event was written, and how long ago; None before the first.
    """

    def __init__(self, folder: Path, catalogue: Catalogue, clock: str) -> None:
        self.epoch_utc_ns = catalogue.experiment_row().epoch_utc_ns
        self.clock = clock
        self.last_event_id = catalogue.last_event_id()
        newest = catalogue.events_after(max(0, self.last_event_id - LOOK_BACK_EVENTS), None, LOOK_BACK_EVENTS)
        last, told = newest[-1] if newest else None, catalogue.last_service_event(*PROCESS_EVENTS)
        wall_ns = time.time_ns()
        self.recorder = look_at_recorder(folder, [told.kind] if told else [])
        told_ns = time_now_ns(self.recorder.beat) if clock == "wall" else None
        # A simulated clock stands still while nobody works: the newest events tell its time. So does a real
        # one while it is doubted, and then the system's may lie before.
        self.now_utc_ns = max((row.utc_ns for row in newest), default=self.epoch_utc_ns)
        if clock == "wall":
            self.now_utc_ns = max(wall_ns, self.now_utc_ns) if told_ns is None else told_ns
        self.now_h = (self.now_utc_ns - self.epoch_utc_ns) / NS_PER_H
        self.system_ahead_s = None if told_ns is None else (wall_ns - told_ns) / NS_PER_S
        self.written_ns = None if last is None else last.wall_utc_ns
        self.wall_age_s = None if last is None else _age_s(wall_ns, last, told_ns)

    def standing(self, row: AlarmRow) -> AlarmRow:
        """Alarm as it stands now: an expired shelf is none, also where nobody records."""
        return without_expired_shelf(row, utc_ns=self.now_utc_ns, wall_utc_ns=time.time_ns())

    def standing_word(self, last: LastWord) -> LastWord:
        """Last word on a position with its alarms as they stand now."""
        return replace(last, active_alarms=[self.standing(row) for row in last.active_alarms])

    def age_h(self, due_h: float) -> float:
        """Age on the experiment's clock of what belongs to an hour; not negative."""
        return max(0.0, self.now_h - due_h)


def _age_s(wall_ns: int, last: EventRow, told_ns: int | None) -> float:
    """Seconds since an event was written; on the experiment's clock where the system's was set."""
    ages_ns = [wall_ns - last.wall_utc_ns, *([] if told_ns is None else [told_ns - last.utc_ns])]
    return min((age_ns for age_ns in ages_ns if age_ns >= 0), default=0) / NS_PER_S
