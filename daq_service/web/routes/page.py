"""`/`: the dashboard's page. It brings the first answers along, so that its tiles wait for nothing else."""

from __future__ import annotations

import time
from asyncio import to_thread
from collections.abc import Mapping

from fastapi import APIRouter, Request
from starlette.responses import Response

from daq_service.errors import SolimonError
from daq_service.web.answers.problem import Problem
from daq_service.web.assets import MEDIA_TYPES, PAGE, assets
from daq_service.web.context import Context, context_at
from daq_service.web.routes.health import get_liveness
from daq_service.web.routes.info import get_info
from daq_service.web.routes.session import get_session
from daq_service.web.routes.transducers import list_transducers

router = APIRouter(include_in_schema=False)
ANSWERS = b'<script type="application/json" id="answers">{'
KEPT_S = 0.5
"""So long other pages get the same answers: each follows what happens behind the event that these name."""


@router.get("/")
async def get_dashboard(request: Request) -> Response:
    """Serve the page, with what whoever asks may read."""
    answers = {b"/api/v1/session": bytes((await get_session(request)).body)}
    if request.state.person is not None and _is_open(request):
        answers |= await _of_test(context_at(request))
    # As text of a script nothing may end it; in JSON the sign stands within strings only.
    told = b",".join(b'"%b":%b' % answer for answer in answers.items()).replace(b"<", rb"\u003c")
    page = assets()[PAGE].content.replace(ANSWERS, ANSWERS + told)
    return Response(page, media_type=MEDIA_TYPES[".html"])


def _is_open(request: Request) -> bool:
    """Tell that there is a test to be read: of several, one may be out of reach."""
    return hasattr(request.state, "test") or hasattr(request.app.state, "context")


async def _of_test(context: Context) -> Mapping[bytes, bytes]:
    """Give the answers of now, or of half a second ago."""
    read_s, answers = context.first_answers
    if time.monotonic() - read_s > KEPT_S:
        answers = await to_thread(_read, context)
        context.first_answers = time.monotonic(), answers
    return answers


def _read(context: Context) -> dict[bytes, bytes]:
    """Read them in this order: what changes behind the events that the first one counts is read again."""
    ways = {b"/healthz": get_liveness, b"/api/v1/info": get_info, b"/api/v1/transducers": list_transducers}
    try:
        return {path: bytes(way(context).body) for path, way in ways.items()}
    except (Problem, SolimonError, OSError):
        return {}  # the page asks, and says what is wrong
