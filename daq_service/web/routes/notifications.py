"""`/api/v1/notifications`: receivers, delivery log, and test messages."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import Annotated

from fastapi import APIRouter, Path, Request

from daq_service.errors import BusyError, StorageUnavailableError
from daq_service.processes.notifications.addresses import hide_address_secrets
from daq_service.processes.notifications.delivery_log import LOG_FILE
from daq_service.processes.notifications.receiver import ReceiverQueue, State, is_receiver_dead
from daq_service.settings.notifications import ReceiverSettings
from daq_service.web.answers import cursors
from daq_service.web.answers.json_answer import JsonAnswer, add_utc
from daq_service.web.answers.models import DeliveryPage, NotificationsState, TrialResult, describe_errors
from daq_service.web.answers.problem import conflict, not_found
from daq_service.web.context import Context, ContextOf
from daq_service.web.routes.admission import PersonOf, write_audit_entry
from daq_service.web.routes.listing import CursorText, Limit
from hardware_drivers.nanoseconds import NS_PER_S

router = APIRouter(tags=["notifications"])


@router.get("/notifications", response_model=NotificationsState)
def get_notifications(context: ContextOf) -> JsonAnswer:
    """Return the receivers without secrets: last delivery, failures, waiting changes, next heartbeat.

    Counts are since the start of the service. While another process sends, the reason is stated.
    """
    service = context.notifications
    receivers = [_build_receiver_state(context, queue) for queue in service.queues.values()]
    return JsonAnswer(
        {
            "sending": not service.silent_reason,
            "not_sending_reason": service.silent_reason,
            "receivers": receivers,
        }
    )


@router.get("/notifications/log", response_model=DeliveryPage, responses=describe_errors(503))
def list_deliveries(context: ContextOf, cursor: CursorText = None, limit: Limit = 100) -> JsonAnswer:
    """List the delivery log (sent, failed and given-up messages), the newest first, in pages."""
    end = cursors.decode_cursor("deliveries", cursor)
    try:
        lines, previous_end = context.notifications.deliveries.read(limit=limit, end=end)
    except OSError as error:
        raise StorageUnavailableError(f"{LOG_FILE} cannot be read: {error.strerror}") from error
    items = []
    for number, delivery in lines:
        row = {"id": number, **asdict(delivery)}
        del row["place"]
        items.append(add_utc(row, 0))
    next_cursor = None if previous_end is None else cursors.encode_cursor("deliveries", previous_end)
    return JsonAnswer({"next_cursor": next_cursor, "items": items})


@router.post(
    "/notifications/{receiver}/test",
    response_model=TrialResult,
    responses=describe_errors(403, 404, 409, 413),
)
def test_receiver(
    receiver: Annotated[str, Path(max_length=32)], request: Request, person: PersonOf, context: ContextOf
) -> JsonAnswer:
    """Send one test message at once, and return its result and duration; the attempt is audited.

    Answered with 404 for an unknown receiver, and with 409 while another test message is sent.
    """
    queue = context.notifications.queues.get(receiver)
    if queue is None:
        names = ", ".join(context.notifications.queues) or "none"
        raise not_found(f"There is no receiver {receiver!r}.", f"The receivers are: {names}.")
    started_s = time.monotonic()
    try:
        outcome = queue.test(person.name)
    except BusyError as error:
        raise conflict(f"{error}.", "Ask again in some seconds.") from None
    reason, arguments = "" if outcome.ok else outcome.description, {"receiver": receiver}
    write_audit_entry(
        request, person, "test_receiver", "done" if outcome.ok else "failed", reason, arguments=arguments
    )
    return JsonAnswer(
        {
            "receiver": receiver,
            "ok": outcome.ok,
            "status": outcome.status,
            "result": outcome.description,
            "took_s": time.monotonic() - started_s,
        }
    )


def _build_receiver_state(context: Context, queue: ReceiverQueue) -> dict[str, object]:
    """Build the state of a receiver for an answer: settings, rules, deliveries and heartbeat.

    Its address is without secrets; rules are counted from 1; times are RFC 3339, and the age of the last sent
    message is in s.
    """
    notifications, state, now_ns = context.notifications.settings, queue.state, time.time_ns()
    settings, rules = notifications.receivers[queue.name], enumerate(notifications.rules, start=1)
    sent_ns = state.last_sent_utc_ns
    return add_utc(
        {
            "name": queue.name,
            "kind": settings.kind,
            "address": hide_address_secrets(settings),
            "rules": [number for number, rule in rules if not rule.receivers or queue.name in rule.receivers],
            "state": _name_delivery_state(state, now_ns),
            **{name: value for name, value in asdict(state).items() if "heartbeat" not in name},
            "last_sent_age_s": None if sent_ns is None else max(0.0, (now_ns - sent_ns) / NS_PER_S),
            "heartbeat": _build_heartbeat_state(settings, state),
        },
        0,
    )


def _name_delivery_state(state: State, now_ns: int) -> str:
    """Return the state of deliveries at UTC ``now_ns``: ``failing`` or ``dead`` (for over 600 s).

    Without a failure since the last success: ``waiting`` if there are changes, else ``idle``.
    """
    if state.failing_since_utc_ns is not None:
        return "dead" if is_receiver_dead(state, now_ns) else "failing"
    return "waiting" if state.waiting else "idle"


def _build_heartbeat_state(settings: ReceiverSettings, state: State) -> dict[str, object] | None:
    """Build the state of a receiver's heartbeat messages for an answer; None if it gets none."""
    if settings.heartbeat_s is None:
        return None
    return add_utc(
        {
            "every_s": settings.heartbeat_s,
            "state": state.heartbeat,
            "result": state.heartbeat_result,
            "last_utc_ns": state.last_heartbeat_utc_ns,
            "next_utc_ns": state.next_heartbeat_utc_ns,
        },
        0,
    )
