"""What notifications want to know of the test: its alarms' news, qualities, signs of life."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from daq_service.catalogue.reader import Catalogue
from daq_service.catalogue.rows import MEASURED_BY, AlarmRow, EventRow, FeatureRow
from daq_service.catalogue.store import NoDataYetError
from daq_service.processes.freshness import Freshness
from daq_service.processes.notifications.messages import News, Test, test_of
from daq_service.settings.tree import Settings


class Source:
    """Asks the catalogue; every method may raise `StorageError`.

    Parameters
    ----------
    catalogue
        Opens it, or returns the open one; `NoDataYetError` before the first record.
    """

    def __init__(self, settings: Settings, folder: Path, catalogue: Callable[[], Catalogue]) -> None:
        self._settings, self._folder, self._catalogue = settings, folder, catalogue

    def has_started(self) -> bool:
        """Tell whether there is a catalogue."""
        try:
            self._catalogue()
        except NoDataYetError:
            return False
        return True

    def test(self) -> Test:
        """Which test this is; before its first record by its name alone."""
        page = page_address(self._settings)
        try:
            return test_of(self._catalogue().experiment_row(), page)
        except NoDataYetError:
            return Test(name=self._settings.name, mark="not-begun", page=page)

    def last_event_id(self) -> int:
        """Id of the newest event."""
        return self._catalogue().last_event_id()

    def standing(self) -> int:
        """How many alarms are not over."""
        return len(self._catalogue().rows(AlarmRow, active=True))

    def written_ns(self, event_id: int) -> int | None:
        """When an event was written; 0 for the place before the first, None where there is no such event."""
        if event_id == 0:
            return 0
        found = self._catalogue().events_after(event_id - 1, limit=1)
        return found[0].wall_utc_ns if found and found[0].id == event_id else None

    def alarm_events(self, after: int, limit: int) -> Sequence[EventRow]:
        """Events of alarms behind an id; none before the first record."""
        try:
            return self._catalogue().rows(EventRow, after_id=after, topic="alarms", limit=limit)
        except NoDataYetError:
            return []

    def events(self, event_ids: Sequence[int]) -> list[EventRow]:
        """Return those of these events that there are."""
        found = [self._catalogue().events_after(event_id - 1, limit=1) for event_id in event_ids]
        return [
            rows[0]
            for rows, event_id in zip(found, event_ids, strict=True)
            if rows and rows[0].id == event_id
        ]

    def qualities(self, news: Sequence[News]) -> dict[int, str]:
        """Quality of the set at which each alarm came, by event, where it was measured."""
        found: dict[int, str] = {}
        for item in news:
            place = self._settings.positions.get(item.position or "")
            if place is None or item.set_index is None:
                continue
            kind = MEASURED_BY[place.method]
            filters: Any = {"scope": "set"} if kind is FeatureRow else {}
            rows = self._catalogue().rows(
                kind, position=item.position, set_index=item.set_index, limit=1, **filters
            )
            if rows:
                found[item.event_id] = rows[0].quality
        return found

    def signs_of_life(self) -> dict[str, Any]:
        """How the recorder is, how old the last set (h of the test), the last write (s)."""
        try:
            catalogue = self._catalogue()
        except NoDataYetError:
            return {
                "recorder": "absent",
                "doing": "no test has begun",
                "last_set_age_h": None,
                "last_write_age_s": None,
            }
        fresh = Freshness(self._folder, catalogue, self._settings.clock.kind)
        last = [
            word.last_set.due_h for word in catalogue.positions_state().values() if word.last_set is not None
        ]
        return {
            "recorder": fresh.recorder.word,
            "doing": fresh.recorder.description,
            "last_set_age_h": fresh.age_h(max(last)) if last else None,
            "last_write_age_s": fresh.wall_age_s,
        }


def page_address(settings: Settings) -> str:
    """Address of the page for those who read a message elsewhere; empty where it has no name for others."""
    web = settings.web
    if not web.host_names:
        return ""
    port = "" if web.proxy or web.port in (0, 443) else f":{web.port}"
    return f"https://{web.host_names[0]}{port}/"
