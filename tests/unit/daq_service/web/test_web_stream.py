"""The event stream: resume, gaps, slow clients, heartbeat, and many clients at once."""

import asyncio
from contextlib import contextmanager

import httpx2
import pytest
from support.filled_folder import FilledFolder, filled_folder
from support.served_web import DEADLINE_S, served, served_app, stream_events, take

from daq_service.errors import StorageError
from daq_service.settings.tree import Settings
from daq_service.web.app import create_app
from daq_service.web.context import Context
from daq_service.web.guards import RequestGuard
from daq_service.web.routes.stream import encode_gap_frame, generate_frames
from daq_service.web.streams.hub import EventHub, encode_event

HEARTBEAT = b'event: heartbeat\ndata: {"interval_s":0.02}\n\n'


@pytest.fixture
def filled(tmp_path):
    with filled_folder(tmp_path, sets=1) as folder:
        yield folder


@pytest.fixture
def service(filled):
    with served(filled.settings, filled.folder) as running:
        yield running


@contextmanager
def connected(service, query="", **headers):
    url = f"{service.url}api/v1/stream{query}"
    with httpx2.stream("GET", url, headers=headers, timeout=DEADLINE_S) as response:
        assert response.status_code == 200
        assert response.headers["content-type"].startswith("text/event-stream")
        yield stream_events(response)


def stored_ids(filled, topics=None):
    return [row.id for row in filled.catalogue.read_events_after(0, topics, None)]


def test_events_arrive_as_they_are_committed(filled, service):
    with connected(service, "?after=0") as events:
        history = stored_ids(filled)
        assert [event.id for event in take(events, len(history))] == history
        new = filled.add_set(1, stored=False)
        arrived = take(events, len(new))
    assert [event.id for event in arrived] == new
    rows = filled.catalogue.read_events_after(history[-1], None, None)
    assert [event.event for event in arrived] == [row.topic for row in rows]
    assert arrived[0].data["position"] == "A"
    assert arrived[0].data["kind"] == "set_done"
    assert arrived[0].data["utc"] == "2024-01-01T01:00:00Z"


def test_without_a_start_only_new_events_arrive(filled, service):
    before = stored_ids(filled)
    with connected(service) as events:
        new = filled.add_set(1, stored=False)
        # Rows committed during the connection may be included, but no older ones.
        assert next(events).id in new
    assert max(before) < min(new)


def test_last_event_id_resumes_without_loss_or_repetition(filled, service):
    with connected(service, "?after=0") as events:
        seen = [event.id for event in take(events, 3)]
    filled.add_set(1, stored=False)
    # Last-Event-ID wins over the address, as when EventSource reconnects.
    with connected(service, "?after=0", **{"Last-Event-ID": str(seen[-1])}) as events:
        rest = stored_ids(filled)[3:]
        assert [event.id for event in take(events, len(rest))] == rest


def test_resume_works_across_a_restart_of_the_service(filled):
    with served(filled.settings, filled.folder) as first, connected(first, "?after=0") as events:
        last = take(events, 2)[-1].id
    filled.add_set(1, stored=False)
    with served(filled.settings, filled.folder) as second, connected(second, f"?after={last}") as events:
        rest = stored_ids(filled)[2:]
        assert [event.id for event in take(events, len(rest))] == rest


def test_only_the_chosen_topics_arrive(filled, service):
    with connected(service, "?topics=assessments,thickness&after=0") as events:
        filled.add_set(1, stored=False)
        wanted = stored_ids(filled, ["assessments", "thickness"])
        arrived = take(events, len(wanted))
    assert [event.id for event in arrived] == wanted
    assert {event.event for event in arrived} == {"assessments", "thickness"}


def test_a_too_old_event_id_is_a_gap(filled):
    ids = stored_ids(filled)
    assert len(ids) > 6
    app = create_app(filled.settings, filled.folder)
    app.state.context.hub._ring_events = 5
    with served_app(app) as service, connected(service, "?after=1") as events:
        gap, *rest = take(events, 6)
    assert gap.event == "gap"
    assert gap.data["after"] == 1
    assert gap.id == gap.data["until"] == ids[-6]
    assert [event.id for event in rest] == ids[-5:]


def test_id_of_another_folder_is_a_gap(filled, service):
    with connected(service, "?after=99999") as events:
        gap = next(events)
        assert gap.event == "gap"
        assert gap.id == stored_ids(filled)[-1]
        new = filled.add_set(1, stored=False)
        assert next(events).id == new[0]


def test_stream_may_be_opened_before_the_first_record(tmp_path):
    with served(Settings(), tmp_path) as service, connected(service) as events:
        filled = FilledFolder(tmp_path, Settings())
        filled.add_set(0, stored=False)
        ids = stored_ids(filled)
        filled.close()
        assert [event.id for event in take(events, len(ids))] == ids


@pytest.mark.parametrize("value", ["x", "-1", "1e3", "9" * 30])
def test_an_invalid_last_event_id_is_rejected(service, value):
    answer = httpx2.get(f"{service.url}api/v1/stream", headers={"Last-Event-ID": value})
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"


# The hub alone, with an invented catalogue


class InventedEvents:
    """Catalogue double with events that a test adds."""

    def __init__(self):
        self.rows = []
        self.asked = 0

    def add(self, count, topic="sets"):
        first = len(self.rows) + 1
        self.rows += [{"id": first + k, "topic": topic} for k in range(count)]

    def last_id(self):
        return len(self.rows)

    def after(self, event_id, limit):
        self.asked += 1
        return [row for row in self.rows if row["id"] > event_id][:limit]


async def hub_reached(hub, event_id):
    async with asyncio.timeout(DEADLINE_S):
        while hub.last_id < event_id:
            await hub.changed()


def run_with_hub(tmp_path, body, *, poll_interval_s=0.001, stored=1, **options):
    async def run():
        source = InventedEvents()
        source.add(stored)
        context = Context(Settings(), tmp_path)
        context.events = source
        hub = EventHub(source, poll_interval_s=poll_interval_s, **options)
        await hub.start()
        try:
            async with asyncio.timeout(DEADLINE_S):
                await body(source, context, hub)
        finally:
            hub.close()
            await hub.join()

    asyncio.run(run())


def test_slow_client_skips_with_a_gap_and_nothing_queues(tmp_path):
    async def body(source, context, hub):
        client = generate_frames(context, hub, None, 1)
        assert (await anext(client)).startswith(b"retry: ")
        source.add(1)
        assert await anext(client) == encode_event({"id": 2, "topic": "sets"}).frame
        # The client does not read while 40 events pass through a ring of 8 (kept: 8 to 16).
        source.add(40)
        await hub_reached(hub, 42)
        chunk = await anext(client)
        kept = [event.id for event in hub.after(0)]
        assert len(kept) <= 16
        assert chunk.startswith(encode_gap_frame(2, kept[0] - 1, "the client was too slow"))
        assert chunk.count(b"event: sets\n") == len(kept)
        assert kept[-1] == 42
        await client.aclose()
        assert hub.clients == 0

    run_with_hub(tmp_path, body, ring_events=8)


def test_a_quiet_stream_sends_heartbeats(tmp_path):
    async def body(source, context, hub):
        client = generate_frames(context, hub, frozenset({"alarms"}), None)
        await anext(client)
        assert await anext(client) == HEARTBEAT
        # Events of other topics do not keep it from beating.
        source.add(3)
        assert await anext(client) == HEARTBEAT
        await client.aclose()

    run_with_hub(tmp_path, body, heartbeat_interval_s=0.02)


def test_a_busy_stream_sends_heartbeats(tmp_path):
    """A page counts heartbeats, not events, as it does not know every topic."""

    async def body(source, context, hub):
        client, chunks = generate_frames(context, hub, None, 1), []
        await anext(client)
        while b"".join(chunks).count(HEARTBEAT) < 3:
            source.add(1)
            chunks.append(await anext(client))
        assert b"event: sets" in b"".join(chunks)
        await client.aclose()

    run_with_hub(tmp_path, body, heartbeat_interval_s=0.02)


def test_a_stream_sends_heartbeats_before_the_catalogue_is_readable(tmp_path):
    class Unreadable(InventedEvents):
        def last_id(self):
            raise StorageError("locked")

    async def body():
        hub = EventHub(Unreadable(), heartbeat_interval_s=0.02)
        await hub.start()
        client = generate_frames(Context(Settings(), tmp_path), hub, None, None)
        await anext(client)
        async with asyncio.timeout(DEADLINE_S):
            assert await anext(client) == HEARTBEAT
        await client.aclose()
        hub.close()
        await hub.join()

    asyncio.run(body())


def test_no_error_of_the_source_ends_the_tail(tmp_path, caplog, monkeypatch):
    monkeypatch.setattr("daq_service.web.streams.hub.UNREADABLE_INTERVAL_S", 0.0)

    async def body(source, context, hub):
        errors, after = [ValueError("no JSON"), KeyError("payload"), RecursionError()], source.after

        def fail(event_id, limit):
            if errors and event_id:
                raise errors.pop()
            return after(event_id, limit)

        source.after = fail
        source.add(1)
        await hub_reached(hub, 2)

    run_with_hub(tmp_path, body)
    assert caplog.text.count("cannot read events") == 3


def test_an_id_ahead_of_the_stream_is_no_gap(tmp_path):
    """REST reads the catalogue itself and may be one poll ahead of the stream."""

    async def body(source, context, hub):
        while hub.complete_after is None:
            await hub.changed()
        source.add(3)
        client = generate_frames(context, hub, None, 4)
        await anext(client)
        # The tail sleeps for a minute: the first thing to hear is the heartbeat, not a gap.
        assert await anext(client) == HEARTBEAT
        await client.aclose()

    run_with_hub(tmp_path, body, poll_interval_s=60.0, heartbeat_interval_s=0.02)


def test_each_event_is_encoded_once_for_all_clients(tmp_path):
    async def body(source, context, hub):
        clients = [generate_frames(context, hub, None, 1) for _ in range(50)]
        for client in clients:
            await anext(client)
        source.add(1)
        chunks = [await anext(client) for client in clients]
        assert set(chunks) == {encode_event({"id": 2, "topic": "sets"}).frame}
        assert hub.after(1)[0].frame is hub.after(1)[0].frame
        assert hub.clients == 50
        for client in clients:
            await client.aclose()
        assert hub.clients == 0

    run_with_hub(tmp_path, body)


def test_simultaneous_reconnections_read_the_catalogue_once(tmp_path):
    async def body(source, context, hub):
        while hub.complete_after is None:
            await hub.changed()
        asked = source.asked
        clients = [generate_frames(context, hub, None, 0) for _ in range(50)]
        for client in clients:
            chunks = [await anext(client)]
            while b"id: 1200\n" not in chunks[-1]:
                chunks.append(await anext(client))
            ids = [
                int(line[4:]) for chunk in chunks for line in chunk.splitlines() if line.startswith(b"id: ")
            ]
            assert ids == list(range(1, 1201))
            assert max(map(len, chunks)) < 20_000
        assert source.asked == asked == 3  # pages of 500
        for client in clients:
            await client.aclose()

    run_with_hub(tmp_path, body, stored=1200, poll_interval_s=60.0)


def test_a_client_far_behind_does_not_delay_others(tmp_path):
    async def body(source, context, hub):
        behind, other = generate_frames(context, hub, None, 0), []

        async def ask():
            other.append(len(got))

        got = []
        await anext(behind)
        while not (got and b"id: 1200\n" in got[-1]):
            asking = asyncio.create_task(ask())
            got.append(await anext(behind))
            if len(got) > 1:
                assert asking.done(), "a whole chunk was made before anybody else was looked at"
        assert len(got) > 30
        await behind.aclose()

    run_with_hub(tmp_path, body, stored=1200, poll_interval_s=60.0)


def test_streams_that_start_together_do_not_delay_another_response():
    started = []

    async def app(scope, receive, send):
        started.append(scope["path"])

    async def body():
        guard = RequestGuard(app)
        scope = {"type": "http", "method": "GET", "headers": [(b"host", b"localhost")]}
        paths = [*100 * ["/tests/a/api/v1/stream"], "/healthz"]
        await asyncio.gather(*(guard({**scope, "path": path}, None, None) for path in paths))

    asyncio.run(body())
    assert len(started) == 101
    assert started.index("/healthz") == 0
