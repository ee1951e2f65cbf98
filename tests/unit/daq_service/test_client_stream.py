"""No message, header or response ends a client that follows: unreadable ones are reported and left out."""

import itertools
import json
import logging

import httpx2
import pytest

from daq_service.client import connection
from daq_service.client.connection import Connection, parse_events, split_lines

U2028 = "a note\N{LINE SEPARATOR}of two lines,\N{NEXT LINE}\x0b\x0c\x1c\x1d\x1e and more"


def frame(event_id, text="fine", end="\n"):
    data = json.dumps({"text": text}, ensure_ascii=False)
    return end.join([f"id: {event_id}", "event: service", f"data: {data}", "", ""])


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("size", [1, 2, 7, 10_000])
def test_lines_end_by_cr_lf_and_nothing_else(end, size):
    # JSON escapes control characters; other services may not.
    sent = (frame(1, U2028, end) + frame(2, end=end)).encode()
    chunks = [sent[at : at + size] for at in range(0, len(sent), size)]
    assert [event["text"] for event in parse_events(split_lines(chunks))] == [U2028, "fine"]


UNREADABLE = {
    "no JSON": "id: 7\nevent: sets\ndata: {oops\n\n",
    "no object": "id: 7\nevent: sets\ndata: [1]\n\n",
    "a number": "id: 7\nevent: sets\ndata: 3\n\n",
    "no id": "event: sets\ndata: {}\n\n",
    "no number as id": "id: x\nevent: sets\ndata: {}\n\n",
    "an id below zero": "id: -1\nevent: sets\ndata: {}\n\n",
    "an id that is too large": f"id: {'9' * 30}\nevent: sets\ndata: {{}}\n\n",
    "an id of too many digits": f"id: {'9' * 5000}\nevent: sets\ndata: {{}}\n\n",
    "too deep": f"id: 7\nevent: sets\ndata: {'[' * 100_000}\n\n",
    "no text": b"id: 7\nevent: sets\ndata: \xff\xfe\n\n",
}


@pytest.mark.parametrize("unreadable", UNREADABLE.values(), ids=UNREADABLE)
def test_a_frame_that_cannot_be_read_is_reported_and_skipped(unreadable, caplog):
    between = unreadable if isinstance(unreadable, bytes) else unreadable.encode()
    sent = frame(1).encode() + between + frame(8).encode()
    assert [event["id"] for event in parse_events(split_lines([sent]))] == [1, 8]
    assert "cannot be read and is left out" in caplog.text


def test_other_fields_comments_and_heartbeats_are_no_events_and_no_trouble(caplog):
    sent = ": comment\n\nevent: heartbeat\ndata: {}\n\nretry: 7\n\nfield\n\nevent: sets\n\ndata: {}\n\n"
    spaced = 'id:9\nevent:sets\ndata:{"a":\ndata: 1}\n\n'
    assert list(parse_events(split_lines([(sent + spaced).encode()]))) == [
        {"topic": "sets", "kind": "sets", "a": 1, "id": 9}
    ]
    assert not caplog.records


def test_a_line_without_an_end_takes_bounded_memory(monkeypatch, caplog):
    monkeypatch.setattr(connection, "LONGEST_LINE_BYTES", 100)
    chunks = [b"id: 1\nevent: sets\ndata: ", *[b"x" * 90] * 50, b"\n\n", frame(2).encode()]
    assert [event["id"] for event in parse_events(split_lines(chunks))] == [2]


PASSING = {
    "a proxy without a backend": {"status_code": 502, "html": "<h1>Bad Gateway</h1>"},
    "an error of the service": {"status_code": 500, "json": {}},
    "too many requests": {"status_code": 429},
    "no record yet": {"status_code": 503, "json": {"detail": "x", "hint": "y", "type": "z"}},
    "a page to log in": {"status_code": 200, "html": "<h1>Log in</h1>"},
    "a redirection": {"status_code": 302, "headers": {"Location": "/login"}},
    "nonsense compressed": {
        "status_code": 200,
        "headers": {"Content-Encoding": "gzip"},
        "text": "no gzip at all",
    },
    "a dead connection": httpx2.ReadTimeout("no heartbeat"),
    "no HTTP": httpx2.RemoteProtocolError("illegal header line"),
}
STREAM = {"Content-Type": "text/event-stream; charset=utf-8"}


@pytest.mark.parametrize("passing", PASSING.values(), ids=PASSING)
def test_no_temporary_error_ends_the_stream(passing, monkeypatch, caplog):
    monkeypatch.setattr(connection, "RETRY_S", 0.0)
    last_event_ids = []
    streams = iter([frame(1), passing, passing, frame(2)])

    def answer(request):
        last_event_ids.append(request.headers["Last-Event-ID"])
        given = next(streams)
        if isinstance(given, Exception):
            raise given
        if isinstance(given, str):
            return httpx2.Response(200, content=given, headers=STREAM)
        content = {"stream": httpx2.ByteStream(given["text"].encode())} if "text" in given else {}
        return httpx2.Response(**{key: value for key, value in given.items() if key != "text"}, **content)

    http = httpx2.Client(base_url="http://127.0.0.1:1", transport=httpx2.MockTransport(answer))
    events = Connection(http).events(0, None)
    assert [event["id"] for event in itertools.islice(events, 2)] == [1, 2]
    assert last_event_ids == ["0", "1", "1", "1"]
    assert len([record for record in caplog.records if record.levelno == logging.WARNING]) <= 1, (
        "once, not each time"
    )
