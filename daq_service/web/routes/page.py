"""`/`: page of the dashboard, with embedded first answers, so that its tiles appear at once."""

from __future__ import annotations

import time
from asyncio import to_thread
from collections.abc import Mapping

from fastapi import APIRouter, Request
from starlette.responses import Response

from daq_service.errors import SolimonError
from daq_service.web.answers.problem import Problem
from daq_service.web.assets import MEDIA_TYPES, PAGE, load_assets
from daq_service.web.context import Context, find_request_context
from daq_service.web.routes.health import get_liveness
from daq_service.web.routes.info import get_info
from daq_service.web.routes.session import get_session
from daq_service.web.routes.transducers import list_transducers

router = APIRouter(include_in_schema=False)
ANSWERS = b'<script type="application/json" id="answers">{'
KEPT_S = 0.5
"""Time for which pages get the same answers: each then follows the later events itself."""


@router.get("/")
async def get_dashboard(request: Request) -> Response:
    """Serve the HTML page of the dashboard with the session embedded as JSON.

    For a logged-in person, the first answers (`_get_embedded_answers`) are embedded, too.
    """
    answers = {b"/api/v1/session": bytes((await get_session(request)).body)}
    has_test = hasattr(request.state, "test") or hasattr(request.app.state, "context")
    if request.state.person is not None and has_test:
        answers |= await _get_embedded_answers(find_request_context(request))
    # "<" is escaped, as it could end the script element; in JSON it occurs only within strings.
    embedded = b",".join(b'"%b":%b' % answer for answer in answers.items()).replace(b"<", rb"\u003c")
    page = load_assets()[PAGE].content.replace(ANSWERS, ANSWERS + embedded)
    return Response(page, media_type=MEDIA_TYPES[".html"])


async def _get_embedded_answers(context: Context) -> Mapping[bytes, bytes]:
    """Return the embedded answers by path, at most `KEPT_S` (0.5 s) old; read in a thread if necessary."""
    read_s, answers = context.first_answers
    if time.monotonic() - read_s > KEPT_S:
        answers = await to_thread(_read_embedded_answers, context)
        context.first_answers = time.monotonic(), answers
    return answers


def _read_embedded_answers(context: Context) -> dict[bytes, bytes]:
    """Read the embedded answers as JSON by path; empty if any of them fails.

    Info is read before the transducers, as pages follow events after its last id.
    """
    handlers = {
        b"/healthz": get_liveness,
        b"/api/v1/info": get_info,
        b"/api/v1/transducers": list_transducers,
    }
    try:
        return {path: bytes(handler(context).body) for path, handler in handlers.items()}
    except (Problem, SolimonError, OSError):
        return {}  # the page requests them itself, and shows the error
