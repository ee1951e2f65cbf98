"""The webhook with real HTTP servers: signature, rejections, and time limits."""

import hashlib
import hmac
import json
import logging
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from email.utils import formatdate
from pathlib import Path

import pytest
from support.receivers import http_receiver
from support.reported_alarms import notifying
from support.waiting import happened

from daq_service.clock import MachineClock
from daq_service.errors import UsageError
from daq_service.processes.notifications.addresses import (
    Address,
    hide_address_secrets,
    read_address,
    validate_receivers,
)
from daq_service.processes.notifications.by_apprise import deliver_by_apprise
from daq_service.processes.notifications.messages import Message
from daq_service.processes.notifications.webhook import LONGEST_RETRY_AFTER_S, Cut, post_message
from daq_service.settings.notifications import ReceiverSettings

TLS = Path(__file__).parents[3] / "fixtures" / "tls"
SECRET = "correct-horse-battery-staple"
MESSAGE = Message(
    key="abc.duty.7", kind="test", title="Prüfung", text="Nothing is wrong.", facts={"test": "t"}
)


@pytest.fixture
def soon(monkeypatch):
    """Let only the total time run out."""
    monkeypatch.setattr("daq_service.processes.notifications.webhook.READ_WITHIN_S", 30.0)
    monkeypatch.setattr("daq_service.processes.notifications.webhook.ANSWER_WITHIN_S", 0.2)


@pytest.fixture
def receiver():
    with http_receiver() as running:
        yield running


def send(receiver, **options):
    return post_message(Address(receiver.url, SECRET.encode()), MESSAGE, **options)


def is_genuine(secret, header, body):
    """Check the signature as docs/how-to/get-notified.md describes."""
    parts = dict(part.split("=", 1) for part in header.split(","))
    wanted = hmac.new(secret.encode(), parts["t"].encode() + b"." + body, hashlib.sha256).hexdigest()
    return hmac.compare_digest(wanted, parts["v1"])


def test_a_message_is_signed_with_its_time_and_bears_its_key(receiver):
    outcome = send(receiver, machine=MachineClock(utc_ns=lambda: 1_700_000_000_900_000_000))
    got = receiver.next()
    assert (outcome.ok, outcome.status) == (True, 204)
    header = got.headers["Solimon-Signature"]
    assert header.startswith("t=1700000000,v1=")
    assert is_genuine(SECRET, header, got.body)
    assert not is_genuine(SECRET, header.replace("t=1700000000", "t=1700000001"), got.body)
    assert not is_genuine(SECRET, header, got.body + b" ")
    assert not is_genuine(SECRET + "r", header, got.body)
    assert got.headers["Idempotency-Key"] == got.message["key"] == "abc.duty.7"
    assert (got.message["title"], got.message["kind"], got.path) == ("Prüfung", "test", "/hook")


@pytest.mark.parametrize(
    ("status", "headers", "message", "refused", "retry_after_s"),
    [
        (200, {}, "taken (200)", False, 0.0),
        (500, {}, "the receiver answers 500 Internal Server Error", False, 0.0),
        (422, {}, "the receiver answers 422 Unprocessable Entity", True, 0.0),
        (503, {"Retry-After": "120"}, "the receiver answers 503 Service Unavailable", False, 120.0),
        (429, {"Retry-After": formatdate(1_000_060.0, usegmt=True)}, "429 Too Many Requests", False, 60.0),
        (429, {"Retry-After": "999999"}, "429 Too Many Requests", False, LONGEST_RETRY_AFTER_S),
        (429, {"Retry-After": "soon"}, "429 Too Many Requests", False, 0.0),
    ],
)
def test_a_response_determines_the_outcome(status, headers, message, refused, retry_after_s, receiver):
    receiver.answers.put((status, headers))
    outcome = send(receiver, machine=MachineClock(utc_ns=lambda: 1_000_000_000_000_000))
    assert message in outcome.description
    assert (outcome.ok, outcome.refused, outcome.retry_after_s) == (status < 300, refused, retry_after_s)


def test_redirects_are_not_followed(receiver):
    with http_receiver() as elsewhere:
        for status in (301, 302, 307, 308):
            receiver.answers.put((status, {"Location": elsewhere.url}))
            outcome = send(receiver)
            assert not outcome.ok
            assert "it points elsewhere, where nothing is sent" in outcome.description
        assert elsewhere.got.empty()


def test_a_receiver_that_sends_single_bytes_is_given_up_after_the_time_limit(soon):
    """Each byte is in time; only the total time limit ends it."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        left = threading.Event()

        def drip():
            connection, _ = listener.accept()
            with connection:
                while not left.wait(0.01):
                    try:
                        connection.sendall(b"H")
                    except OSError:
                        return

        thread = threading.Thread(target=drip)
        thread.start()
        outcome = post_message(Address(f"http://127.0.0.1:{listener.getsockname()[1]}/", b"s"), MESSAGE)
        left.set()
        thread.join()
    assert outcome.description == "no answer within 0.2 s"


def test_the_service_s_end_cuts_an_attempt(receiver):
    receiver.silent.set()
    cut, outcomes = Cut(), []
    thread = threading.Thread(target=lambda: outcomes.append(send(receiver, cut=cut)))
    thread.start()
    receiver.next()
    cut.close()
    thread.join()
    assert [outcome.ok for outcome in outcomes] == [False]


def test_an_untrusted_certificate_is_rejected(monkeypatch):
    with http_receiver(tls=TLS) as receiver:
        outcome = send(receiver)
        assert not outcome.ok
        assert outcome.description.startswith("its certificate is refused:")
        assert receiver.got.empty()
        monkeypatch.setenv("SSL_CERT_FILE", str(TLS / "certificate.pem"))
        assert post_message(Address(receiver.url.replace("127.0.0.1", "localhost"), b"s"), MESSAGE).ok


def test_a_refused_connection_and_an_invalid_response_are_outcomes():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    assert (
        post_message(Address(f"http://127.0.0.1:{port}/", b"s"), MESSAGE).description == "Connection refused"
    )
    with socket.create_server(("127.0.0.1", 0)) as listener:
        answered = threading.Event()

        def nonsense():
            connection, _ = listener.accept()
            with connection:
                connection.recv(100)
                connection.sendall(b"SSH-2.0-OpenSSH\r\n")
                happened(answered.wait, "the client's outcome")

        thread = threading.Thread(target=nonsense)
        thread.start()
        outcome = post_message(Address(f"http://127.0.0.1:{listener.getsockname()[1]}/", b"s"), MESSAGE)
        answered.set()
        thread.join()
    assert outcome.description == "no answer of HTTP (BadStatusLine)"


# Sources of addresses and secrets


def webhook(**given):
    return ReceiverSettings(**{"url": "http://127.0.0.1/", "secret_env": "DUTY_SECRET", **given})


def test_addresses_and_secrets_are_read_from_the_configured_source(tmp_path):
    (tmp_path / "url").write_text("http://127.0.0.1:8/hook/T0K3N\n", encoding="utf-8")
    receiver = webhook(url="", url_file=str(tmp_path / "url"))
    address = read_address("duty", receiver, {"DUTY_SECRET": SECRET})
    assert (address.url, address.secret) == ("http://127.0.0.1:8/hook/T0K3N", SECRET.encode())
    assert SECRET not in repr(address)
    assert "T0K3N" not in str(address)
    assert hide_address_secrets(receiver) == "from url"
    assert hide_address_secrets(webhook(url="http://127.0.0.1:8/hook/T0K3N")) == "http://127.0.0.1:8"


@pytest.mark.parametrize(
    ("given", "held", "message"),
    [
        ({}, {}, "the variable DUTY_SECRET of secret_env is not set"),
        ({}, {"DUTY_SECRET": "hush"}, "the secret has 4 characters; give one of 16 or more"),
        ({"secret_env": "", "secret_file": "/nowhere/s"}, {}, "secret_file /nowhere/s cannot be read"),
        (
            {"url": "", "url_env": "HOOK"},
            {"HOOK": f"http://alarms.example.org/{SECRET}"},
            "http:// to alarms.example.org",
        ),
        (
            {"url": "", "url_env": "HOOK"},
            {"HOOK": f"https://ann:{SECRET}@example.org/"},
            "a name or a password",
        ),
        (
            {"kind": "apprise", "url": "", "url_env": "HOOK", "secret_env": ""},
            {"HOOK": SECRET},
            "the address is none of apprise",
        ),
    ],
)
def test_an_invalid_receiver_is_reported_without_its_secret(given, held, message):
    with pytest.raises(UsageError, match=message) as refusal:
        read_address("duty", webhook(**given), held)
    assert SECRET not in str(refusal.value)
    assert str(refusal.value).startswith("notifications.receivers.duty: ")


def test_a_start_rejects_unusable_receivers_and_rules(monkeypatch):
    mail = {"kind": "apprise", "url_env": "NO_SUCH_VARIABLE"}
    with pytest.raises(UsageError, match="NO_SUCH_VARIABLE of url_env is not set"):
        validate_receivers(notifying({"mail": mail}).notifications)
    monkeypatch.setenv("DUTY_SECRET", SECRET)
    with pytest.raises(
        UsageError, match=r"rule 1: there is no kind of alarm 'wall_chance'; there are climate"
    ):
        validate_receivers(notifying(rules=[{"kinds": ["wall_chance"]}]).notifications)


@pytest.fixture
def apprise_pool(monkeypatch):
    """Replace the thread pools of apprise, which live as long as the process."""
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with ThreadPoolExecutor() as pool:
        for name in ("utils.http._DNS_POOL", "apprise._shared_executor", "apprise._coordinator_executor"):
            monkeypatch.setattr(f"apprise.{name}", pool)
        yield


OF_APPRISE = pytest.mark.filterwarnings("ignore:'imghdr' is deprecated:DeprecationWarning")


@OF_APPRISE
@pytest.mark.usefixtures("apprise_pool")
def test_apprise_sends_a_message_and_logs_no_address(receiver, caplog):
    host = receiver.url.removeprefix("http://").removesuffix("/hook")
    address = Address(f"json://ann:{SECRET}@{host}/hook", b"")
    with caplog.at_level(logging.DEBUG):
        assert deliver_by_apprise(address, MESSAGE).ok
        receiver.answers.put((500, {}))
        assert not deliver_by_apprise(address, MESSAGE).ok
        assert (
            "does not know this kind" in deliver_by_apprise(Address("nonsense://x", b""), MESSAGE).description
        )
    assert json.loads(receiver.next().body)["title"] == "Prüfung"
    assert SECRET not in caplog.text


@pytest.mark.parametrize(
    "header",
    [
        "Mon, 01 Jan 99999999999999999999 00:00:00 GMT",
        "Mon, 01 Jan 2024 00:00:00 +99999999999999999999",
        "Mon, 99 Jan 2024 00:00:00 GMT",
        "9" * 5000,
        "\N{SUPERSCRIPT TWO}",
        "-1",
        "soon",
        "",
    ],
)
def test_no_retry_after_ends_the_thread_of_a_receiver(receiver, header):
    receiver.answers.put((503, {"Retry-After": header}))
    outcome = send(receiver)
    assert (outcome.ok, outcome.status) == (False, 503)
    assert 0.0 <= outcome.retry_after_s <= LONGEST_RETRY_AFTER_S


@OF_APPRISE
@pytest.mark.usefixtures("apprise_pool")
def test_a_netrc_lends_no_password_to_a_receiver_of_apprise(receiver, monkeypatch, tmp_path):
    (tmp_path / "netrc").write_text("default login ann password secret\n", encoding="ascii")
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
    assert deliver_by_apprise(Address(receiver.url.replace("http://", "json://"), b""), MESSAGE).ok
    assert "Authorization" not in receiver.next().headers
