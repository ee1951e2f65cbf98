"""Channel of JSON lines between two processes of this machine, over loopback, signed with a shared key.

No call waits for the other side longer than an instant: a suspended process, or a foreign one that connects
and sends nothing, causes no delay.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import logging
import selectors
import socket
from collections.abc import Callable, Mapping
from typing import Any, Self

log = logging.getLogger(__name__)

HOST = "127.0.0.1"
CONNECT_WITHIN_S = 0.2
"""The kernel accepts connections also for a suspended process."""
LONGEST_LINE = 65_536
MOST_CONNECTIONS = 16

Message = Mapping[str, Any]


def sign_message(key: bytes, message: Message) -> bytes:
    """Encode a message as a signed line: HMAC-SHA256 in hexadecimal, a space, its JSON, a line feed.

    Raise TypeError if the message cannot be written as JSON.
    """
    body = json.dumps(message).encode()
    return hmac.new(key, body, "sha256").hexdigest().encode() + b" " + body + b"\n"


def verify_line(key: bytes, line: bytes) -> Message | None:
    """Verify the signature of a line and decode its message.

    Return None if it was not signed with this key, or its JSON is no object; raise ValueError if a signed
    text is no JSON.
    """
    signature, _, body = line.rstrip(b"\n").partition(b" ")
    if not hmac.compare_digest(signature, hmac.new(key, body, "sha256").hexdigest().encode()):
        return None
    message = json.loads(body)
    return message if isinstance(message, dict) else None


class Connection:
    """Non-blocking end of a connected socket."""

    def __init__(self, connected: socket.socket, key: bytes) -> None:
        """Take over a connected socket, make it non-blocking, and store the key that signs its messages."""
        connected.setblocking(False)
        self.socket, self._key, self._pending = connected, key, b""

    def send(self, message: Message) -> None:
        """Send a signed message to the peer without waiting.

        Raises
        ------
        OSError
            The peer has closed, or does not read so that the message does not fit (BlockingIOError); then a
            part of it may have been sent.
        """
        line = sign_message(self._key, message)
        if self.socket.send(line) != len(line):
            raise BlockingIOError("the other side does not read")

    def read_messages(self) -> list[Message]:
        """Return the complete messages received since the last call, without waiting; empty if none.

        One call reads at most `LONGEST_LINE` bytes; an incomplete line is kept for the next one.

        Raises
        ------
        OSError
            The peer has closed, has another key, or sends a line above `LONGEST_LINE`.
        ValueError
            A signed line is no JSON.
        """
        try:
            data = self.socket.recv(LONGEST_LINE)
        except BlockingIOError:
            return []
        if not data:
            raise ConnectionResetError("the other side has closed")
        *lines, self._pending = (self._pending + data).split(b"\n")
        messages = [verify_line(self._key, line) for line in lines]
        if None in messages or len(self._pending) > LONGEST_LINE:
            raise ConnectionRefusedError("the other side has another key")
        return [message for message in messages if message is not None]

    def close(self) -> None:
        """Close the connection; repeated calls have no effect."""
        self.socket.close()


def connect_to_server(port: int, key: bytes) -> Connection:
    """Connect to a server on this computer; wait at most `CONNECT_WITHIN_S`.

    The key is not checked here: a wrong one shows at the first message.

    Raises
    ------
    OSError
        No server listens there, or none accepts in time.
    """
    return Connection(socket.create_connection((HOST, port), timeout=CONNECT_WITHIN_S), key)


class Server:
    """Server for clients with the key; listens on a free ``port``."""

    def __init__(self, key: bytes) -> None:
        """Listen on a free port of the loopback interface; OSError if that fails."""
        self._key = key
        self._listener = socket.create_server((HOST, 0))
        self._listener.setblocking(False)
        self.port = int(self._listener.getsockname()[1])
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ, None)

    def __enter__(self) -> Self:
        """Return the server itself, which already listens."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close all connections and the listening socket."""
        for entry in list(self._selector.get_map().values()):
            if entry.data is not None:
                entry.data.close()
        self._selector.close()
        self._listener.close()

    def serve(self, wait_s: float, answer: Callable[[Message], Message]) -> None:
        """Wait up to ``wait_s`` seconds for connections and messages, and answer each message.

        It returns once those that arrived first are served. A connection that fails is closed, which is
        logged at debug level. Exceptions of ``answer`` pass through, except OSError and ValueError.
        """
        for event, _ in self._selector.select(wait_s):
            connection: Connection | None = event.data
            if connection is None:
                self._accept_connection()
                continue
            try:
                for message in connection.read_messages():
                    connection.send(answer(message))
            except (OSError, ValueError) as error:
                log.debug("a connection ends: %s", error)
                self._selector.unregister(connection.socket)
                connection.close()

    def _accept_connection(self) -> None:
        """Accept a pending connection; close it at once if there are `MOST_CONNECTIONS` already.

        Nothing is raised if the client has gone.
        """
        with contextlib.suppress(OSError):  # the client has already gone
            connection = Connection(self._listener.accept()[0], self._key)
            if len(self._selector.get_map()) > MOST_CONNECTIONS:
                connection.close()
                return
            self._selector.register(connection.socket, selectors.EVENT_READ, connection)
