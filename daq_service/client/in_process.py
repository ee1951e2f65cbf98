"""The service of a data folder inside this process: nobody listens on a port, and nothing is written."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
from anyio.from_thread import start_blocking_portal

from daq_service.catalogue import open_catalogue
from daq_service.client.connection import Connection
from daq_service.settings.stored import stored_settings
from daq_service.web.app import create_app
from daq_service.web.context import CatalogueEvents, context_of

POLL_S = 0.2
PAGE_EVENTS = 500
UNCOMPRESSED = {"Accept-Encoding": "identity"}


def folder_connection(folder: Path) -> Connection:
    """Read a folder by the service's own code; the test may run or have ended.

    Raises
    ------
    StorageError
        The folder holds no test yet, or cannot be read.
    """
    with open_catalogue(folder) as catalogue:
        settings = stored_settings(catalogue.experiment_row().configuration)
    app = create_app(settings, folder, no_person=True)
    http = httpx.Client(base_url="http://127.0.0.1", transport=InProcess(app), headers=UNCOMPRESSED)
    events = CatalogueEvents(context_of(app).catalogue_access)
    closed = threading.Event()

    def followed(after: int, topics: str | None) -> Iterator[dict[str, Any]]:
        chosen = None if topics is None else set(topics.split(","))
        while not closed.is_set():
            found = events.after(after, PAGE_EVENTS)
            for event in found:
                after = event["id"]
                if chosen is None or event["topic"] in chosen:
                    yield dict(event)
            if not found:
                closed.wait(POLL_S)

    return Connection(http, events=followed, closed=closed)


class InProcess(httpx.BaseTransport):
    """Hands requests to an application, on an event loop of its own: a notebook has one already."""

    def __init__(self, app: Any) -> None:
        self._app = app
        self._asgi = httpx.ASGITransport(app)
        self._opening = start_blocking_portal()
        self._portal = self._opening.__enter__()

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        """Answer one request as a whole."""
        return self._portal.call(self._answer, request)

    async def _answer(self, request: httpx.Request) -> httpx.Response:
        asked = httpx.Request(request.method, request.url, headers=request.headers, content=request.read())
        response = await self._asgi.handle_async_request(asked)
        content = await response.aread()
        return httpx.Response(
            response.status_code, headers=response.headers, stream=httpx.ByteStream(content)
        )

    def close(self) -> None:
        """End the loop, and let go of the catalogue."""
        self._opening.__exit__(None, None, None)
        context_of(self._app).catalogue_access.close()
