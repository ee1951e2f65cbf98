"""`/api/v1/waveforms/{position}`: waveforms of a position over some sets as one file."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from daq_service.errors import UsageError
from daq_service.web.answers.problem import invalid, not_found
from daq_service.web.context import ContextOf
from daq_service.web.routes.listing import LARGEST_INDEX, FromHour, ToHour
from daq_service.web.routes.tables import EXPORTS, Form, accepted, alone
from daq_service.web.tables.formats import FORMATS
from daq_service.web.tables.record_formats import exported_records
from daq_service.web.tables.records import NoRecordError, RecordChoice, read_slice

router = APIRouter(tags=["waveforms"])
MOST_BYTES = 32_000_000
"""Limit in volts; creating a file needs some three times as much memory."""


@router.get(
    "/waveforms/{position}",
    response_class=Response,
    responses=EXPORTS,
)
def get_waveforms(
    request: Request,
    context: ContextOf,
    position: str,
    from_h: FromHour = None,
    to_h: ToHour = None,
    first_set: Annotated[int | None, Query(ge=0, le=LARGEST_INDEX, description="First set, included")] = None,
    last_set: Annotated[int | None, Query(ge=0, le=LARGEST_INDEX, description="Last set, included")] = None,
    form: Form = None,
) -> Response:
    """Export the accepted waveforms of a range in volts, with hour, flags and quality of each.

    All must have the same length and rate, and at most 32 MB in volts; their features are in the table
    `shot_features`.
    """
    context.checked_position(position)
    name = form or accepted(request.headers.get("accept", ""))
    catalogue, fresh = context.catalogue(), context.freshness()

    def made() -> bytes:
        choice = RecordChoice(
            position=position, from_h=from_h, to_h=to_h, first_set=first_set, last_set=last_set
        )
        headers["Content-Disposition"] = f'attachment; filename="{choice.name}.{name}"'
        records = read_slice(catalogue, context.archive, choice, most_bytes=MOST_BYTES)
        return exported_records(catalogue, fresh, choice, records, name)

    # Compression of such a response would block the event loop.
    headers = {"Vary": "Accept", "Content-Encoding": "identity"}
    try:
        content = alone(made)
    except NoRecordError as error:
        raise not_found(str(error), "/api/v1/sets lists the sets, and why one is missed.") from error
    except UsageError as error:
        raise invalid(
            "No such export",
            str(error),
            "Choose fewer sets with from_h, to_h, first_set and last_set.",
        ) from error
    return Response(content, media_type=FORMATS[name].media_type, headers=headers)
