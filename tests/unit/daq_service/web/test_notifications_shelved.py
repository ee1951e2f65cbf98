"""A shelved or out-of-service alarm is not sent; it is sent after its shelf has expired."""

from dataclasses import replace

import pytest
from support.invented_rows import alarm_row

from daq_service.catalogue.rows import EventRow
from daq_service.catalogue.writer import build_event_payload
from daq_service.processes.notifications.messages import parse_alarm_change

ROW = alarm_row(id=3)


@pytest.mark.parametrize(
    ("kind", "suppressed", "what"),
    [
        ("alarm_raised", None, "raised"),
        ("alarm_raised", "shelved", None),
        ("alarm_reactivated", "out_of_service", None),
        ("alarm_shelf_expired", None, "active again"),
        ("alarm_cleared", "shelved", "returned to normal"),
        ("alarm_shelved", "shelved", None),
        ("alarm_response_overdue", None, "reminder"),
    ],
)
def test_a_suppressed_alarm_is_not_sent(kind: str, suppressed: str | None, what: str | None) -> None:
    row = replace(ROW, suppressed=suppressed)
    event = EventRow(
        id=7, utc_ns=0, topic="alarms", kind=kind, position="B", payload=build_event_payload(row)
    )
    notification = parse_alarm_change(event)
    assert (notification.change if notification else None) == what
