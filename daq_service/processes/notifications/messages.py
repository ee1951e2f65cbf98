"""Texts of notifications: changes of alarms, heartbeats and test messages."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Literal, TypedDict
from urllib.parse import urlencode

import orjson

from daq_service.alarms.evidence import describe_evidence
from daq_service.alarms.guidance import name_contact
from daq_service.alarms.states import PRIORITIES, RESPOND_WITHIN_H, build_alarm_texts
from daq_service.catalogue.rows import EventRow, ExperimentRow, Priority
from daq_service.clock import format_utc
from hardware_drivers.measurement import SetKey
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S

MOST_LISTED = 20
"""Alarms written out in a message; the remaining ones are counted."""
FORMAT_VERSION = 1
ChangeKind = Literal["raised", "priority raised", "active again", "returned to normal", "reset", "reminder"]
CHANGES: Mapping[str, ChangeKind] = {
    "alarm_raised": "raised",
    "alarm_priority_raised": "priority raised",
    "alarm_reactivated": "active again",
    "alarm_shelf_expired": "active again",
    "alarm_cleared": "returned to normal",
    "alarm_reset": "reset",
    "alarm_response_overdue": "reminder",
}
ENDED: Sequence[ChangeKind] = ("returned to normal", "reset")
REWORDED = {"wall_utc_ns", "changed_utc_ns", "evidence"}
"""Fields of a change that its message states in another form."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmChange:
    """Change of an alarm, read from its event.

    Attributes
    ----------
    evidence
        Most important sentence of its evidence; empty where there is none.
    """

    event_id: int
    change: ChangeKind
    wall_utc_ns: int
    alarm_id: int
    position: str | None
    kind: str
    priority: Priority
    headline: str
    message: str
    changed_utc_ns: int
    raised_h: float
    set_index: int | None
    unscheduled_index: int
    evidence: str

    @property
    def set_key(self) -> SetKey | None:
        """Return the key of the set with which the alarm was raised; None without one."""
        return None if self.set_index is None else SetKey(self.set_index, self.unscheduled_index)


def parse_alarm_change(event: EventRow) -> AlarmChange | None:
    """Convert an event to a change of an alarm.

    Returns None for other events, for suppressed or acknowledged alarms that do not end, and for events of
    old folders, which lack the alarm's row. Raises KeyError if the payload lacks another field.
    """
    change, payload = CHANGES.get(event.kind), event.payload
    # An event of a very old folder does not carry its alarm's row.
    if change is None or event.id is None or not payload.keys() >= {"priority", "state", "raised_h"}:
        return None
    if change not in ENDED and (payload["state"] != "unacknowledged" or payload.get("suppressed")):
        return None
    return AlarmChange(
        event_id=event.id,
        change=change,
        wall_utc_ns=event.wall_utc_ns,
        alarm_id=payload.get("alarm_id") or payload.get("id") or 0,
        position=event.position,
        kind=payload["kind"],
        priority=payload["priority"],
        headline=build_alarm_texts(
            payload["kind"], event.position, payload.get("evidence") or {}, payload["raised_h"]
        ).headline,
        message=payload["message"],
        changed_utc_ns=event.utc_ns,
        raised_h=payload["raised_h"],
        set_index=payload["raised_set_index"],
        unscheduled_index=payload.get("raised_unscheduled_index", 0),
        evidence=next(iter(describe_evidence(payload["kind"], payload.get("evidence") or {})), ""),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Test:
    """Test that messages are about.

    Attributes
    ----------
    mark
        Part of every key: it distinguishes two tests of the same name.
    page
        Address of the page for other computers; empty where no host name is configured.
    contacts
        Persons to ask, by responsibility.
    """

    name: str
    mark: str
    page: str = ""
    contacts: Mapping[str, str] = field(default_factory=dict)


def identify_test(row: ExperimentRow, page: str, contacts: Mapping[str, str]) -> Test:
    """Build the identity of a test for messages, with the URL ``page`` of its page and persons to ask.

    Its mark is the start (12 hexadecimal digits) of a hash of name, configuration hash and time of creation.
    """
    identity = f"{row.name}\n{row.configuration_hash}\n{row.created_utc_ns}"
    mark = hashlib.sha256(identity.encode()).hexdigest()[:12]
    return Test(name=row.name, mark=mark, page=page, contacts=contacts)


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """One message; a repeated one has the same key."""

    key: str
    kind: Literal["alarm", "heartbeat", "test"]
    title: str
    text: str
    facts: Mapping[str, object]

    def encode_body(self) -> bytes:
        """Encode the message as the JSON body of a webhook: version, key, kind, title, text and the facts."""
        header = {"version": FORMAT_VERSION, "key": self.key, "kind": self.kind}
        return orjson.dumps({**header, "title": self.title, "text": self.text, **self.facts})


def derive_key(test: Test, receiver: str, event_ids: Sequence[int]) -> str:
    """Compute the idempotency key of a message from test, receiver and one or more event ids.

    A repeated message has the same key; it shows the first id, and for more a hash of all.
    """
    first, others = event_ids[0], ",".join(map(str, event_ids))
    group_suffix = f"-{hashlib.sha256(others.encode()).hexdigest()[:8]}" if len(event_ids) > 1 else ""
    return f"{test.mark}.{receiver}.{first}{group_suffix}"


def build_alarm_message(
    test: Test, receiver: str, changes: Sequence[AlarmChange], qualities: Mapping[int, str], *, now_ns: int
) -> Message:
    """Build one message about one or more changes of alarms; the first 20 are written out, others counted.

    Parameters
    ----------
    qualities
        Quality of the set with which an alarm was raised, by event id; ``unknown`` where it is missing.
    now_ns
        Wall clock, ns of UTC, for the age of the changes.
    """
    shown = [
        _describe_alarm_change(test, item, qualities.get(item.event_id), now_ns)
        for item in changes[:MOST_LISTED]
    ]
    not_shown = changes[MOST_LISTED:]
    paragraphs = [str(item["text"]) for item in shown]
    if not_shown:
        paragraphs.append(f"And {len(not_shown)} more: {_format_counts(not_shown)}.")
    highest_priority = max((item.priority for item in changes), key=PRIORITIES.index)
    title = (
        _format_headline(changes[0])
        if len(changes) == 1
        else f"[{highest_priority.upper()}] {len(changes)} alarm changes: {_format_counts(changes)}"
    )
    return Message(
        key=derive_key(test, receiver, [item.event_id for item in changes]),
        kind="alarm",
        title=f"{title} - {test.name}",
        text="\n\n".join(paragraphs),
        facts={
            "test": test.name,
            "receiver": receiver,
            "sent_utc": format_utc(now_ns, 0),
            "priority": highest_priority,
            "counts": dict(Counter(f"{item.priority} {item.change}" for item in changes)),
            "alarms": shown,
            "not_shown": len(not_shown),
        },
    )


class HeartbeatFacts(TypedDict):
    """Status of the recorder; ages of the last set (h of the test) and of the last write (s)."""

    recorder: str
    doing: str
    last_set_age_h: float | None
    last_write_age_s: float | None


def build_heartbeat_message(test: Test, receiver: str, facts: HeartbeatFacts, *, now_ns: int) -> Message:
    """Build a heartbeat message from recorder status and ages; ``now_ns`` is UTC in ns."""
    age_h = facts["last_set_age_h"]
    last_set_text = (
        "no set is stored yet" if age_h is None else f"last set {_format_age(age_h * 3600.0)} ago (test time)"
    )
    return Message(
        key=f"{test.mark}.{receiver}.beat-{now_ns // NS_PER_S}",
        kind="heartbeat",
        title=f"Alive - {test.name}",
        text=f"Recorder {facts['recorder']} ({facts['doing']}); {last_set_text}.",
        facts={"test": test.name, "receiver": receiver, "sent_utc": format_utc(now_ns, 0), **facts},
    )


def build_test_message(test: Test, receiver: str, author: str, *, now_ns: int) -> Message:
    """Build a message that is marked as a test, with a new key for each time ``now_ns`` (UTC, ns)."""
    return Message(
        key=f"{test.mark}.{receiver}.test-{now_ns}",
        kind="test",
        title=f"TEST, no alarm - {test.name}",
        text=f"Test message to {receiver} by {author or 'an unknown person'}. No action is needed.",
        facts={"test": test.name, "receiver": receiver, "sent_utc": format_utc(now_ns, 0)},
    )


def _format_headline(item: AlarmChange) -> str:
    """Format the priority of an active alarm, or how it ended, and the headline as one line."""
    label = item.change if item.change in ENDED else item.priority
    return f"[{label.upper()}] {item.headline}"


def _format_counts(changes: Sequence[AlarmChange]) -> str:
    """Format the number of changes for each priority and kind of change, the highest priority first."""
    counts = Counter((item.priority, item.change) for item in changes)
    order = sorted(counts, key=lambda pair: -PRIORITIES.index(pair[0]))
    return ", ".join(f"{counts[pair]} {pair[0]} {pair[1]}" for pair in order)


def _describe_alarm_change(
    test: Test, item: AlarmChange, quality: str | None, now_ns: int
) -> dict[str, object]:
    """Build the entry of an alarm's change in a message: its fields, quality, UTC, age (s), link and text.

    ``now_ns`` is UTC. Without ``quality`` the text has ``unknown``. An alarm that ended is described
    without evidence and contact.
    """
    age_s = max(0.0, (now_ns - item.wall_utc_ns) / NS_PER_S)
    at_set = "" if item.set_key is None else f", set {item.set_key}, quality {quality or 'unknown'}"
    label = _format_headline(item).removesuffix(item.headline)
    lines = [
        f"{label}{item.message}",
        f"Event: {item.change}, {format_utc(item.changed_utc_ns, 0)}, stored {_format_age(age_s)} ago.",
        f"First raised at hour {item.raised_h:.1f}{at_set}.",
    ]
    if item.change not in ENDED:
        lines += [item.evidence] if item.evidence else []
        within, contact = 3600.0 * RESPOND_WITHIN_H[item.priority], name_contact(item.kind, test.contacts)
        lines.append(f"Respond within {_format_age(within)}. Contact: {contact}.")
    link = _link_to_alarm(test, item)
    return {
        **{name: value for name, value in asdict(item).items() if name not in REWORDED},
        "quality": quality,
        "changed_utc": format_utc(item.changed_utc_ns, 0),
        "age_s": age_s,
        "link": link,
        "text": " ".join([*lines, *([link] if link else [])]),
    }


def _link_to_alarm(test: Test, item: AlarmChange) -> str | None:
    """Build the URL of the page with the alarm's position and set; None if the page has no address."""
    if not test.page:
        return None
    view = {"position": item.position, "set": item.set_key}
    query = urlencode({name: value for name, value in view.items() if value is not None and item.position})
    return f"{test.page}?{query}" if query else test.page


def _format_age(seconds: float) -> str:
    """Format an age given in s: in h from 2 h, in min from 2 min, else in s."""
    for size, unit in ((NS_PER_H / NS_PER_S, "h"), (60.0, "min")):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.0f} s"
