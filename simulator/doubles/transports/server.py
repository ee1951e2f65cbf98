"""Server side of the wire: one thread per connection, one client per process."""

from __future__ import annotations

import logging
import socket
import socketserver
import struct
import threading

from simulator.doubles.device_model import Brain
from simulator.doubles.vendor_api import statuses, wire
from simulator.doubles.vendor_api.statuses import Status

log = logging.getLogger(__name__)


class LoopbackServer(socketserver.ThreadingTCPServer):
    """Server for callers of a device model on the loopback interface, one thread per connection."""

    daemon_threads = True

    def __init__(self, brain: Brain, connection: type[socketserver.BaseRequestHandler]) -> None:
        super().__init__(("127.0.0.1", 0), connection)
        self.brain = brain

    @property
    def address(self) -> str:
        """Return the address of the server, ``host:port``."""
        host, port = self.server_address[:2]
        return f"{host!s}:{port}"


class WireServer(LoopbackServer):
    """Server for the C libraries on the loopback interface."""

    def __init__(self, brain: Brain) -> None:
        super().__init__(brain, _Connection)
        self._clients: dict[int, str] = {}
        self._lock = threading.Lock()

    def join(self, number: int, process: int) -> tuple[int, str]:
        """Return number and name of a process's client; register a new one for 0 or an unknown number."""
        with self._lock:
            if number not in self._clients:
                number = max(self._clients, default=0) + 1
                self._clients[number] = self.brain.open_client("library", f"pid {process}")
            return number, self._clients[number]

    def leave(self, number: int) -> None:
        """Remove a client by its number and clear its tasks; do nothing if the number is unknown."""
        with self._lock:
            client = self._clients.pop(number, None)
        if client is not None:
            self.brain.close_client(client)


class _Connection(socketserver.BaseRequestHandler):
    """Connection of one thread of a client process."""

    server: WireServer

    def handle(self) -> None:
        """Register the client of a library's connection and answer its calls until the peer closes.

        The client is removed with the first connection of its process. An invalid frame ends the connection,
        with a logged warning.
        """
        connection: socket.socket = self.request
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            hello = wire.receive_frame(connection)
            if hello is None or len(hello) != wire.HELLO.size:
                return
            process, requested_number = wire.HELLO.unpack(hello)
            number, client = self.server.join(requested_number, process)
            connection.sendall(struct.pack("<Q", number))
            try:
                self._answer_calls(connection, client)
            finally:
                if requested_number != number:
                    # The process's first connection lives as long as the process.
                    self.server.leave(number)
        except (ConnectionError, wire.WireError) as error:
            log.warning("connection of %s ends: %s", self.client_address, error)

    def _answer_calls(self, connection: socket.socket, client: str) -> None:
        """Answer the calls of a client's connection, one after the other, until the peer closes it.

        An unexpected error of the double is logged and answered as a status. Raise WireError for an invalid
        frame, ConnectionError for a broken connection.
        """
        while (body := wire.receive_frame(connection)) is not None:
            entry, arguments = wire.decode_call(body)
            status, text, values = 0, "", {}
            try:
                values = self.server.brain.call(client, entry.name, arguments)
            except Status as answer:
                status, text, values = answer.code, answer.message, answer.values
            except Exception as error:
                # A fault of the double must not look like a board's: it names itself.
                log.exception("%s failed inside the double", entry.name)
                status, text = statuses.SOFTWARE_FAULT, f"{entry.name} failed inside the double: {error!r}"
            wire.send_frame(connection, wire.encode_answer(entry, arguments, status, text, values))
