"""`/api/v1/report`: report of the test or some hours as one HTML page."""

from __future__ import annotations

import threading

from fastapi import APIRouter
from starlette.responses import Response

from daq_service.errors import UsageError
from daq_service.processes.installation import MissingExtraError
from daq_service.processes.worker import start_one_worker
from daq_service.web.answers.models import describe_errors
from daq_service.web.answers.problem import Problem, invalid
from daq_service.web.context import ContextOf
from daq_service.web.report.make import build_report_page
from daq_service.web.routes.admission import PersonOf
from daq_service.web.routes.listing import FromHour, ToHour, find_last_hour

router = APIRouter(tags=["report"])
_making = threading.Lock()


@router.get(
    "/report",
    response_class=Response,
    responses={
        200: {"content": {"text/html": {"schema": {"type": "string"}}}},
        **describe_errors(501, 503),
    },
)
def get_report(
    context: ContextOf, person: PersonOf, from_h: FromHour = None, to_h: ToHour = None
) -> Response:
    """Return a report: identity, present state, trends, gaps, alarms, annotations and commands.

    It contains the audit log for persons who may read it. One report is created at a time, in a separate
    process; a second request is answered with 503. An empty range, or one with too many sets: 422.
    Without the extra ``report``: 501.
    """
    find_last_hour(from_h, to_h)
    context.catalogue()
    if not _making.acquire(blocking=False):
        raise Problem("too-many-reports", "One report is made at a time.")
    try:
        with start_one_worker() as worker:
            audited = person.may("admin")
            content = worker.submit(
                build_report_page, context.data_folder, from_h=from_h, to_h=to_h, audited=audited
            ).result()
    except MissingExtraError as error:
        raise Problem("missing-extra", f"Reports need figures; {error}.") from error
    except UsageError as error:
        raise invalid("No such report", str(error), "Choose other hours with from_h and to_h.") from error
    finally:
        _making.release()
    headers = {
        # The name of a test may contain characters that are not allowed in a header.
        "Content-Disposition": 'attachment; filename="report.html"',
        # Compression would block the event loop.
        "Content-Encoding": "identity",
    }
    return Response(content, media_type="text/html", headers=headers)
