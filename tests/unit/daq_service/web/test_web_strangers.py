"""Invalid requests: malformed, repeated, cross-site, anonymous, or incomplete."""

import select
import sys
from contextlib import ExitStack, suppress

import pytest
from support.filled_folder import filled_folder
from support.served_web import served
from support.waiting import until

from daq_service.commands.registry import KINDS
from daq_service.errors import UsageError
from daq_service.settings.tree import Settings
from daq_service.settings.web import WebSettings
from daq_service.web import bounded_http, server
from daq_service.web.auth.tokens import KnownTokens, create_token, revoke_token

FAR = Settings(web=WebSettings(host_names=("lab.example.org",), proxy="127.0.0.1"))
BLANKS = [
    "   ",
    "\t",
    "\u00a0\u2003",
    "\u200b\u2060\ufeff",
    "\u3164",
    "\u2800",
    "\x00\x1b",
    "\u202e",
    "\u00ad",
]


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    with filled_folder(tmp_path_factory.mktemp("data")) as folder:
        folder.add_set(0, stored=False, shown=True)
        folder.add_alarm("B", 0)
        yield folder


# Headers


@pytest.mark.parametrize(
    "origin", ["http://[", "http://[::1", "http://]", "://", "http://\xff", "http://a:b:c"]
)
def test_a_malformed_origin_is_foreign(api, origin):
    headers = {"Origin": origin.encode("latin-1")}
    assert api.post("/api/v1/commands", json={"kind": "stop"}, headers=headers).status_code == 403
    assert api.get("/api/v1/stream", headers=headers).status_code == 403
    headers["Sec-Fetch-Site"] = "cross-site"
    assert api.get("/api/v1/info", headers=headers).status_code == 403


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("Host", ("127.0.0.1", "evil.example")),
        ("Host", ("evil.example", "127.0.0.1")),
        ("Host", ("127.0.0.1", "127.0.0.1")),
        ("Origin", ("http://127.0.0.1", "http://evil.example")),
        ("Sec-Fetch-Site", ("same-origin", "cross-site")),
    ],
)
def test_a_duplicate_single_header_is_rejected(service, name, values):
    lines = [f"{name}: {value}" for value in values] + ([] if name == "Host" else ["Host: 127.0.0.1"])
    with service.connection() as client:
        client.sendall(
            "\r\n".join(["GET /api/v1/stream HTTP/1.1", *lines, "Connection: close", "", ""]).encode()
        )
        answer = b"".join(iter(lambda: client.recv(65536), b""))
    assert answer.startswith(b"HTTP/1.1 400 " if name == "Host" else b"HTTP/1.1 403 ")


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        ("tables/sets?position=B", {"Accept": "text/csv;q=\xb2"}),
        ("tables/sets?position=B", {"Accept": "text/csv;q=nan,text/csv;q=-1,;;q="}),
        ("stream", {"Last-Event-ID": "\xb2"}),
        ("stream", {"Last-Event-ID": "9" * 5000}),
        ("info", {"If-None-Match": '"\xff,W/"'}),
        ("info", {"Cookie": 'a="\\9;=;'}),
        ("info", {"Authorization": "Bearer \xff"}),
        ("files/set_1_a.h5", {"Range": "bytes=\xb2-"}),
    ],
)
def test_a_malformed_header_is_a_client_error(api, path, headers):
    encoded = {name: value.encode("latin-1") for name, value in headers.items()}
    with api.stream("GET", f"/api/v1/{path}", headers=encoded) as answer:
        assert answer.status_code < 500


BODIES = [
    b"[" * 60_000,
    b'{"\\ud800": 1}',
    b'{"kind": "pause", "author": "\\ud800"}',
    b"\xff",
    b"1e999",
    b"{}{}",
]


@pytest.mark.parametrize("body", BODIES, ids=lambda body: repr(body[:20]))
def test_a_malformed_body_is_a_client_error(api, body):
    answer = api.post("/api/v1/commands", content=body, headers={"Content-Type": "application/json"})
    assert 400 <= answer.status_code < 500


# Foreign pages


@pytest.fixture
def far(tmp_path):
    create_token(tmp_path / "tokens.json", "ann", "viewer")
    return tmp_path


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("/api/v1/info", {}, 403),
        ("/api/v1/report", {"Sec-Fetch-Mode": "navigate"}, 403),
        ("/api/v1/info", {"Origin": "https://evil.example"}, 403),
        ("/api/v1/info", {"Origin": "null"}, 403),
        ("/", {"Sec-Fetch-Mode": "navigate"}, 200),
        ("/healthz", {}, 200),
        ("/api/v1/info", {"Origin": "https://lab.example.org"}, 401),
        ("/api/v1/info", {"Sec-Fetch-Site": "same-origin"}, 401),
        ("/api/v1/info", {"Sec-Fetch-Site": "none"}, 401),
    ],
)
def test_a_cross_site_page_reaches_only_the_token_check(far, path, headers, status):
    """The response is 401: the request reaches the token check only."""
    with served(FAR, far) as service, service.client() as api:
        sent = {"Host": "lab.example.org", "X-Forwarded-Proto": "https", "Sec-Fetch-Site": "cross-site"}
        assert api.get(path, headers=sent | headers).status_code == status


# Names


@pytest.mark.parametrize("blank", BLANKS, ids=ascii)
def test_a_blank_author_or_reason_is_rejected(filled, api, blank):
    before = len(filled.catalogue.list_open_commands())
    assert api.post("/api/v1/alarms/1/acknowledge", json={"author": blank}).status_code == 422
    for kind, author, arguments in (
        ("resume", blank, {}),
        ("pause", "ann", {"note": blank}),
        ("renew_baseline", "ann", {"position": "B", "note": blank}),
        ("shelve_alarm", "ann", {"alarm_id": 1, "for_h": 1.0, "reason": blank}),
        ("take_out_of_service", "ann", {"alarm_id": 1, "reason": blank}),
        ("annotate", "ann", {"from_h": 0.0, "text": blank}),
        ("annotate", blank, {"from_h": 0.0, "text": "a note"}),
    ):
        order = {"kind": kind, "author": author, "arguments": arguments}
        assert api.post("/api/v1/commands", json=order).status_code == 422, kind
    assert len(filled.catalogue.list_open_commands()) == before


def test_every_command_needs_a_name():
    for kind, order in KINDS.items():
        assert "pattern" in order.model_json_schema()["properties"]["author"], kind


# Tokens


def test_a_lost_token_file_rejects_all_after_a_restart(tmp_path, caplog):
    path = tmp_path / "tokens.json"
    create_token(path, "ann", "admin")
    path.unlink()
    assert KnownTokens(path).asked_for
    assert "all requests are rejected" in caplog.text
    create_token(path, "bob", "admin")
    assert KnownTokens(path).has_valid_token("bob", "admin")


def test_revoking_without_tokens_does_not_require_tokens(tmp_path):
    path = tmp_path / "tokens.json"
    with pytest.raises(UsageError, match="no token 'ann'"):
        revoke_token(path, "ann")
    assert not KnownTokens(path).asked_for


# Connections


def _closed(clients):
    return len(select.select(clients, [], [], 0)[0])


def _ended(client):
    """Read the available bytes; return whether the connection is closed."""
    client.setblocking(False)
    with suppress(BlockingIOError):
        while client.recv(65536):
            continue
        return True
    return False


@pytest.mark.parametrize(
    "request_start",
    [b"", b"GET / HT", b"POST /api/v1/commands HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 9\r\n\r\n{"],
    ids=["silent", "headers", "body"],
)
@pytest.mark.parametrize("limit", ["MOST_WAITING", "MOST_WAITING_OF_ADDRESS"])
def test_connections_with_an_incomplete_request_are_limited(filled, monkeypatch, limit, request_start):
    monkeypatch.setattr(bounded_http, limit, 3)
    monkeypatch.setattr(bounded_http, "LOOK_EVERY_S", 0.02)
    with served(filled.settings, filled.folder) as service, ExitStack() as opened:
        stream = opened.enter_context(
            service.connection(b"GET /api/v1/stream HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        )
        assert stream.recv(4096).startswith(b"HTTP/1.1 200 ")
        clients = [opened.enter_context(service.connection(request_start)) for _ in range(8)]
        until(lambda: _closed(clients) == 5, "all but three to be closed")
        with service.client() as api:
            assert api.get("/healthz").status_code == 200
        assert not _ended(stream), "its request was complete"


def test_above_the_connection_limit_the_longest_idle_one_is_closed(filled, monkeypatch):
    monkeypatch.setattr(server, "MOST_CONNECTIONS", 2)
    with served(filled.settings, filled.folder) as service, ExitStack() as opened:
        clients = [opened.enter_context(service.connection()) for _ in range(4)]
        until(lambda: _closed(clients) == 3, "all but the newest to be closed")
        assert not _closed(clients[-1:])
        with service.client() as api:  # it frees its place, too
            until(lambda: api.get("/healthz").status_code == 200, "a place")


@pytest.mark.skipif(sys.platform == "win32", reason="there is no such limit")
@pytest.mark.parametrize(
    ("limits", "refused", "most"),
    [((1024, 1024), False, 816), ((256, 4096), False, 2500), ((1024, 4096), True, 816), ((64, 64), False, 1)],
)
def test_the_limit_of_handles_is_raised_and_leaves_some(monkeypatch, limits, refused, most):
    import resource

    raised = []

    def set_limit(_, new):
        if refused:
            raise ValueError("not allowed to raise maximum limit")
        raised.append(new)

    monkeypatch.setattr(resource, "getrlimit", lambda _: limits)
    monkeypatch.setattr(resource, "setrlimit", set_limit)
    assert server.raise_connection_limit() == most
    assert raised == ([] if refused else [(limits[1], limits[1])])
