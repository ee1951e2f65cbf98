"""Service of a data folder inside this process, without a port and without writing."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import httpx2
from anyio.from_thread import start_blocking_portal
from fastapi import FastAPI

from daq_service.catalogue import open_catalogue
from daq_service.client.connection import Connection
from daq_service.settings.stored import restore_settings
from daq_service.web.app import create_app
from daq_service.web.context import CatalogueEvents, find_app_context

POLL_S = 0.2
PAGE_EVENTS = 500
UNCOMPRESSED = {"Accept-Encoding": "identity"}


def open_folder_connection(folder: Path) -> Connection:
    """Open a connection to a data folder, read by the service's own code; the test may run or have ended.

    It starts an event loop in a thread, and reads all events by polling; `close` of the connection ends both.

    Raises
    ------
    StorageError
        The folder holds no test yet, or cannot be read.
    """
    with open_catalogue(folder) as catalogue:
        settings = restore_settings(catalogue.read_experiment().configuration)
    app = create_app(settings, folder, no_person=True)
    http = httpx2.Client(base_url="http://127.0.0.1", transport=InProcess(app), headers=UNCOMPRESSED)
    events = CatalogueEvents(find_app_context(app).catalogue_access)
    closed = threading.Event()

    def follow_events(after: int, topics: str | None) -> Iterator[dict[str, object]]:
        """Yield the stored events with ids above ``after``, of these topics, until the connection closes.

        Poll the catalogue every `POLL_S`. Topics are comma-separated, None: all. Raise StorageError if it
        cannot be read.
        """
        selected_topics = None if topics is None else set(topics.split(","))
        while not closed.is_set():
            new_events = events.after(after, PAGE_EVENTS)
            for event in new_events:
                after = event["id"]
                if selected_topics is None or event["topic"] in selected_topics:
                    yield dict(event)
            if not new_events:
                closed.wait(POLL_S)

    return Connection(http, events=follow_events, closed=closed)


class InProcess(httpx2.BaseTransport):
    """Transport of requests to an application, on a separate event loop, as a notebook already runs one."""

    def __init__(self, app: FastAPI) -> None:
        self._app = app
        self._asgi = httpx2.ASGITransport(app)
        self._portal_context = start_blocking_portal()
        self._portal = self._portal_context.__enter__()

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        """Return the application's complete response to a request.

        Block until the response is there; errors of the application are raised.
        """
        return self._portal.call(self._answer, request)

    async def _answer(self, request: httpx2.Request) -> httpx2.Response:
        """Call the application with a request and return its complete response, read into memory."""
        asgi_request = httpx2.Request(
            request.method, request.url, headers=request.headers, content=request.read()
        )
        response = await self._asgi.handle_async_request(asgi_request)
        content = await response.aread()
        return httpx2.Response(
            response.status_code, headers=response.headers, stream=httpx2.ByteStream(content)
        )

    def close(self) -> None:
        """End the event loop and its thread, then close the catalogue."""
        self._portal_context.__exit__(None, None, None)
        find_app_context(self._app).catalogue_access.close()
