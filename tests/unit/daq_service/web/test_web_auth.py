"""Authentication: tokens, cookies, encryption, and secrets that no output exposes."""

import logging
import os
import socket
import ssl
import sys
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

import httpx2
import pytest
from support.filled_folder import filled_folder
from support.machine import clock_in_seconds
from support.served_web import DEADLINE_S, served
from support.waiting import until
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from daq_service.catalogue.history import encode_history_line
from daq_service.commands.audit import Audit, read_audit_log
from daq_service.errors import StorageError, UsageError
from daq_service.processes.line_file import read_newest_lines
from daq_service.settings.tree import Settings
from daq_service.settings.web import WebSettings
from daq_service.web.auth.middleware import LONGEST_REASON, MOST_WRONG, refuse_unprotected_service
from daq_service.web.auth.tokens import KnownTokens, create_token, read_tokens, revoke_token

TLS = Path(__file__).parents[3] / "fixtures" / "tls"
ENCRYPTED = {"tls_certificate": str(TLS / "certificate.pem"), "tls_key": str(TLS / "key.pem")}
HOLD = {"kind": "pause", "author": "mallory", "arguments": {"note": "hands in the rig"}}
DUE = "/api/v1/info"


@pytest.fixture
def filled(tmp_path):
    with filled_folder(tmp_path) as folder:
        folder.add_set(0, stored=False, shown=True)
        yield folder


@pytest.fixture
def tokens(tmp_path):
    return tmp_path / "tokens.json"


@contextmanager
def logged_in(filled, token):
    """Serve a folder; yield the client of a person with a token."""
    bearer = {"Authorization": f"Bearer {token}"}
    with served(filled.settings, filled.folder) as service, service.client(**bearer) as api:
        yield api


def audit_entries(folder, **wanted):
    """Return the audit entries, the oldest first."""
    found = [deed for _, deed in reversed(read_audit_log(folder, limit=1000)[0])]
    return [deed for deed in found if all(getattr(deed, key) == value for key, value in wanted.items())]


# Tokens in their file


def test_a_token_is_stored_as_a_hash_readable_by_its_owner_only(tokens):
    token, text = create_token(tokens, "ann", "operator", days=2.0)
    assert len(text) == 43
    assert text not in tokens.read_text(encoding="utf-8")
    assert read_tokens(tokens) == (token,)
    assert token.state == "valid"
    if sys.platform != "win32":
        assert tokens.stat().st_mode & 0o777 == 0o600


def test_names_of_valid_tokens_are_unique(tokens):
    create_token(tokens, "ann", "viewer")
    with pytest.raises(UsageError, match="ann has a token; revoke it first"):
        create_token(tokens, "ann", "admin")
    assert revoke_token(tokens, "ann").state == "revoked"
    with pytest.raises(UsageError, match="no token 'ann' to revoke; there are: none"):
        revoke_token(tokens, "ann")
    assert create_token(tokens, "ann", "admin")[0].role == "admin"
    assert len(read_tokens(tokens)) == 1
    with pytest.raises(UsageError, match="not a valid token name"):
        create_token(tokens, "../ann", "admin")


def test_a_running_service_follows_the_token_file_and_rejects_all_without_it(tokens):
    now_s = [0.0]
    known = KnownTokens(tokens, machine=clock_in_seconds(lambda: now_s[0]))
    assert not known.asked_for
    _, text = create_token(tokens, "ann", "viewer")
    now_s[0] += 2.0
    assert known.asked_for
    assert known.find(text).name == "ann"
    assert known.find(text[:-1]) is None
    for change in (lambda: revoke_token(tokens, "ann"), tokens.unlink, lambda: tokens.write_text("{")):
        change()
        now_s[0] += 2.0
        assert known.asked_for, "no change of the file opens the doors"
        assert not known.has_valid_token("ann", "viewer")
    with pytest.raises(StorageError, match="not a file of access tokens"):
        read_tokens(tokens)


# Authentication


def test_without_tokens_requests_are_accepted_under_their_claimed_name(filled):
    with served(filled.settings, filled.folder) as service, service.client() as api:
        assert api.get("/api/v1/session").json()["role"] == "claimed"
        assert api.post("/api/v1/commands", json=HOLD).json()["author"] == "mallory"
        assert api.post("/api/v1/tokens", json={"name": "ann", "role": "admin"}).status_code == 409
        (row,) = [row for row in api.get("/api/v1/audit").json()["items"] if row["what"] == "pause"]
    assert (row["author"], row["role"], row["result"], row["source"]) == (
        "mallory",
        "claimed",
        "accepted",
        "127.0.0.1",
    )
    assert row["outcome"] == "pending"


def test_with_a_token_the_name_is_the_token_s(filled, tokens):
    _, text = create_token(tokens, "ann", "operator")
    with logged_in(filled, text) as api:
        assert api.post("/api/v1/commands", json=HOLD).json()["author"] == "ann"
        refused = api.post("/api/v1/commands", json={"kind": "stop"})
        assert (refused.status_code, refused.json()["type"]) == (403, "urn:solimon:problem:role-too-low")
        assert "stop needs the role engineer; ann is operator" in refused.text
    (held,) = audit_entries(filled.folder, what="pause")
    assert (held.author, held.role, held.result, held.command_id) == ("ann", "operator", "accepted", 1)
    (stopped,) = audit_entries(filled.folder, what="stop")
    assert (stopped.author, stopped.result, stopped.command_id) == ("ann", "rejected", None)


def test_the_page_exchanges_a_token_for_a_cookie_and_logs_out(filled, tokens):
    _, text = create_token(tokens, "ann", "viewer")
    with served(filled.settings, filled.folder) as service, service.client() as page:
        assert page.get("/").status_code == page.get("/healthz").status_code == 200
        assert page.get("/api/v1/session").json() == {
            "token_needed": True,
            "name": None,
            "role": None,
            "may": [],
        }
        refused = page.get(DUE)
        assert (refused.status_code, refused.headers["www-authenticate"]) == (401, "Bearer")
        assert page.post("/api/v1/session", json={"token": "x"}).status_code == 401
        entered = page.post("/api/v1/session", json={"token": text})
        assert (entered.json()["name"], entered.json()["role"]) == ("ann", "viewer")
        cookie = entered.headers["set-cookie"]
        assert {"HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
        assert "Secure" not in cookie, "it is http on loopback"
        assert page.get(DUE).status_code == 200
        assert page.delete("/api/v1/session").json()["name"] is None
        assert page.get(DUE).status_code == 401
    assert [(deed.what, deed.author, deed.result) for deed in audit_entries(filled.folder)] == [
        ("log_in", "", "rejected"),
        ("log_in", "ann", "done"),
        ("log_out", "ann", "done"),
    ]


@pytest.mark.parametrize("how", ["revoked", "expired"])
def test_an_invalidated_token_is_rejected_with_its_name(filled, tokens, how):
    _, text = create_token(tokens, "ann", "admin", days=1e-6 if how == "expired" else None)
    if how == "revoked":
        revoke_token(tokens, "ann")
    with logged_in(filled, text) as api:
        answer = api.get(DUE)
    assert answer.status_code == 401
    assert f"The token of ann is {how}." in answer.text


def test_wrong_tokens_are_rate_limited_and_a_valid_one_is_accepted(filled, tokens):
    _, text = create_token(tokens, "ann", "viewer")
    with served(filled.settings, filled.folder) as service, service.client() as api:
        answers = [api.get(DUE, headers={"Authorization": "Bearer x"}) for _ in range(MOST_WRONG + 5)]
        assert [answer.status_code for answer in answers[:MOST_WRONG]] == [401] * MOST_WRONG
        assert 429 in {answer.status_code for answer in answers}
        assert answers[-1].headers["retry-after"]
        assert api.get(DUE, headers={"Authorization": f"Bearer {text}"}).status_code == 200


def test_a_token_is_never_exposed(filled, tokens, caplog):
    """It is in no response, log, audit entry or token file, and a URL with it is not authenticated."""
    caplog.set_level(logging.DEBUG)
    _, text = create_token(tokens, "ann", "viewer")
    wrong = "w" * 43
    with served(filled.settings, filled.folder) as service, service.client() as api:
        answers = [
            api.get(f"{DUE}?token={text}"),
            api.get(f"/api/v1/alarms/{text}", headers={"Authorization": f"Bearer {wrong}"}),
            api.get(DUE, headers={"Authorization": f"Basic {text}"}),
            api.post("/api/v1/session", json={"token": wrong}),
            api.post("/api/v1/session", json={"token": text, "more": text}),
            api.post("/api/v1/commands", json=HOLD, headers={"Cookie": f"solimon={text}"}),
        ]
    assert [answer.status_code for answer in answers] == [401, 401, 401, 401, 422, 401]
    ours = [record for record in caplog.records if not record.name.startswith(("httpx2", "httpcore"))]
    output = "".join(answer.text for i, answer in enumerate(answers) if i != 1)
    output += "".join(record.getMessage() for record in ours)
    for path in filled.folder.rglob("*.json*"):
        output += path.read_text(encoding="utf-8")
    assert text not in output
    assert wrong not in output


def test_revocation_ends_open_streams(filled, tokens, monkeypatch):
    monkeypatch.setattr("daq_service.web.auth.tokens.LOOK_EVERY_S", 0.0)
    monkeypatch.setattr("daq_service.web.routes.waveforms.LOOK_AT_TOKEN_S", 0.05)
    _, text = create_token(tokens, "ann", "viewer")
    bearer = {"Authorization": f"Bearer {text}"}
    with served(filled.settings, filled.folder) as service, service.client(**bearer) as api:
        service.app.state.context.hub.heartbeat_interval_s = 0.05
        address = f"ws://{service.netloc}/api/v1/waveforms/live?positions=B"
        with pytest.raises(InvalidStatus):
            connect(address).close()
        with (
            connect(address, additional_headers=bearer) as pictures,
            api.stream("GET", "/api/v1/stream") as events,
        ):
            assert pictures.recv(timeout=DEADLINE_S)
            revoke_token(tokens, "ann")
            filled.add_set(1, stored=False)
            assert events.read().endswith(b"event: bye\ndata: {}\n\n")
            until(lambda: pictures.protocol.close_rcvd, "the waveforms ending, too")


def test_an_admin_makes_and_revokes_tokens_and_sees_who_did(filled, tokens):
    _, text = create_token(tokens, "ann", "admin")
    with logged_in(filled, text) as api:
        created = api.post("/api/v1/tokens", json={"name": "bob", "role": "viewer"})
        assert created.status_code == 201
        assert api.post("/api/v1/tokens", json={"name": "bob", "role": "viewer"}).status_code == 409
        bob = {"Authorization": f"Bearer {created.json()['token']}"}
        until(lambda: api.get(DUE, headers=bob).status_code == 200, "the new token being known")
        assert api.delete("/api/v1/tokens/bob").json()["state"] == "revoked"
        assert "sha256" not in api.get("/api/v1/tokens").text
        first = api.get("/api/v1/audit?limit=1").json()
        rest = api.get("/api/v1/audit", params={"limit": 99, "cursor": first["next_cursor"]}).json()
    entries = [
        (row["what"], row["result"]) for row in first["items"] + rest["items"] if row["author"] == "ann"
    ]
    assert entries == [("revoke_token", "done"), ("create_token", "rejected"), ("create_token", "done")]


# Other hosts


@pytest.fixture
def tls_service(filled, tokens):
    """Return a service with TLS and its own host name."""
    web = {"host_names": ["lab.example.org"], **ENCRYPTED}
    _, text = create_token(tokens, "ann", "operator")
    with served(Settings(web=web), filled.folder) as service:
        yield service, f"https://127.0.0.1:{service.netloc.rpartition(':')[2]}", text


def test_over_tls_the_cookie_is_secure_and_only_known_names_are_served(tls_service):
    service, url, text = tls_service
    assert service.url.startswith("https://lab.example.org:")
    trusted = ssl.create_default_context(cafile=ENCRYPTED["tls_certificate"])
    with httpx2.Client(base_url=url, verify=trusted, timeout=DEADLINE_S) as api:
        api.headers["Host"] = "lab.example.org"
        entered = api.post("/api/v1/session", json={"token": text})
        cookie = entered.headers["set-cookie"]
        assert cookie.startswith("__Host-solimon-")
        assert {"Secure", "HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
        api.headers["Cookie"] = cookie.partition(";")[0]
        assert api.get(DUE).status_code == 200
        assert api.get(DUE, headers={"Host": "evil.example"}).status_code == 400
        origin = {"Origin": "https://lab.example.org"}
        assert api.post("/api/v1/commands", json=HOLD, headers=origin).status_code == 202
        origin = {"Origin": "https://evil.example"}
        assert api.post("/api/v1/commands", json=HOLD, headers=origin).status_code == 403


def test_plain_http_at_the_tls_port_gets_no_response_and_disturbs_no_client(tls_service, caplog):
    _, url, text = tls_service
    host, port = url.removeprefix("https://").split(":")
    with socket.create_connection((host, int(port)), timeout=DEADLINE_S) as plain:
        plain.sendall(
            f"GET {DUE} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {text}\r\n\r\n".encode()
        )
        try:
            answer = b"".join(iter(lambda: plain.recv(4096), b""))
        except ConnectionResetError:
            answer = b""
    assert b"HTTP" not in answer
    assert httpx2.get(f"{url}/healthz", verify=False, timeout=DEADLINE_S).status_code == 200
    assert [record for record in caplog.records if record.levelno >= logging.ERROR] == []


def test_a_handshake_that_never_ends_is_ended(filled, tokens, monkeypatch):
    create_token(tokens, "ann", "viewer")
    monkeypatch.setattr("daq_service.web.server.HANDSHAKE_WITHIN_S", 0.2)
    web = {"host_names": ["lab.example.org"], **ENCRYPTED}
    with served(Settings(web=web), filled.folder) as service:
        port = int(service.netloc.rpartition(":")[2])
        # Less than the minute that asyncio would wait by itself; a reset is an end, too.
        with (
            socket.create_connection(("127.0.0.1", port), timeout=DEADLINE_S / 2) as silent,
            suppress(ConnectionResetError),
        ):
            assert silent.recv(1) == b""


def test_behind_a_proxy_only_encrypted_requests_are_served(filled, tokens):
    _, text = create_token(tokens, "ann", "viewer")
    web = {"host_names": ["lab.example.org"], "proxy": "127.0.0.1"}
    forwarded = {"Host": "lab.example.org", "X-Forwarded-For": "10.1.2.3", "Authorization": f"Bearer {text}"}
    with served(Settings(web=web), filled.folder) as service, service.client() as api:
        assert api.get(DUE, headers=forwarded | {"X-Forwarded-Proto": "https"}).status_code == 200
        plain = api.get(DUE, headers=forwarded)
        assert (plain.status_code, plain.json()["type"]) == (403, "urn:solimon:problem:not-encrypted")
        local = {"Host": "127.0.0.1", "Authorization": f"Bearer {text}"}
        assert api.get(DUE, headers=local).status_code == 200
        wrong = forwarded | {"X-Forwarded-Proto": "https", "Authorization": "Bearer x"}
        assert api.get(DUE, headers=wrong).status_code == 401
    assert [deed.source for deed in audit_entries(filled.folder, what="enter")] == ["10.1.2.3", "10.1.2.3"]


def test_forwarded_addresses_are_ignored_without_a_configured_proxy(filled, tokens):
    create_token(tokens, "ann", "viewer")
    with served(filled.settings, filled.folder) as service, service.client() as api:
        api.get(DUE, headers={"X-Forwarded-For": "10.1.2.3", "Authorization": "Bearer x"})
    assert [deed.source for deed in audit_entries(filled.folder)] == ["127.0.0.1"]


def test_public_addresses_without_authentication_are_rejected_at_the_start(tmp_path, tokens):
    web = WebSettings(host="0.0.0.0", host_names=("lab.example.org",), **ENCRYPTED)
    with pytest.raises(UsageError, match=r"holds no valid access token.*solimon token create") as refused:
        refuse_unprotected_service(web, tmp_path)
    assert refused.value.exit_code == 2
    create_token(tokens, "ann", "viewer")
    refuse_unprotected_service(web, tmp_path)
    broken = web.model_copy(update={"tls_key": ENCRYPTED["tls_certificate"]})
    with pytest.raises(UsageError, match="cannot be used"):
        refuse_unprotected_service(broken, tmp_path)


# The audit


def test_a_flood_of_refusals_leaves_a_bounded_number_of_lines_and_their_count(tmp_path):
    now_s = [0.0]
    audit = Audit(tmp_path, machine=clock_in_seconds(lambda: now_s[0]))
    stranger = {"author": "", "role": "", "source": "10.0.0.9", "what": "enter"}
    for _ in range(150):
        audit.add(**stranger, result="rejected")
    audit.add(author="ann", role="viewer", source="10.0.0.1", what="stop", result="rejected")
    found = audit_entries(tmp_path)
    assert len(found) == 101
    assert (found[-1].author, found[-1].left_out) == ("ann", 50)
    now_s[0] += 121.0
    audit.add(**stranger, result="rejected")
    audit.add(**stranger, result="rejected")
    assert len(audit_entries(tmp_path)) == 102


def test_a_torn_line_takes_no_other_with_it(tmp_path):
    audit = Audit(tmp_path)
    ann = {"author": "ann", "role": "admin", "source": "terminal", "what": "pause", "result": "accepted"}
    audit.add(**ann)
    with (tmp_path / "audit.jsonl").open("ab") as file:
        file.write(b'{"crc32":"0000')
    audit.add(**ann)
    found, before = read_audit_log(tmp_path, limit=10)
    assert ([number for number, _ in found], before) == ([2, 1], None)


def test_an_entry_of_an_earlier_version_is_read_with_the_current_names(tmp_path):
    entry = {"who": "", "role": "", "source": "10.0.0.9", "what": "enter", "result": "refused"}
    line = encode_history_line(1, "audit", {**entry, "why": "the token is unknown", "utc_ns": 1})
    (tmp_path / "audit.jsonl").write_bytes(line)
    (found,) = audit_entries(tmp_path, result="rejected")
    assert (found.author, found.reason) == ("", "the token is unknown")


@pytest.fixture
def audited(tmp_path):
    """Return 25 audit entries, one per second from 2024-01-01T00:00:00Z, of two people in turns."""
    audit = Audit(tmp_path)
    for number in range(25):
        audit.add(
            author=("ann", "ben")[number % 3 == 0],
            role="admin",
            source="terminal",
            what=("pause", "stop")[number % 2],
            result="accepted",
            utc_ns=1_704_067_200_000_000_000 + number * 1_000_000_000,
        )
    with served(Settings(), tmp_path) as service, service.client() as api:
        yield api


@pytest.mark.parametrize(
    ("query", "found"),
    [
        ({"author": "ben"}, range(0, 25, 3)),
        ({"what": "pause"}, range(0, 25, 2)),
        ({"what": "pause,stop", "author": "ann"}, [n for n in range(25) if n % 3]),
        ({"result": "rejected"}, []),
        ({"from_utc": "2024-01-01T00:00:03Z", "to_utc": "2024-01-01T01:00:07+01:00"}, range(3, 7)),
        ({"from_utc": "0001-01-01T00:00:00+14:00", "to_utc": "9999-12-31T23:59:59-14:00"}, range(25)),
    ],
)
def test_the_filtered_audit_log_is_complete(audited, monkeypatch, query, found):
    monkeypatch.setattr(
        "daq_service.commands.audit.read_newest_lines", partial(read_newest_lines, most_lines=7)
    )
    seen, cursor = [], {}
    while True:
        page = audited.get("/api/v1/audit", params={**query, "limit": 4, **cursor}).json()
        seen += [item["id"] - 1 for item in page["items"]]
        assert len(page["items"]) <= 4
        if page["next_cursor"] is None:
            break
        cursor = {"cursor": page["next_cursor"]}
    assert seen == sorted(found, reverse=True)


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ({"what": "pause,explode"}, "what names 'explode'"),
        ({"result": "maybe"}, "query /result"),
        ({"from_utc": "2024-01-01T00:00:00"}, "query /from_utc"),
        ({"to_utc": "1704067200"}, "give a time with its offset, such as 2024-01-01T00:00:00Z"),
        ({"from_utc": "2024-01-02T00:00:00Z", "to_utc": "2024-01-01T00:00:00Z"}, "before from_utc"),
    ],
)
def test_an_invalid_audit_filter_is_rejected(audited, query, message):
    answer = audited.get("/api/v1/audit", params=query)
    assert answer.status_code == 422
    assert message in answer.json()["detail"]


def test_invalid_and_foreign_requests_are_audited_without_their_content(filled, tokens):
    _, text = create_token(tokens, "ann", "operator")
    bearer = {"Authorization": f"Bearer {text}"}
    foreign = {"Host": f"{'evil.' * 200}example"}
    with served(filled.settings, filled.folder) as service, service.client(**bearer) as api:
        assert api.post("/api/v1/commands", json={"kind": text}).status_code == 422
        assert api.get("/api/v1/sets?limit=0").status_code == 422, "only writes are audited"
        assert api.get(DUE, headers=foreign).status_code == 400
        assert api.post("/api/v1/commands", json=HOLD, headers={"Origin": "http://x"}).status_code == 403
        with pytest.raises(InvalidStatus):
            connect(f"ws://{service.netloc}/api/v1/waveforms/live?positions=B", origin="http://x").close()
    invalid, host, *origins = audit_entries(filled.folder)
    assert (invalid.author, invalid.role, invalid.what) == ("ann", "operator", "create_command")
    assert (invalid.result, invalid.reason) == ("rejected", "the request was not valid")
    assert (host.author, host.what, host.result, len(host.reason)) == (
        "",
        "enter",
        "rejected",
        LONGEST_REASON,
    )
    assert ["Origin is 'http://x'" in deed.reason for deed in origins] == [True, True]
    assert text not in (filled.folder / "audit.jsonl").read_text(encoding="utf-8")


def test_a_full_audit_log_does_not_prevent_a_pause(filled, monkeypatch, caplog):
    def refuse(*_):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr("daq_service.processes.line_file.append_durably", refuse)
    with served(filled.settings, filled.folder) as service, service.client() as api:
        assert api.post("/api/v1/commands", json=HOLD).status_code == 202
    assert "not in audit.jsonl: pause accepted mallory" in caplog.text
