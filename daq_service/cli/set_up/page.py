"""The page of a set-up, on loopback: a live scope, and the same questions as at the terminal."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from fastapi import Body, FastAPI, Request
from starlette.responses import Response

from daq_service.cli.set_up.dialogue import Dialogue
from daq_service.cli.set_up.drawn import envelope
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
    """What the page looks at."""

    @property
    def position(self) -> str | None:
        """Transducer that is set up now."""
        ...

    @property
    def strikes(self) -> int:
        """How many there were so far."""
        ...

    def watch(self) -> tuple[str | None, Waveform | None]:
        """Give a position and its record at rest; None where nothing can be recorded without a strike."""
        ...

    def newest(self) -> dict[str, Any]:
        """Give the newest strike as `drawn` describes it."""
        ...


@contextmanager
def served_page(dialogue: Dialogue, scope: Scope, port: int) -> Iterator[str]:
    """Serve the page and give its address; at the end an open page has heard the last word.

    Raises
    ------
    BusyError
        Somebody else has the port.
    """
    stop = threading.Event()
    bound: queue.Queue[str | Exception] = queue.Queue()
    audience = Audience()
    app = page_app(dialogue, scope, audience)

    def run() -> None:
        try:
            serve(app, "127.0.0.1", port, on_bound=bound.put, stop=stop, close_streams=lambda: None)
        except Exception as error:  # noqa: BLE001 - told by the thread that waits for the address
            bound.put(error)

    thread = threading.Thread(target=run, name="page", daemon=True)
    thread.start()
    address = bound.get()
    if isinstance(address, Exception):
        raise address
    try:
        yield address
        audience.hear_the_end()
    finally:
        stop.set()
        thread.join()


class Audience:
    """Whether a page is open, and whether it has heard that all is done."""

    def __init__(self) -> None:
        self.done = False
        self._asked_at = -FAREWELL_S
        self._heard = threading.Event()

    def asked(self) -> None:
        """Take note of a page that asks how things stand."""
        self._asked_at = time.monotonic()
        if self.done:
            self._heard.set()

    def hear_the_end(self) -> None:
        """Wait until an open page knows that nothing is asked any more."""
        self.done = True
        if time.monotonic() - self._asked_at < FAREWELL_S:
            self._heard.wait(FAREWELL_S)


def page_app(dialogue: Dialogue, scope: Scope, audience: Audience) -> FastAPI:
    """Build the page's service, guarded as the dashboard's is."""
    app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None, default_response_class=JsonAnswer)
    app.add_middleware(RequestGuard)
    problem.install(app)

    @app.get("/")
    async def get_page(request: Request) -> Response:
        return assets.answer_asset("setup.html", request)

    @app.get("/static/{name:path}")
    async def get_asset(name: str, request: Request) -> Response:
        return assets.answer_asset(name, request)

    @app.get("/api/state")
    async def get_state() -> JsonAnswer:
        state = {**dialogue.as_row(), "position": scope.position, "strikes": scope.strikes}
        answer = JsonAnswer({**state, "done": audience.done})
        audience.asked()
        return answer

    @app.post("/api/answer")
    async def post_answer(number: int = Body(), text: str = Body(max_length=200)) -> JsonAnswer:
        if not dialogue.answer(number, text):
            raise problem.conflict("Another question waits by now.", "Answer the one that is shown.")
        return JsonAnswer({"taken": True})

    # A POST, since it uses the boards: the guard lets no other site's page ask for it.
    @app.post("/api/record")
    def post_record() -> JsonAnswer:
        try:
            position, record = scope.watch()
        except InstrumentError as error:
            return JsonAnswer({"position": scope.position, "error": str(error)})
        return JsonAnswer({"position": position, "record": None if record is None else envelope(record)})

    @app.get("/api/strike")
    def get_strike() -> JsonAnswer:
        return JsonAnswer(scope.newest())

    return app
