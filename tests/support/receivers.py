"""Receivers of notifications on this machine: HTTP servers that answer, stall or refuse on request."""

from __future__ import annotations

import json
import queue
import ssl
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from support.waiting import WAIT_S, MachineTooSlowError

POLL_S = 0.01


@dataclass(frozen=True, slots=True)
class Got:
    """Request with its bytes as received."""

    headers: Mapping[str, str]
    body: bytes
    path: str = ""

    @property
    def message(self) -> Any:
        return json.loads(self.body)


@dataclass
class HttpReceiver:
    """Receiver that sends the queued `answers` (status, headers), then 204; `silent` sends none."""

    url: str
    got: queue.Queue[Got] = field(default_factory=queue.Queue)
    answers: queue.Queue[tuple[int, dict[str, str]]] = field(default_factory=queue.Queue)
    silent: threading.Event = field(default_factory=threading.Event)
    ended: threading.Event = field(default_factory=threading.Event)

    def next(self) -> Got:
        try:
            return self.got.get(timeout=WAIT_S)
        except queue.Empty:
            raise MachineTooSlowError("a notification") from None


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    # Threads of the test that are cut off in the middle of an answer say nothing.
    def handle_error(self, request: Any, client_address: Any) -> None:
        pass


@contextmanager
def http_receiver(*, tls: Path | None = None) -> Iterator[HttpReceiver]:
    """Run a receiver until the block ends; `tls`: folder of `certificate.pem` and `key.pem`."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            receiver.got.put(Got(dict(self.headers), body, self.path))
            if receiver.silent.is_set():
                receiver.ended.wait(WAIT_S)
                return
            try:
                status, headers = receiver.answers.get_nowait()
            except queue.Empty:
                status, headers = 204, {}
            self.send_response(status)
            for name, value in headers.items():
                self.send_header(name, value)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002 - the library's name
            pass

    server = _Server(("127.0.0.1", 0), Handler)
    if tls is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(tls / "certificate.pem", tls / "key.pem")
        server.socket = context.wrap_socket(server.socket, server_side=True)
    receiver = HttpReceiver(f"http{'s' if tls else ''}://127.0.0.1:{server.server_address[1]}/hook")
    thread = threading.Thread(target=server.serve_forever, args=(POLL_S,), name="receiver")
    thread.start()
    try:
        yield receiver
    finally:
        receiver.ended.set()
        server.shutdown()
        thread.join()
        server.server_close()
