"""Tables and waveforms as files: `/api/v1/tables`, `/api/v1/waveforms/{position}`."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request
from starlette.responses import Response, StreamingResponse

from daq_service.errors import UsageError
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import TableList, describe_errors, describe_files
from daq_service.web.answers.problem import Problem, invalid, not_found
from daq_service.web.context import ContextOf
from daq_service.web.routes.listing import (
    LARGEST_INDEX,
    FromHour,
    PositionFilter,
    PurposeFilter,
    ToHour,
    find_last_hour,
)
from daq_service.web.tables.choice import TABLES, Choice
from daq_service.web.tables.export import encode_table
from daq_service.web.tables.formats import FORMATS, list_available_formats
from daq_service.web.tables.record_formats import encode_records
from daq_service.web.tables.records import NoRecordError, RecordChoice, read_record_slice

router = APIRouter()
MOST_ROWS = 100_000
"""Limit of rows: some 50 MB while a file of all rows is created."""
MOST_RECORD_BYTES = 32_000_000
"""Limit of records in volts; creating their file needs some three times as much memory."""
AT_ONCE = 2
_making = threading.BoundedSemaphore(AT_ONCE)
EXPORTS = describe_files(*(kind.media_type for kind in FORMATS.values())) | describe_errors(404, 503)
"""Exported files for OpenAPI."""
Form = Annotated[
    Literal["csv", "parquet", "arrow", "npz", "mat", "h5"] | None,
    Query(alias="format", description="Absent: by the header Accept, else csv"),
]


@router.get("/tables", tags=["tables"], response_model=TableList)
def list_tables() -> JsonAnswer:
    """List the tables with their columns (form, unit), and the formats that this installation can write."""
    items = [
        {
            "table": name,
            "description": kind.description,
            "columns": [{"name": c.name, "form": c.form, "unit": c.unit} for c in kind.columns],
        }
        for name, kind in TABLES.items()
    ]
    return JsonAnswer({"formats": list_available_formats(), "items": items})


@router.get("/tables/{table}", tags=["tables"], response_class=Response, responses=EXPORTS)
def get_table(
    request: Request,
    context: ContextOf,
    table: str,
    position: PositionFilter = None,
    from_h: FromHour = None,
    to_h: ToHour = None,
    fields: Annotated[str | None, Query(max_length=1000)] = None,
    purpose: PurposeFilter = "planned",
    form: Form = None,
) -> Response:
    """Export a table or a range of it, always with hour, quality and the columns that identify rows.

    Formats that hold all rows (npz, mat, h5) are limited to 100,000 rows; two are created at a time (else
    503). An unknown table is answered with 404, an invalid selection or too many rows with 422.
    """
    if table not in TABLES:
        raise not_found(f"There is no table {table!r}.", f"The tables are {', '.join(TABLES)}.")
    if position is not None:
        context.validate_position(position)
    find_last_hour(from_h, to_h)
    name = form or choose_format(request.headers.get("accept", ""))
    catalogue, fresh = context.catalogue(), context.read_freshness()
    headers = {"Vary": "Accept"}
    try:
        choice = Choice(
            table=table, position=position, from_h=from_h, to_h=to_h, fields=fields, purpose=purpose
        )
        headers["Content-Disposition"] = f'attachment; filename="{choice.name}.{name}"'
        parts = encode_table(catalogue, fresh, choice, name, most_rows=MOST_ROWS)
        if FORMATS[name].whole:
            return Response(
                run_unless_busy(lambda: b"".join(parts)), media_type=FORMATS[name].media_type, headers=headers
            )
        first = next(parts, b"")  # errors occur before the response starts
    except UsageError as error:
        raise invalid("No such export", str(error), "/api/v1/tables lists tables and formats.") from error
    return StreamingResponse(
        itertools.chain([first], parts), media_type=FORMATS[name].media_type, headers=headers
    )


@router.get(
    "/waveforms/{position}",
    tags=["waveforms"],
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

    All must have the same length and rate, and at most 32 MB in volts (else 422); their features are in the
    table `shot_features`. Answered with 404 if none is stored; two files are created at a time (else 503).
    """
    context.validate_position(position)
    name = form or choose_format(request.headers.get("accept", ""))
    catalogue, fresh = context.catalogue(), context.read_freshness()

    def export_selected() -> bytes:
        """Read the selected waveforms, encode them as a file, and set its name in the headers."""
        choice = RecordChoice(
            position=position, from_h=from_h, to_h=to_h, first_set=first_set, last_set=last_set
        )
        headers["Content-Disposition"] = f'attachment; filename="{choice.name}.{name}"'
        records = read_record_slice(catalogue, context.archive, choice, most_bytes=MOST_RECORD_BYTES)
        return encode_records(catalogue, fresh, choice, records, name)

    # Compression of such a response would block the event loop.
    headers = {"Vary": "Accept", "Content-Encoding": "identity"}
    try:
        content = run_unless_busy(export_selected)
    except NoRecordError as error:
        raise not_found(str(error), "/api/v1/sets lists the sets, and why one is missed.") from error
    except UsageError as error:
        raise invalid(
            "No such export",
            str(error),
            "Choose fewer sets with from_h, to_h, first_set and last_set.",
        ) from error
    return Response(content, media_type=FORMATS[name].media_type, headers=headers)


def choose_format(accept: str) -> str:
    """Return the file format for an ``Accept`` header: the first known one of highest quality, else csv."""
    types = {kind.media_type: name for name, kind in FORMATS.items()}
    offers: list[tuple[float, str]] = []
    for part in accept.split(","):
        media_type, *parameters = (piece.strip().lower() for piece in part.split(";"))
        weight = next((piece[2:] for piece in parameters if piece.startswith("q=")), "1")
        if media_type in types and weight.replace(".", "", 1).isdecimal():
            offers.append((float(weight), types[media_type]))
    best = max(offers, key=lambda offer: offer[0], default=(0.0, "csv"))
    return best[1] if best[0] > 0.0 else "csv"


def run_unless_busy(make: Callable[[], bytes]) -> bytes:
    """Call ``make`` and return the bytes of its file, unless two calls run already; does not wait for them.

    Each call holds all rows in memory.

    Raises
    ------
    Problem
        503: `AT_ONCE` files are being created.
    """
    if not _making.acquire(blocking=False):
        raise Problem(
            "too-many-exports",
            f"{AT_ONCE} files that hold all their rows are being made, which is the maximum.",
        )
    try:
        return make()
    finally:
        _making.release()
