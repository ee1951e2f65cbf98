"""`/api/v1/audit`: who asked for what, from where, and what came of it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from fastapi import APIRouter

from daq_service.errors import SolimonError, StorageUnavailableError
from daq_service.orders.audit import AUDIT_FILE, Deed, read_audit
from daq_service.orders.deadline import look_at_order
from daq_service.web.answers import cursors
from daq_service.web.answers.json_answer import JsonAnswer, with_utc
from daq_service.web.answers.models import AuditPage, problems
from daq_service.web.context import Context, ContextOf
from daq_service.web.routes.listing import CursorText, Limit

router = APIRouter(tags=["audit"])


@router.get("/audit", operation_id="list_audit", response_model=AuditPage, responses=problems(422, 503))
def list_audit(context: ContextOf, cursor: CursorText = None, limit: Limit = 100) -> JsonAnswer:
    """List orders, refusals, logins and changes of tokens, the newest first."""
    try:
        found, before = read_audit(context.data_folder, limit=limit, end=cursors.decode("audit", cursor))
    except OSError as error:
        raise StorageUnavailableError(f"{AUDIT_FILE} cannot be read: {error.strerror}") from error
    items = [_item(context, number, deed) for number, deed in found]
    following = None if before is None else cursors.encode("audit", before)
    return JsonAnswer({"next_cursor": following, "items": items})


def _item(context: Context, number: int, deed: Deed) -> dict[str, Any]:
    outcome = None if deed.command_id is None else _outcome(context, deed.command_id)
    return with_utc({"id": number, **asdict(deed), "outcome": outcome}, 0)


def _outcome(context: Context, command_id: int) -> str | None:
    """Tell what the recorder made of an order; None where the catalogue cannot say."""
    try:
        found = look_at_order(context.catalogue_access.get(), command_id)
    except SolimonError:
        return None
    return None if found is None else f"{found[0].state}: {found[0].result or ''}".rstrip(": ")
