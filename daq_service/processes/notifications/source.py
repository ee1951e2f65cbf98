"""Data of the test for notifications: changes of alarms, qualities, and facts of heartbeats."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from daq_service.catalogue.reader import Catalogue, Filters
from daq_service.catalogue.rows import MEASURED_BY, AlarmRow, EventRow, FeatureRow
from daq_service.catalogue.store import NoDataYetError
from daq_service.processes.freshness import Freshness
from daq_service.processes.notifications.messages import AlarmChange, HeartbeatFacts, Test, identify_test
from daq_service.settings.tree import Settings
from daq_service.settings.web import WebSettings


class Source:
    """Reader of the catalogue; every method may raise `StorageError`.

    Parameters
    ----------
    catalogue
        Opens the catalogue, or returns the open one; `NoDataYetError` before the first record.
    """

    def __init__(self, settings: Settings, folder: Path, catalogue: Callable[[], Catalogue]) -> None:
        self._settings, self._folder, self._catalogue = settings, folder, catalogue

    def has_started(self) -> bool:
        """Return whether the test has a catalogue with a first record; other errors of opening are raised."""
        try:
            self._catalogue()
        except NoDataYetError:
            return False
        return True

    def test(self) -> Test:
        """Return name, mark and page of the test; before its first record with the configured name.

        Raises StorageError if the catalogue cannot be read now.
        """
        page = read_page_address(self._settings.web)
        try:
            return identify_test(self._catalogue().read_experiment(), page, self._settings.alarms.contacts)
        except NoDataYetError:
            return Test(name=self._settings.name, mark="not-begun", page=page)

    def last_event_id(self) -> int:
        """Return the id of the newest event; raise `NoDataYetError` before the first record."""
        return self._catalogue().last_event_id()

    def count_active_alarms(self) -> int:
        """Return the number of active alarms; raise `NoDataYetError` before the first record."""
        return len(self._catalogue().rows(AlarmRow, active=True))

    def written_ns(self, event_id: int) -> int | None:
        """Return when an event was written, ns of UTC; 0 for id 0, None if there is no such event.

        Raises `NoDataYetError` before the first record, except for id 0.
        """
        if event_id == 0:
            return 0
        return next((row.wall_utc_ns for row in self.events([event_id])), None)

    def alarm_events(self, after: int, limit: int) -> Sequence[EventRow]:
        """Read at most ``limit`` events of alarms after an id, ascending; none before the first record.

        Raises StorageError if the catalogue cannot be read now.
        """
        try:
            return self._catalogue().rows(EventRow, after_id=after, topic="alarms", limit=limit)
        except NoDataYetError:
            return []

    def events(self, event_ids: Sequence[int]) -> list[EventRow]:
        """Read the events with these ids, in the given order, without missing ones.

        Raises `NoDataYetError` before the first record.
        """
        read = partial(self._catalogue().read_events_after, limit=1)
        return [row for event_id in event_ids for row in read(event_id - 1) if row.id == event_id]

    def read_qualities(self, changes: Sequence[AlarmChange]) -> dict[int, str]:
        """Read the quality of the set with which each alarm was raised, by event id.

        Alarms without a position or set, and unmeasured sets, are left out. Raises StorageError if the
        catalogue cannot be read now.
        """
        qualities: dict[int, str] = {}
        for item in changes:
            settings = self._settings.positions.get(item.position or "")
            if settings is None or item.set_key is None:
                continue
            kind = MEASURED_BY[settings.method]
            filters: Filters = {
                "position": item.position,
                "set_index": item.set_index,
                "unscheduled_index": item.unscheduled_index,
            }
            if kind is FeatureRow:
                filters["scope"] = "set"
            rows = self._catalogue().rows(kind, limit=1, **filters)
            if rows:
                qualities[item.event_id] = rows[0].quality
        return qualities

    def read_heartbeat_facts(self) -> HeartbeatFacts:
        """Read status and activity of the recorder and the ages of last set (h of the test) and write (s).

        Ages are None without a set or event; before the first record the status is ``not_started``. Raises
        StorageError if the catalogue cannot be read now.
        """
        try:
            catalogue = self._catalogue()
        except NoDataYetError:
            return {
                "recorder": "not_started",
                "doing": "no test has started",
                "last_set_age_h": None,
                "last_write_age_s": None,
            }
        fresh = Freshness(self._folder, catalogue, self._settings.clock.kind)
        measured_h = [
            summary.last_set.due_h
            for summary in catalogue.read_latest_rows().values()
            if summary.last_set is not None
        ]
        return {
            "recorder": fresh.recorder.status,
            "doing": fresh.recorder.description,
            "last_set_age_h": fresh.age_h(max(measured_h)) if measured_h else None,
            "last_write_age_s": fresh.wall_age_s,
        }


def read_page_address(web: WebSettings) -> str:
    """Build the URL of the page for other computers from the first host name; empty if none is configured.

    The port is left out behind a proxy, and if it is 443 or chosen by the system.
    """
    if not web.host_names:
        return ""
    port = "" if web.proxy or web.port in (0, 443) else f":{web.port}"
    return f"https://{web.host_names[0]}{port}/"
