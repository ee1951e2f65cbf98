"""The page of a set-up, on loopback: a live scope, and the same questions as at the terminal."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from fastapi import Body, FastAPI, Request
from starlette.responses import Response

from analysis.errors import AnalysisError
from analysis.waves.features import extract_features
from analysis.waves.first_settings import shot_within
from daq_service.cli.set_up.bench import Bench
from daq_service.cli.set_up.dialogue import Dialogue
from daq_service.web import assets
from daq_service.web.answers import problem
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.guards import RequestGuard
from daq_service.web.server import serve
from hardware_drivers.errors import InstrumentError
from hardware_drivers.measurement import Waveform

COLUMNS = 1000
"""Columns that a record is drawn in: each from its lowest to its highest sample."""
FAREWELL_S = 2.0
"""How long an open page is waited for at the end: it asks several times a second."""


@contextmanager
def served_page(dialogue: Dialogue, bench: Bench, port: int) -> Iterator[str]:
    """Serve the page and give its address; at the end an open page has heard the last word.

    Raises
    ------
    BusyError
        Somebody else has the port.
    """
    stop = threading.Event()
    bound: queue.Queue[str | Exception] = queue.Queue()
    audience = Audience()
    app = page_app(dialogue, bench, audience)

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


def page_app(dialogue: Dialogue, bench: Bench, audience: Audience) -> FastAPI:
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
        state = {**dialogue.as_row(), "position": bench.position, "strikes": bench.strikes}
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
            position, record = bench.watch()
        except InstrumentError as error:
            return JsonAnswer({"position": bench.position, "error": str(error)})
        return JsonAnswer({"position": position, "record": None if record is None else envelope(record)})

    @app.get("/api/strike")
    def get_strike() -> JsonAnswer:
        return JsonAnswer(newest_strike(bench))

    return app


def envelope(record: Waveform, first_s: float = 0.0) -> dict[str, Any]:
    """Lowest and highest voltage of each of `COLUMNS` stretches of a record.

    Parameters
    ----------
    first_s
        Time of the first sample.
    """
    volts = record.volts()
    columns = min(COLUMNS, volts.size)
    edges = np.linspace(0, volts.size, columns, endpoint=False).astype(np.intp)
    return {
        "first_s": first_s,
        "column_s": volts.size / columns / record.sample_rate_hz,
        "lowest_v": np.minimum.reduceat(volts, edges),
        "highest_v": np.maximum.reduceat(volts, edges),
        "range_v": record.calibration.range_v,
    }


def newest_strike(bench: Bench) -> dict[str, Any]:
    """Return the newest strike whole, and the shot in it that the proposal would have recorded."""
    position, strike = bench.position, bench.struck.get(bench.position or "")
    if position is None or strike is None:
        return {"strike": None, "shot": None}
    answer: dict[str, Any] = {"strike": envelope(strike), "shot": None, "off_s": bench.pulse_s}
    try:
        proposal = bench.proposal()
    except AnalysisError as error:
        return answer | {"error": str(error)}
    assert proposal is not None, "it was struck"
    level_v, holdoff_s = proposal.trigger_level_v, proposal.holdoff_s or 0.0
    answer |= {"level_v": level_v, "holdoff_s": holdoff_s, "proposed_range_v": proposal.range_v[position]}
    if level_v is None:
        return answer
    pretrigger = round(proposal.pretrigger_s * strike.sample_rate_hz)
    shot = shot_within(
        strike,
        after_s=bench.pulse_s + holdoff_s,
        level_v=level_v,
        rising=proposal.rising,
        pretrigger_samples=pretrigger,
        samples=bench.parameters(position).record_samples,
    )
    if shot is None:
        return answer
    features = extract_features(shot)
    sign = 1.0 if proposal.rising else -1.0
    marks = {
        "ISW": (features.isw_time_s, sign * features.isw_amplitude_v),
        "PSW": (features.psw_time_s, sign * features.psw_amplitude_v),
    }
    return answer | {
        "shot": envelope(shot, -pretrigger / shot.sample_rate_hz),
        "marks": [{"name": name, "time_s": time_s, "height_v": v} for name, (time_s, v) in marks.items()],
        "flags": features.flags,
    }
