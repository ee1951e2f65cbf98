"""Hub that follows the events of the catalogue in a thread and encodes each once for all streams.

A client is only a cursor: the id of its last event. It has no queue, so a slow one costs nothing; when the
ring has moved past its cursor it gets a `gap` and skips. The ring is filled from the catalogue at the start,
so that many simultaneous clients read the catalogue once.
"""

from __future__ import annotations

import asyncio
import bisect
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import orjson

from daq_service.web.streams.followed import Followed

log = logging.getLogger(__name__)
POLL_INTERVAL_S = 0.03
RING_EVENTS = 5000
"""Events kept for clients that reconnect; at most twice as many."""
HEARTBEAT_INTERVAL_S = 15.0
PAGE_EVENTS = 500
TURNS = 16
"""Late clients that get a chunk before other requests get a turn."""
TURN_S = 0.001
"""Pause of the event loop after each turn, so that threads of other responses get the interpreter lock."""
UNREADABLE_INTERVAL_S = 0.5
"""Pause after the catalogue could not be read: absent before the first record, or in trouble."""


@dataclass(frozen=True, slots=True)
class EncodedEvent:
    """Event as encoded bytes of the stream."""

    id: int
    topic: str
    frame: bytes


class EventSource(Protocol):
    """Source of events."""

    def last_id(self) -> int | None:
        """Return the id of the newest event; None while there is no catalogue."""
        ...

    def after(self, event_id: int, limit: int) -> Sequence[Mapping[str, Any]]:
        """Read at most ``limit`` events after an id, ascending, as rows of the API."""
        ...


def encode_event(row: Mapping[str, Any]) -> EncodedEvent:
    """Encode a row as a frame of server-sent events (WHATWG HTML) with id, topic and JSON data.

    Raises KeyError if the row has no id or topic.
    """
    data = orjson.dumps(row)
    frame = b"id: %d\nevent: %s\ndata: %s\n\n" % (row["id"], row["topic"].encode(), data)
    return EncodedEvent(row["id"], row["topic"], frame)


class EventHub(Followed):
    """Ring of the newest events, with a wake-up for the next event or heartbeat.

    ``complete_after`` is the id after which the ring has every event; None until it is filled.
    """

    def __init__(
        self,
        source: EventSource,
        *,
        poll_interval_s: float = POLL_INTERVAL_S,
        ring_events: int = RING_EVENTS,
        heartbeat_interval_s: float = HEARTBEAT_INTERVAL_S,
    ) -> None:
        super().__init__("event-tail")
        self._source = source
        self._poll_interval_s = poll_interval_s
        self._ring_events = ring_events
        self.heartbeat_interval_s = heartbeat_interval_s
        self._turns = asyncio.Semaphore(TURNS)
        self._events: list[EncodedEvent] = []
        self.complete_after: int | None = None
        self._heartbeat: asyncio.TimerHandle | None = None

    async def start(self) -> None:
        """Start the thread that follows events, and wake clients for heartbeats, the first time at once."""
        await super().start()
        self._send_heartbeat()

    def close(self) -> None:
        """End every stream with ``bye`` and the heartbeats, without waiting; may be called again."""
        super().close()
        if self._heartbeat is not None:
            self._heartbeat.cancel()

    @property
    def last_id(self) -> int:
        """Return the id of the newest event in the ring; of an empty ring, ``complete_after`` or 0."""
        return self._events[-1].id if self._events else (self.complete_after or 0)

    def after(self, event_id: int, limit: int | None = None) -> list[EncodedEvent]:
        """Return the oldest ``limit`` events of the ring after an id, ascending; all if ``limit`` is None."""
        first = bisect.bisect_right(self._events, event_id, key=lambda event: event.id)
        return self._events[first : None if limit is None else first + limit]

    async def yield_turn(self) -> None:
        """Pause a late client for a moment (1 ms; 16 clients at a time), so that other requests proceed."""
        async with self._turns:
            await asyncio.sleep(TURN_S)

    def _send_heartbeat(self) -> None:
        """Wake all clients for a heartbeat and schedule the next one."""
        self._wake_clients()
        self._heartbeat = self._loop.call_later(self.heartbeat_interval_s, self._send_heartbeat)

    def _fill_ring(self, event_id: int, events: list[EncodedEvent]) -> None:
        """Replace the events of the ring, which has all after ``event_id``, and wake the clients."""
        self.complete_after, self._events = event_id, events
        self._wake_clients()

    def _append_events(self, events: list[EncodedEvent]) -> None:
        """Append events to the ring, drop the oldest ones at twice its size, and wake the clients."""
        self._events.extend(events)
        # Cut only at twice the size, so that the cost an event stays constant.
        if len(self._events) > 2 * self._ring_events:
            self.complete_after = self._events[-self._ring_events - 1].id
            del self._events[: -self._ring_events]
        self._wake_clients()

    def _read_stored_events(self, event_id: int, last: int) -> list[EncodedEvent]:
        """Read and encode all events after ``event_id``, at least up to the id ``last``, page by page.

        Raises the errors of the source.
        """
        events: list[EncodedEvent] = []
        while event_id < last and (rows := self._source.after(event_id, PAGE_EVENTS)):
            events += map(encode_event, rows)
            event_id = rows[-1]["id"]
        return events

    def _follow(self) -> None:
        """Poll and encode events, and pass them to the event loop, until `close` (body of the thread).

        Every error is logged once in a row and tried again after 0.5 s.
        """
        last: int | None = None
        began = False
        last_error = ""
        while not self._stop.is_set():
            pause_s = self._poll_interval_s
            try:
                if last is None:
                    last = self._source.last_id()
                    if last is None:
                        # No catalogue yet: whoever waits now sees the experiment from its first event.
                        self._call_on_event_loop(self._fill_ring, 0, []) if not began else None
                        began, pause_s = True, UNREADABLE_INTERVAL_S
                    elif began:
                        last = 0
                    else:
                        first = max(0, last - self._ring_events)
                        stored = self._read_stored_events(first, last)
                        self._call_on_event_loop(self._fill_ring, first, stored)
                        last = stored[-1].id if stored else last
                else:
                    rows = self._source.after(last, PAGE_EVENTS)
                    if rows:
                        last = rows[-1]["id"]
                        self._call_on_event_loop(self._append_events, [encode_event(row) for row in rows])
                        pause_s = 0.0 if len(rows) == PAGE_EVENTS else pause_s
                last_error = ""
            except Exception as error:  # noqa: BLE001 - without this thread no page has news
                if repr(error) != last_error:
                    log.warning("cannot read events: %s", error)
                last_error, pause_s = repr(error), UNREADABLE_INTERVAL_S
            self._stop.wait(pause_s)
