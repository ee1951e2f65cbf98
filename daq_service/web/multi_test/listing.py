"""List of the tests with their present state, read only when it may have changed."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from daq_service.acquisition.schedule import list_due_hours
from daq_service.alarms.states import PRIORITIES
from daq_service.assessment.position_status import PositionStatus, read_latest_rows
from daq_service.catalogue.experiment_file import EXPERIMENT_FILE
from daq_service.catalogue.reader import Catalogue
from daq_service.catalogue.rows import AlarmRow
from daq_service.catalogue.store import open_catalogue
from daq_service.processes.data_folder import LOCK_FILE
from daq_service.processes.freshness import Freshness
from daq_service.settings.tree import Settings
from daq_service.web.answers.json_answer import format_rfc3339
from daq_service.web.multi_test.answers import ListedTest, Standing
from daq_service.web.multi_test.location import AbsentError, find_folder, locate_test, translate_to_absent
from daq_service.web.multi_test.open_tests import ServedTest, ServedTests
from daq_service.web.routes.info import RIG_LABELS
from daq_service.web.routes.transducers import assess_position

CHANGING_S = 2.0
ENDED_S = 60.0
"""Maximum age of an entry of a recorded test, and of one with unchanged files."""
MARKS = ("catalogue.sqlite", "catalogue.sqlite-wal", "heartbeat.json", LOCK_FILE, EXPERIMENT_FILE)


@dataclass(frozen=True, slots=True)
class _CachedEntry:
    entry: ListedTest
    folder: Path
    mark: tuple[int, ...]
    read_s: float

    def is_current(self, now_s: float) -> bool:
        """Return whether the entry need not be read again at ``now_s`` (monotonic).

        That is within 2 s, or within 60 s if its recorder does not run and its files are unchanged.
        """
        if now_s - self.read_s < CHANGING_S:
            return True
        standing = self.entry.standing
        ended = standing is not None and standing.recorder != "running"
        return ended and now_s - self.read_s < ENDED_S and _compute_folder_mark(self.folder) == self.mark


class Listing:
    """List of the tests, shared by all requests."""

    def __init__(self, tests: ServedTests) -> None:
        self._tests = tests
        self._lock = threading.Lock()
        self._cached: dict[str, _CachedEntry] = {}

    def read_entries(self) -> list[dict[str, object]]:
        """Return the entries of all tests, with their age in s; read those again that may have changed.

        In the order of the command line. Blocks while files are read, also for another thread that calls it.
        """
        with self._lock:
            for test in self._tests.all.values():
                cached, now_s = self._cached.get(test.name), time.monotonic()
                if cached is None or not cached.is_current(now_s):
                    folder = find_folder(test.path)
                    # Before the read: a change meanwhile is noticed the next time.
                    mark = _compute_folder_mark(folder)
                    self._cached[test.name] = _CachedEntry(self._read_entry(test), folder, mark, now_s)
            now_s = time.monotonic()
            return [
                cached.entry.model_dump() | {"looked_age_s": now_s - cached.read_s}
                for cached in self._cached.values()
            ]

    def shown(self) -> int:
        """Count the tests that could be shown at their last read; 0 before the first."""
        return sum(cached.entry.state == "shown" for cached in list(self._cached.values()))

    def _read_entry(self, test: ServedTest) -> ListedTest:
        """Read the entry of a test, without writing: its present state, or why it cannot be shown.

        Updates ``test.title`` if the settings could be read. Other errors than `AbsentError` pass through.
        """
        page = f"/tests/{test.name}/"
        standing, absence = None, None
        try:
            settings, folder = locate_test(test.path, self._tests.access_policy)
            test.title = settings.name
            with translate_to_absent(), open_catalogue(folder) as catalogue:
                standing = _read_present_state(settings, folder, catalogue)
        except AbsentError as error:
            absence = error
        return ListedTest(
            test=test.name,
            name=test.title,
            source=str(test.path),
            page=page,
            api=f"{page}api/v1",
            state="shown" if absence is None else absence.state,
            detail=None if absence is None else f"{absence}",
            remedy=None if absence is None else absence.remedy,
            standing=standing,
            looked_age_s=0.0,
        )


def _compute_folder_mark(folder: Path) -> tuple[int, ...]:
    """Return modification times (ns) and sizes of the files `MARKS` of a test; they differ if it changed.

    A file that cannot be read has 0 and 0.
    """
    marks: list[int] = []
    for name in MARKS:
        try:
            status = (folder / name).stat()
        except OSError:
            marks += (0, 0)
        else:
            marks += (status.st_mtime_ns, status.st_size)
    return tuple(marks)


def _read_present_state(settings: Settings, folder: Path, catalogue: Catalogue) -> Standing:
    """Read the present state of a test, which is that of its worst position, from catalogue and recorder.

    Last set and age are None without a measured set. Raises StorageError if the catalogue cannot be read.
    """
    fresh = Freshness(folder, catalogue, settings.clock.kind)
    latest = read_latest_rows(catalogue, fresh, settings.positions)
    hours = list_due_hours(settings.schedule.phases, end_h=settings.schedule.end_h)
    positions = [
        assess_position(settings.positions[name], settings.schedule, fresh, last)
        for name, last in latest.items()
    ]
    active = catalogue.rows(AlarmRow, active=True)
    measured = [row for last in latest.values() if (row := last.last_feature or last.last_thickness)]
    newest = max(measured, key=lambda row: row.set_index, default=None)
    return Standing(
        rig=settings.rig.kind,
        rig_label=RIG_LABELS.get(settings.rig.kind, settings.rig.kind),
        clock=settings.clock.kind,
        epoch_utc=str(format_rfc3339(fresh.epoch_utc_ns)),
        now_h=fresh.now_h,
        end_h=hours[-1] if hours else 0.0,
        recorder=fresh.recorder.status,
        wall_age_s=fresh.wall_age_s,
        paused=catalogue.paused(),
        state=max((place.state for place in positions), key=get_args(PositionStatus).index),
        stale=any(place.stale for place in positions),
        active_alarms=len(active),
        highest_priority=max((row.priority for row in active), key=PRIORITIES.index, default=None),
        last_set_index=None if newest is None else newest.set_index,
        last_set_h=None if newest is None else newest.due_h,
        age_h=None if newest is None else fresh.age_h(newest.due_h),
        positions=positions,
    )
