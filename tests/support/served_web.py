"""A web service running in a thread of the test, on a free port, stopped by its event."""

from __future__ import annotations

import json
import queue
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
from fastapi import FastAPI

from daq_service.settings.tree import Settings
from daq_service.settings.web import WebSettings
from daq_service.web.app import create_app
from daq_service.web.server import serve

DEADLINE_S = 60.0
"""Far beyond what any answer takes on a loaded machine; a hanging test ends here."""


@dataclass(frozen=True, slots=True)
class Served:
    app: FastAPI
    url: str
    stop: threading.Event
    thread: threading.Thread

    @property
    def netloc(self) -> str:
        return self.url.partition("://")[2].rstrip("/")

    def connection(self, sent: bytes = b"") -> socket.socket:
        """Connect below HTTP, and send the start of a request."""
        host, _, port = self.netloc.partition(":")
        connected = socket.create_connection((host, int(port)), timeout=DEADLINE_S)
        connected.sendall(sent)
        return connected

    def client(self, **headers: str) -> httpx2.Client:
        # Nothing is encrypted: reading all certificates would take longer than most tests.
        return httpx2.Client(base_url=self.url, timeout=DEADLINE_S, headers=headers, verify=False)


def brought(page: str) -> dict[str, Any]:
    """Return answers embedded in a page of the dashboard, by path."""
    _, script_tag, rest = page.partition('<script type="application/json" id="answers">')
    assert script_tag
    answers: dict[str, Any] = json.loads(rest.partition("</script>")[0])
    return answers


@contextmanager
def served(settings: Settings, folder: Path, *, port: int = 0) -> Iterator[Served]:
    with served_app(create_app(settings, folder), port=port, locks=settings.web) as service:
        yield service


@contextmanager
def served_app(app: FastAPI, *, port: int = 0, locks: WebSettings | None = None) -> Iterator[Served]:
    stop = threading.Event()
    results: queue.Queue[str | BaseException] = queue.Queue()

    def run() -> None:
        try:
            serve(app, "127.0.0.1", port, on_bound=results.put, stop=stop, locks=locks)
        except BaseException as error:
            results.put(error)
            raise

    thread = threading.Thread(target=run, name="served-web")
    thread.start()
    url = results.get(timeout=DEADLINE_S)
    if isinstance(url, BaseException):
        thread.join()
        raise url
    try:
        yield Served(app, url, stop, thread)
    finally:
        stop.set()
        thread.join(DEADLINE_S)
        assert not thread.is_alive(), "the service did not stop"


@dataclass(frozen=True, slots=True)
class StreamEvent:
    id: int | None
    event: str
    data: object


def stream_events(response: httpx2.Response) -> Iterator[StreamEvent]:
    """Parse server-sent events as a browser does, without comments and heartbeats."""
    fields: dict[str, str] = {}
    for line in response.iter_lines():
        if line == "":
            if "data" in fields and fields.get("event") != "heartbeat":
                number = int(fields["id"]) if "id" in fields else None
                yield StreamEvent(number, fields.get("event", "message"), json.loads(fields["data"]))
            fields = {}
        elif not line.startswith(":"):
            name, _, value = line.partition(": ")
            fields[name] = value


def take(events: Iterator[StreamEvent], count: int) -> list[StreamEvent]:
    return [next(events) for _ in range(count)]
