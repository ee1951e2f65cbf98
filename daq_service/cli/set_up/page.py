"""Serve the set-up page on loopback: a live scope, and the questions of the terminal."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from fastapi import Body, FastAPI, Request
from starlette.responses import Response

from daq_service.cli.set_up.dialogue import Dialogue
from daq_service.cli.set_up.drawn import compute_envelope
from daq_service.web import assets
from daq_service.web.answers import problem
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.guards import RequestGuard
from daq_service.web.server import serve
from hardware_drivers.errors import InstrumentError
from hardware_drivers.measurement import Waveform

FAREWELL_S = 2.0
"""How long an open page is waited for at the end: it asks several times a second."""


class Scope(Protocol):
    """Source of the page's waveforms."""

    @property
    def position(self) -> str | None:
        """Return the position of the transducer that is set up now; None before the first."""
        ...

    @property
    def strikes(self) -> int:
        """Return the number of strikes so far, by which the page notices a new one."""
        ...

    def watch(self) -> tuple[str | None, Waveform | None]:
        """Return a position and its record at rest; the record is None if it needs a strike.

        Raises InstrumentError if the input cannot be read.
        """
        ...

    def newest(self) -> dict[str, object]:
        """Return the newest strike prepared for drawing by `drawn`; values None before the first."""
        ...


@contextmanager
def serve_page(dialogue: Dialogue, scope: Scope, port: int) -> Iterator[str]:
    """Serve the page on loopback while the context is open, and provide its address.

    At the end an open page has up to `FAREWELL_S` to receive the final state. Port 0 takes a free one.

    Raises
    ------
    BusyError
        Another program uses the port.
    """
    stop = threading.Event()
    bound: queue.Queue[str | Exception] = queue.Queue()
    audience = Audience()
    app = build_page_app(dialogue, scope, audience)

    def run() -> None:
        """Serve the page; queue its address, or an error of the server, for the waiting thread."""
        try:
            serve(app, "127.0.0.1", port, on_bound=bound.put, stop=stop, close_streams=lambda: None)
        except Exception as error:  # noqa: BLE001 - raised by the thread that waits for the address
            bound.put(error)

    thread = threading.Thread(target=run, name="page", daemon=True)
    thread.start()
    address = bound.get()
    if isinstance(address, Exception):
        raise address
    try:
        yield address
        audience.wait_for_page()
    finally:
        stop.set()
        thread.join()


class Audience:
    """Tracks whether a page is open, and whether it has received the final state."""

    def __init__(self) -> None:
        """Start without an open page, before the end of the set-up."""
        self.done = False
        self._last_request_s = -FAREWELL_S
        self._received_end = threading.Event()

    def note_request(self) -> None:
        """Store the time of a page's request; after the end, note that it has received the final state."""
        self._last_request_s = time.monotonic()
        if self.done:
            self._received_end.set()

    def wait_for_page(self) -> None:
        """Wait at most `FAREWELL_S` until a recently active page has received the final state."""
        self.done = True
        if time.monotonic() - self._last_request_s < FAREWELL_S:
            self._received_end.wait(FAREWELL_S)


def build_page_app(dialogue: Dialogue, scope: Scope, audience: Audience) -> FastAPI:
    """Build the web application of the set-up page, protected like the dashboard.

    Its routes are the page and its files, state, answers, records at rest, and strikes.
    """
    app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None, default_response_class=JsonAnswer)
    app.add_middleware(RequestGuard)
    problem.install_error_handlers(app)

    @app.get("/")
    async def get_page(request: Request) -> Response:
        """Return the HTML of the page, which needs no login."""
        return assets.build_asset_response("setup.html", request)

    @app.get("/static/{name:path}")
    async def get_asset(name: str, request: Request) -> Response:
        """Return a file of the page, such as a script or a style sheet; 404 if there is none."""
        return assets.build_asset_response(name, request)

    @app.get("/api/state")
    async def get_state() -> JsonAnswer:
        """Return dialogue, position, number of strikes, and whether the set-up is done; note the request."""
        state = {**dialogue.as_row(), "position": scope.position, "strikes": scope.strikes}
        answer = JsonAnswer({**state, "done": audience.done})
        audience.note_request()
        return answer

    @app.post("/api/answer")
    async def post_answer(number: int = Body(), text: str = Body(max_length=200)) -> JsonAnswer:
        """Accept the answer to a question, 200 characters at most; respond 409 if another one waits."""
        if not dialogue.answer(number, text):
            raise problem.conflict("Another question waits by now.", "Answer the one that is shown.")
        return JsonAnswer({"taken": True})

    # A POST, since it uses the boards: the guard lets no other site's page ask for it.
    @app.post("/api/record")
    def post_record() -> JsonAnswer:
        """Record the input at rest and return the envelope of the record, or the instrument's error."""
        try:
            position, record = scope.watch()
        except InstrumentError as error:
            return JsonAnswer({"position": scope.position, "error": str(error)})
        return JsonAnswer(
            {"position": position, "record": None if record is None else compute_envelope(record)}
        )

    @app.get("/api/strike")
    def get_strike() -> JsonAnswer:
        """Return the newest strike prepared for drawing."""
        return JsonAnswer(scope.newest())

    return app
