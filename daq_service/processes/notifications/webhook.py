"""A signed POST of JSON, bounded in time; redirects are not followed, certificates are verified.

The signature is the HMAC-SHA256 of ``TIME.BODY`` under the receiver's secret, TIME in s since 1970, sent as
``Solimon-Signature: t=TIME,v1=HEX``. A receiver that drops what is older than some minutes, and a key
(``Idempotency-Key``) that it has seen, takes each message once and no forged one.
"""

from __future__ import annotations

import hashlib
import hmac
import http.client
import logging
import socket
import ssl
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from email.utils import parsedate_to_datetime
from importlib.metadata import version
from urllib.parse import urlsplit

from daq_service.processes.notifications.addresses import Address
from daq_service.processes.notifications.messages import Message

log = logging.getLogger(__name__)

SIGNATURE, KEY = "Solimon-Signature", "Idempotency-Key"
REFUSES_THE_MESSAGE = (400, 413, 422)
LONGEST_RETRY_AFTER_S = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """How long a receiver is waited for, in s: to connect, for each part of its answer, altogether."""

    connect_s: float = 5.0
    read_s: float = 10.0
    whole_s: float = 15.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of an attempt.

    Attributes
    ----------
    told
        For a person; never the address or the secret.
    retry_after_s
        How long the receiver asks to be left alone.
    refused
        It will not have this message: others it may.
    """

    ok: bool
    told: str
    status: int | None = None
    retry_after_s: float = 0.0
    refused: bool = False


class Cut:
    """Ends attempts from elsewhere: when the whole time is over, or the service ends."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: socket.socket | None = None
        self._closed = False

    def watch(self, opened: socket.socket | None) -> None:
        """Take in which socket an attempt uses now."""
        with self._lock:
            self._open = opened
            if self._closed and opened is not None:
                _shut(opened)

    def __call__(self) -> None:
        """End the attempt that is under way, if there is one."""
        with self._lock:
            if self._open is not None:
                _shut(self._open)

    def close(self) -> None:
        """End it, and all that follow."""
        self._closed = True
        self()


def _shut(opened: socket.socket) -> None:
    with suppress(OSError):  # it is not connected yet, or not any more
        # Not the TLS object's own: that would wait for who reads it.
        socket.socket.shutdown(opened, socket.SHUT_RDWR)


def signature(secret: bytes, time_s: int, body: bytes) -> str:
    """Return the header's value for a body sent at a time."""
    digest = hmac.new(secret, b"%d." % time_s + body, hashlib.sha256).hexdigest()
    return f"t={time_s},v1={digest}"


def post(
    address: Address,
    message: Message,
    *,
    bounds: Bounds | None = None,
    cut: Cut | None = None,
    now_s: Callable[[], float] = time.time,
) -> Outcome:
    """Try once to deliver a message; whatever happens is an outcome, within ``bounds.whole_s``."""
    bounds, cut = bounds or Bounds(), cut or Cut()
    parts = urlsplit(address.url)
    assert parts.hostname is not None, "the address was checked"
    body = message.encoded()
    headers = {
        "Content-Type": "application/json",
        "User-Agent": f"solimon/{version('solimon')}",
        KEY: message.key,
        SIGNATURE: signature(address.secret, int(now_s()), body),
    }
    target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    too_long = threading.Event()

    def end() -> None:
        too_long.set()
        cut()

    timer = threading.Timer(bounds.whole_s, end)
    timer.daemon = True
    timer.start()
    connection = http.client.HTTPConnection(parts.hostname, parts.port or _port(parts.scheme))
    connection.auto_open = 0
    try:
        connection.sock = _connected(parts.scheme, connection.host, connection.port, bounds, cut)
        connection.request("POST", target, body, headers)
        answer = connection.getresponse()
        return _outcome(answer.status, answer.headers.get("Retry-After"), now_s())
    except (OSError, http.client.HTTPException, ValueError) as error:
        told = f"no answer within {bounds.whole_s:g} s" if too_long.is_set() else _trouble(error, bounds)
        return Outcome(ok=False, told=told)
    finally:
        timer.cancel()
        cut.watch(None)
        connection.close()


def _port(scheme: str) -> int:
    return 443 if scheme == "https" else 80


def _connected(scheme: str, host: str, port: int, bounds: Bounds, cut: Cut) -> socket.socket:
    plain = socket.create_connection((host, port), timeout=bounds.connect_s)
    try:
        plain.settimeout(bounds.read_s)
        cut.watch(plain)
        if scheme == "http":
            return plain
        wrapped = ssl.create_default_context().wrap_socket(
            plain, server_hostname=host, do_handshake_on_connect=False
        )
    except BaseException:
        plain.close()
        raise
    try:
        cut.watch(wrapped)
        wrapped.do_handshake()
    except BaseException:
        wrapped.close()
        raise
    return wrapped


def _outcome(status: int, retry_after: str | None, now_s: float) -> Outcome:
    if 200 <= status < 300:
        return Outcome(ok=True, told=f"taken ({status})", status=status)
    told = f"the receiver answers {status} {http.client.responses.get(status, '')}".rstrip()
    if 300 <= status < 400:
        told += ": it points elsewhere, where nothing is sent; give its own address"
    return Outcome(
        ok=False,
        told=told,
        status=status,
        retry_after_s=_seconds(retry_after, now_s),
        refused=status in REFUSES_THE_MESSAGE,
    )


def _seconds(text: str | None, now_s: float) -> float:
    """Read ``Retry-After``: seconds or a date; 0 where it says nothing that can be read."""
    if text is None:
        return 0.0
    try:
        wanted_s = float(text) if text.isdigit() else parsedate_to_datetime(text).timestamp() - now_s
    except (ValueError, TypeError, OverflowError):
        log.debug("a Retry-After that is neither seconds nor a date")
        return 0.0
    return min(max(0.0, wanted_s), LONGEST_RETRY_AFTER_S)


def _trouble(error: Exception, bounds: Bounds) -> str:
    """Say what went wrong in our words: a library's may repeat the address."""
    match error:
        case ssl.SSLCertVerificationError():
            return f"its certificate is refused: {error.verify_message}"
        case ssl.SSLError():
            return f"no encrypted connection: {error.reason}"
        case socket.gaierror():
            return "its host's name is not known here"
        case TimeoutError():
            return f"no answer within {bounds.connect_s:g} s to connect and {bounds.read_s:g} s to answer"
        case OSError():
            return error.strerror or "the connection broke"
        case _:
            return f"no answer of HTTP ({type(error).__name__})"
