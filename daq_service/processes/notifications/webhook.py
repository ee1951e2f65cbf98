"""Webhook: signed POST of JSON, limited in time; redirects are not followed, certificates are verified.

The signature is the HMAC-SHA256 of ``TIME.BODY`` under the receiver's secret, TIME in s since 1970, sent as
``Solimon-Signature: t=TIME,v1=HEX``. A receiver that rejects messages older than some minutes, and known
keys (``Idempotency-Key``), accepts each message once and no forged one.
"""

from __future__ import annotations

import hashlib
import hmac
import http.client
import logging
import socket
import ssl
import threading
from contextlib import suppress
from dataclasses import dataclass
from email.utils import parsedate_to_datetime
from importlib.metadata import version
from urllib.parse import urlsplit

from daq_service.clock import MACHINE, MachineClock
from daq_service.processes.notifications.addresses import Address
from daq_service.processes.notifications.messages import Message
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

SIGNATURE, KEY = "Solimon-Signature", "Idempotency-Key"
REFUSES_THE_MESSAGE = (400, 413, 422)
LONGEST_RETRY_AFTER_S = 3600.0
CONNECT_WITHIN_S, READ_WITHIN_S, ANSWER_WITHIN_S = 5.0, 10.0, 15.0
"""Time limits of an attempt: to connect, for each part of the response, in total."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Result of an attempt.

    Attributes
    ----------
    description
        Result for a person, without address and secret.
    retry_after_s
        Pause that the receiver requests.
    refused
        The receiver rejects this message, but may accept others.
    """

    ok: bool
    description: str
    status: int | None = None
    retry_after_s: float = 0.0
    refused: bool = False


class Cut:
    """Switch that aborts attempts from another thread: at the time limit, or at the end of the service."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None
        self._closed = False

    def set_socket(self, connection: socket.socket | None) -> None:
        """Set the socket of the present attempt; None at its end.

        After `close` a new socket is shut down at once.
        """
        with self._lock:
            self._socket = connection
            if self._closed and connection is not None:
                _shut_connection(connection)

    def __call__(self) -> None:
        """Abort the present attempt by shutting down its socket; no effect without one."""
        with self._lock:
            if self._socket is not None:
                _shut_connection(self._socket)

    def close(self) -> None:
        """Abort the present attempt and all following ones."""
        self._closed = True
        self()


def _shut_connection(connection: socket.socket) -> None:
    """Shut a connection down so that a thread that reads from it returns; errors are ignored."""
    with suppress(OSError):  # not connected yet, or already closed
        # Not the method of the TLS object, which would wait for its reader.
        socket.socket.shutdown(connection, socket.SHUT_RDWR)


def sign_body(secret: bytes, time_s: int, body: bytes) -> str:
    """Return the signature ``t=TIME,v1=HEX``: HMAC-SHA256 of ``TIME.BODY``, TIME in s since 1970."""
    digest = hmac.new(secret, b"%d." % time_s + body, hashlib.sha256).hexdigest()
    return f"t={time_s},v1={digest}"


def post_message(
    address: Address,
    message: Message,
    *,
    cut: Cut | None = None,
    machine: MachineClock = MACHINE,
) -> Outcome:
    """Try once to deliver a message; return every network error as an outcome, within `ANSWER_WITHIN_S`.

    Redirects are not followed. ``cut`` aborts the attempt from another thread.
    """
    cut = cut or Cut()
    parts = urlsplit(address.url)
    assert parts.hostname is not None, "the address was checked"
    body = message.encode_body()
    headers = {
        "Content-Type": "application/json",
        "User-Agent": f"solimon/{version('solimon')}",
        KEY: message.key,
        SIGNATURE: sign_body(address.secret, machine.utc_ns() // NS_PER_S, body),
    }
    target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    timed_out = threading.Event()

    def abort() -> None:
        """Mark the attempt as timed out and abort it."""
        timed_out.set()
        cut()

    timer = threading.Timer(ANSWER_WITHIN_S, abort)
    timer.daemon = True
    timer.start()
    default_port = 443 if parts.scheme == "https" else 80
    connection = http.client.HTTPConnection(parts.hostname, parts.port or default_port)
    connection.auto_open = 0
    try:
        connection.sock = _connect_to_receiver(parts.scheme, connection.host, connection.port, cut)
        connection.request("POST", target, body, headers)
        response = connection.getresponse()
        return _convert_response(
            response.status, response.headers.get("Retry-After"), machine.utc_ns() / NS_PER_S
        )
    except (OSError, http.client.HTTPException, ValueError) as error:
        late = f"no answer within {ANSWER_WITHIN_S:g} s" if timed_out.is_set() else ""
        return Outcome(ok=False, description=late or _describe_error(error))
    finally:
        timer.cancel()
        cut.set_socket(None)
        connection.close()


def _connect_to_receiver(scheme: str, host: str, port: int, cut: Cut) -> socket.socket:
    """Connect within 5 s, with verified TLS if the scheme is https, and make the socket known to ``cut``.

    Raises OSError (also for TLS); the socket is then closed.
    """
    connection = socket.create_connection((host, port), timeout=CONNECT_WITHIN_S)
    try:
        connection.settimeout(READ_WITHIN_S)
        cut.set_socket(connection)
        if scheme == "https":
            tls = ssl.create_default_context()
            connection = wrapped = tls.wrap_socket(
                connection, server_hostname=host, do_handshake_on_connect=False
            )
            cut.set_socket(wrapped)
            wrapped.do_handshake()
    except BaseException:
        connection.close()
        raise
    return connection


def _convert_response(status: int, retry_after: str | None, now_s: float) -> Outcome:
    """Convert status and Retry-After header to an outcome: 2xx is delivered, 400, 413 and 422 are refused.

    ``now_s`` is the present time, s since 1970.
    """
    if 200 <= status < 300:
        return Outcome(ok=True, description=f"taken ({status})", status=status)
    description = f"the receiver answers {status} {http.client.responses.get(status, '')}".rstrip()
    if 300 <= status < 400:
        description += ": it points elsewhere, where nothing is sent; give its own address"
    return Outcome(
        ok=False,
        description=description,
        status=status,
        retry_after_s=_parse_retry_after_s(retry_after, now_s),
        refused=status in REFUSES_THE_MESSAGE,
    )


def _parse_retry_after_s(text: str | None, now_s: float) -> float:
    """Parse a ``Retry-After`` header (seconds or a date) to a pause of 0 to 3600 s; 0 if it is unreadable.

    ``now_s`` is the present time, s since 1970.
    """
    if text is None:
        return 0.0
    try:
        retry_after_s = float(text) if text.isdigit() else parsedate_to_datetime(text).timestamp() - now_s
    except (ValueError, TypeError, OverflowError):
        log.debug("a Retry-After that is neither seconds nor a date")
        return 0.0
    return min(max(0.0, retry_after_s), LONGEST_RETRY_AFTER_S)


def _describe_error(error: Exception) -> str:
    """Describe why a delivery failed, without most texts of libraries, which may repeat the address."""
    match error:
        case ssl.SSLCertVerificationError():
            return f"its certificate is refused: {error.verify_message}"
        case ssl.SSLError():
            return f"no encrypted connection: {error.reason}"
        case socket.gaierror():
            return "its host's name is not known here"
        case TimeoutError():
            return f"no answer within {CONNECT_WITHIN_S:g} s to connect and {READ_WITHIN_S:g} s to answer"
        case OSError():
            return error.strerror or "the connection broke"
        case _:
            return f"no answer of HTTP ({type(error).__name__})"
