"""`/api/v1/audit`: audit log of requests, with person, address and result."""

from __future__ import annotations

import re
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from typing import Annotated, Any

from fastapi import APIRouter, Query
from pydantic import AwareDatetime, BeforeValidator

from daq_service.commands.audit import AUDIT_FILE, AuditEntry, Result, read_audit
from daq_service.commands.deadline import command_state
from daq_service.errors import SolimonError, StorageUnavailableError
from daq_service.web.answers import cursors
from daq_service.web.answers.json_answer import JsonAnswer, with_utc
from daq_service.web.answers.models import AuditPage, problems
from daq_service.web.answers.problem import invalid
from daq_service.web.auth.roles import OPERATIONS, ORDERS
from daq_service.web.context import Context, ContextOf
from daq_service.web.routes.listing import CursorText, Limit, listing_name

router = APIRouter(tags=["audit"])
DEEDS = sorted({*OPERATIONS, *ORDERS, "enter"})
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
Who = Annotated[str | None, Query(max_length=80, description="Only of this name")]
What = Annotated[str | None, Query(max_length=600, description="Only these, comma-separated: hold,release")]
WithResult = Annotated[Result | None, Query(description="Only with this result")]
RFC_3339 = re.compile(r"\d{4}-\d\d-\d\d[Tt]\d\d:\d\d:\d\d(\.\d+)?([Zz]|[+-]\d\d:\d\d)", re.ASCII)


def _written_out(text: str) -> str:
    """Return a text in RFC 3339 form; pydantic also accepts a number as seconds since 1970."""
    if not RFC_3339.fullmatch(text):
        raise ValueError("give a time with its offset, such as 2024-01-01T00:00:00Z")
    return text


Moment = Annotated[AwareDatetime, BeforeValidator(_written_out)]
FromUtc = Annotated[Moment | None, Query(description="First moment, included")]
ToUtc = Annotated[Moment | None, Query(description="Last moment, excluded")]


@router.get("/audit", operation_id="list_audit", response_model=AuditPage, responses=problems(422, 503))
def list_audit(
    context: ContextOf,
    who: Who = None,
    what: What = None,
    result: WithResult = None,
    from_utc: FromUtc = None,
    to_utc: ToUtc = None,
    cursor: CursorText = None,
    limit: Limit = 100,
) -> JsonAnswer:
    """List commands, refusals, logins and changes of tokens, the newest first.

    One answer covers a limited part of the file: with filters it may have few items, or none, and a cursor
    for earlier ones.
    """
    kinds = _kinds(what)
    first_ns, end_ns = _utc_ns(from_utc), _utc_ns(to_utc)
    _check_range(first_ns, end_ns)

    def wanted(deed: AuditEntry) -> bool:
        return (
            who in (None, deed.who)
            and (kinds is None or deed.what in kinds)
            and result in (None, deed.result)
            and (first_ns is None or deed.utc_ns >= first_ns)
            and (end_ns is None or deed.utc_ns < end_ns)
        )

    name = listing_name("audit", who=who, what=what, result=result, first=first_ns, end=end_ns)
    try:
        found, before = read_audit(
            context.data_folder, limit=limit, end=cursors.decode(name, cursor), wanted=wanted
        )
    except OSError as error:
        raise StorageUnavailableError(f"{AUDIT_FILE} cannot be read: {error.strerror}") from error
    items = [_item(context, number, deed) for number, deed in found]
    following = None if before is None else cursors.encode(name, before)
    return JsonAnswer({"next_cursor": following, "items": items})


def _kinds(what: str | None) -> frozenset[str] | None:
    kinds = None if what is None else frozenset(what.split(","))
    if kinds is not None and not kinds <= set(DEEDS):
        unknown = ", ".join(sorted(kinds - set(DEEDS)))
        raise invalid("No such deeds", f"what names {unknown[:200]!r}.", f"It takes {', '.join(DEEDS)}.")
    return kinds


def _check_range(first_ns: int | None, end_ns: int | None) -> None:
    if first_ns is not None and end_ns is not None and end_ns < first_ns:
        raise invalid(
            "No such deeds",
            "to_utc lies before from_utc.",
            "The range includes from_utc and excludes to_utc.",
        )


def _utc_ns(moment: datetime | None) -> int | None:
    """Return nanoseconds of UTC by subtraction: a conversion to UTC fails in year 1 east of Greenwich."""
    return None if moment is None else (moment - EPOCH) // timedelta(microseconds=1) * 1000


def _item(context: Context, number: int, deed: AuditEntry) -> dict[str, Any]:
    outcome = None if deed.command_id is None else _outcome(context, deed.command_id)
    return with_utc({"id": number, **asdict(deed), "outcome": outcome}, 0)


def _outcome(context: Context, command_id: int) -> str | None:
    """Return the result of a command; None where the catalogue is unavailable."""
    try:
        found = command_state(context.catalogue_access.get(), command_id)
    except SolimonError:
        return None
    return None if found is None else f"{found[0].state}: {found[0].result or ''}".rstrip(": ")
