"""`/api/v1/audit`: audit log of requests, with person, address and result."""

from __future__ import annotations

import re
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import AwareDatetime, BeforeValidator

from daq_service.commands.audit import AUDIT_FILE, AuditEntry, Result, read_audit_log
from daq_service.commands.deadline import read_command_state
from daq_service.errors import SolimonError, StorageUnavailableError
from daq_service.web.answers import cursors
from daq_service.web.answers.json_answer import JsonAnswer, add_utc
from daq_service.web.answers.models import AuditPage, describe_errors
from daq_service.web.answers.problem import invalid
from daq_service.web.auth.roles import OPERATIONS, ORDERS
from daq_service.web.context import Context, ContextOf
from daq_service.web.routes.listing import CursorText, Limit, build_listing_name

router = APIRouter(tags=["audit"])
AUDITED_OPERATIONS = sorted({*OPERATIONS, *ORDERS, "enter"})
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
Author = Annotated[str | None, Query(max_length=80, description="Only of this name")]
What = Annotated[str | None, Query(max_length=600, description="Only these, comma-separated: pause,resume")]
WithResult = Annotated[Result | None, Query(description="Only with this result")]
RFC_3339 = re.compile(r"\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d(\.\d+)?([Zz]|[+-]\d\d:\d\d)", re.ASCII)


def _validate_rfc3339_text(text: str) -> str:
    """Return the text if it has the form of RFC 3339 with an offset; raise ValueError otherwise.

    Pydantic would also accept seconds since 1970.
    """
    if not RFC_3339.fullmatch(text):
        raise ValueError("give a time with its offset, such as 2024-01-01T00:00:00Z")
    return text


Moment = Annotated[AwareDatetime, BeforeValidator(_validate_rfc3339_text)]
FromUtc = Annotated[Moment | None, Query(description="First moment, included")]
ToUtc = Annotated[Moment | None, Query(description="Last moment, excluded")]


@router.get("/audit", response_model=AuditPage, responses=describe_errors(503))
def list_audit(
    context: ContextOf,
    author: Author = None,
    what: What = None,
    result: WithResult = None,
    from_utc: FromUtc = None,
    to_utc: ToUtc = None,
    cursor: CursorText = None,
    limit: Limit = 100,
) -> JsonAnswer:
    """List commands, rejections, logins and changes of tokens, the newest first.

    One answer covers a limited part of the file: with filters it may have few items, or none, and a cursor
    for earlier ones. An unknown operation or a reversed range is answered with 422.
    """
    kinds = _parse_operations(what)
    first_ns, end_ns = _convert_to_utc_ns(from_utc), _convert_to_utc_ns(to_utc)
    _check_time_range(first_ns, end_ns)

    def is_selected(entry: AuditEntry) -> bool:
        """Return whether an audit entry passes all filters of the request."""
        return (
            author in (None, entry.author)
            and (kinds is None or entry.what in kinds)
            and result in (None, entry.result)
            and (first_ns is None or entry.utc_ns >= first_ns)
            and (end_ns is None or entry.utc_ns < end_ns)
        )

    listing = build_listing_name("audit", author=author, what=what, result=result, first=first_ns, end=end_ns)
    try:
        entries, previous_end = read_audit_log(
            context.data_folder, limit=limit, end=cursors.decode_cursor(listing, cursor), wanted=is_selected
        )
    except OSError as error:
        raise StorageUnavailableError(f"{AUDIT_FILE} cannot be read: {error.strerror}") from error
    items = [_build_audit_item(context, number, entry) for number, entry in entries]
    next_cursor = None if previous_end is None else cursors.encode_cursor(listing, previous_end)
    return JsonAnswer({"next_cursor": next_cursor, "items": items})


def _parse_operations(what: str | None) -> frozenset[str] | None:
    """Parse comma-separated operations; None selects all.

    Raises a Problem (422) that names the unknown ones.
    """
    kinds = None if what is None else frozenset(what.split(","))
    if kinds is not None and not kinds <= set(AUDITED_OPERATIONS):
        unknown = ", ".join(sorted(kinds - set(AUDITED_OPERATIONS)))
        raise invalid(
            "No such operations",
            f"what names {unknown[:200]!r}.",
            f"It takes {', '.join(AUDITED_OPERATIONS)}.",
        )
    return kinds


def _check_time_range(first_ns: int | None, end_ns: int | None) -> None:
    """Raise a Problem (422) if the range ends before it starts; an open or empty range is valid."""
    if first_ns is not None and end_ns is not None and end_ns < first_ns:
        raise invalid(
            "Invalid range",
            "to_utc lies before from_utc.",
            "The range includes from_utc and excludes to_utc.",
        )


def _convert_to_utc_ns(moment: datetime | None) -> int | None:
    """Convert a time to nanoseconds since 1970 (UTC), to the microsecond; None stays None.

    By subtraction, since conversion to UTC fails in year 1.
    """
    return None if moment is None else (moment - EPOCH) // timedelta(microseconds=1) * 1000


def _build_audit_item(context: Context, number: int, entry: AuditEntry) -> dict[str, object]:
    """Convert an audit entry for an answer, with number (``id``), RFC 3339 time and result of its command."""
    outcome = None if entry.command_id is None else _read_outcome(context, entry.command_id)
    return add_utc({"id": number, **asdict(entry), "outcome": outcome}, 0)


def _read_outcome(context: Context, command_id: int) -> str | None:
    """Return ``STATE: RESULT`` of a command; None if it is unknown or the catalogue cannot be read."""
    try:
        command = read_command_state(context.catalogue_access.get(), command_id)
    except SolimonError:
        return None
    return None if command is None else f"{command[0].state}: {command[0].result or ''}".rstrip(": ")
