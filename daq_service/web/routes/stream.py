"""`/api/v1/stream?topics=`: one multiplexed stream of server-sent events.

An event's id is the catalogue's event id, so `Last-Event-ID` resumes across restarts of the
recorder and of this service. Besides the topics there are `gap` (events between two ids were
skipped: read the state again over REST), `heartbeat` (every `interval_s`; a connection that misses two is
dead) and `bye` (the service ends: connect again).
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from functools import partial
from typing import Annotated

import orjson
from fastapi import APIRouter, Header, Query
from starlette.responses import StreamingResponse

from daq_service.web.answers.models import describe_errors
from daq_service.web.answers.problem import Problem, invalid
from daq_service.web.answers.vocabulary import VOCABULARY
from daq_service.web.context import Context, ContextOf
from daq_service.web.routes.admission import PersonOf
from daq_service.web.streams.hub import EventHub

router = APIRouter(tags=["stream"])
TOPICS = VOCABULARY.topics
LARGEST_CHUNK_EVENTS = 32
"""About 20 kB: limits the memory for a client that does not read."""
MOST_CLIENTS = 2000
RETRY_MS = 1000


@router.get(
    "/stream",
    summary="Events as they are committed (server-sent events)",
    response_class=StreamingResponse,
    responses={
        200: {"content": {"text/event-stream": {"schema": {"type": "string"}}}},
        **describe_errors(503),
    },
)
async def stream_events(
    context: ContextOf,
    person: PersonOf,
    topics: Annotated[
        str | None, Query(description="Comma-separated topics; absent: all", max_length=200)
    ] = None,
    after: Annotated[
        int | None, Query(ge=0, le=2**63 - 1, description="Begin behind this event id; Last-Event-ID wins")
    ] = None,
    last_event_id: Annotated[str | None, Header(description="Set by EventSource when it reconnects")] = None,
) -> StreamingResponse:
    """Stream events after `Last-Event-ID` (or `after`), or from the next event.

    At most 2000 streams are open; more are answered with 503, an unknown topic or invalid id with 422.
    """
    selected = _parse_topics(topics)
    if context.open_streams() >= MOST_CLIENTS:
        raise Problem("too-many-streams", f"{MOST_CLIENTS} streams are open, which is the maximum.")
    start_after = after if last_event_id in (None, "") else _parse_event_id(last_event_id or "")
    if start_after is None and context.hub.complete_after is not None:
        # Now, before the client is connected: all later events are new to it.
        start_after = context.hub.last_id
    return StreamingResponse(
        generate_frames(
            context, context.hub, selected, start_after, partial(context.access_policy.has_access, person)
        ),
        media_type="text/event-stream",
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
    )


def _parse_topics(text: str | None) -> frozenset[str] | None:
    """Parse the comma-separated topics; an absent parameter (None) selects all.

    Raises a Problem (422) for an unknown or no topic.
    """
    if text is None:
        return None
    selected = frozenset(part.strip() for part in text.split(",") if part.strip())
    unknown = sorted(selected - set(TOPICS))
    if unknown or not selected:
        raise invalid(
            "Unknown topic",
            f"topics is {text!r}; unknown: {', '.join(unknown) or '(none given)'}.",
            f"Choose from {', '.join(TOPICS)}.",
        )
    return selected


def _parse_event_id(text: str) -> int:
    """Parse an event id from a header; raise a Problem (422) unless it has 1 to 18 digits."""
    if not text.isascii() or not text.isdigit() or len(text) > 18:
        raise invalid(
            "Not an event id",
            f"Last-Event-ID is {text[:40]!r}; event ids are non-negative integers.",
            "Leave the header out to begin with the next event.",
        )
    return int(text)


def encode_gap_frame(after: int, until: int, reason: str) -> bytes:
    """Encode a frame that reports skipped events: those after ``after`` up to ``until``.

    It moves the cursor of the client to ``until``.
    """
    data = orjson.dumps({"after": after, "until": until, "reason": reason})
    return b"id: %d\nevent: gap\ndata: %s\n\n" % (until, data)


async def generate_frames(
    context: Context,
    hub: EventHub,
    topics: frozenset[str] | None,
    start_after: int | None,
    may_stay: Callable[[], bool] = lambda: True,
) -> AsyncIterator[bytes]:
    """Yield frames to one client until the hub closes, the client leaves or its token is invalid.

    Starts after the event ``start_after`` (None: with the next event). A client that is too slow, or whose id
    is unknown, gets a gap; a heartbeat is sent at each interval. The last frame is ``bye``. Meanwhile the
    client is counted in ``hub.clients``.
    """
    hub.clients += 1
    try:
        yield b"retry: %d\n\n" % RETRY_MS
        heartbeat = b'event: heartbeat\ndata: {"interval_s":%g}\n\n' % hub.heartbeat_interval_s
        while hub.complete_after is None and not hub.closed:
            await hub.changed()
            if hub.complete_after is None:
                yield heartbeat
        cursor = hub.last_id if start_after is None else start_after
        if cursor > hub.last_id and cursor > (await asyncio.to_thread(context.events.last_id) or 0):
            # The id is not merely newer than the hub: it belongs to another data folder.
            yield encode_gap_frame(cursor, hub.last_id, "this event id is not known here")
            cursor = hub.last_id
        reason = "it is too long ago"
        loop = asyncio.get_running_loop()
        beat_at = loop.time()
        while not hub.closed and may_stay():
            chunk = b""
            start = hub.complete_after or 0
            if cursor < start:
                chunk = encode_gap_frame(cursor, start, reason)
                cursor = start
            events = hub.after(cursor, LARGEST_CHUNK_EVENTS)
            if events:
                cursor = events[-1].id
                chunk += b"".join(event.frame for event in events if topics is None or event.topic in topics)
            if loop.time() - beat_at >= 0.9 * hub.heartbeat_interval_s:
                # A real event, as a page sees no comments: detects clients that left, keeps proxies open.
                beat_at = loop.time()
                chunk += heartbeat
            if chunk:
                yield chunk
            if cursor < hub.last_id:
                await hub.yield_turn()
            else:
                await hub.changed()
            reason = "the client was too slow"
        yield b"event: bye\ndata: {}\n\n"
    finally:
        hub.clients -= 1
