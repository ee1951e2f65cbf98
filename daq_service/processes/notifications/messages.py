"""What is told, in an operator's words: an alarm or a storm of them, a sign of life, a trial."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal
from urllib.parse import urlencode

import orjson

from daq_service.alarms.evidence import evidence
from daq_service.alarms.guidance import GUIDANCE
from daq_service.alarms.states import SEVERITIES
from daq_service.catalogue.rows import EventRow, ExperimentRow
from daq_service.clock import format_utc
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S

MOST_LISTED = 20
"""A message spells out so many alarms and counts the rest: nobody reads more."""
FORMAT_VERSION = 1
What = Literal["raised", "worse", "back", "over"]
CHANGES: Mapping[str, What] = {
    "alarm_raised": "raised",
    "alarm_worsened": "worse",
    "alarm_returned": "back",
    "alarm_shelf_expired": "back",
    "alarm_cleared": "over",
    "alarm_reset": "over",
}
_SAID: Mapping[What, str] = {
    "raised": "has come",
    "worse": "has become worse",
    "back": "is back",
    "over": "is over",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class News:
    """A change of an alarm, as its event tells it.

    Attributes
    ----------
    evidence
        The sentence of its proof that says most; empty where it has none.
    """

    event_id: int
    what: What
    wall_utc_ns: int
    alarm_id: int
    position: str | None
    kind: str
    severity: str
    message: str
    changed_utc_ns: int
    raised_h: float
    set_index: int | None
    evidence: str


def news_of(event: EventRow) -> News | None:
    """Read an event; None where nobody is to be told: a person's own doing, or an alarm put aside."""
    what, told = CHANGES.get(event.kind), event.payload
    # An event of a very old folder does not carry its alarm's row.
    if what is None or event.id is None or not told.keys() >= {"severity", "state", "raised_h"}:
        return None
    if what != "over" and (told["state"] != "unacknowledged" or told.get("suppressed")):
        return None
    return News(
        event_id=event.id,
        what=what,
        wall_utc_ns=event.wall_utc_ns,
        alarm_id=told.get("alarm_id") or told.get("id") or 0,
        position=event.position,
        kind=told["kind"],
        severity=told["severity"],
        message=told["message"],
        changed_utc_ns=event.utc_ns,
        raised_h=told["raised_h"],
        set_index=told["raised_set_index"],
        evidence=next(iter(evidence(told["kind"], told.get("proof") or {})), ""),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Test:
    """Which test messages are about.

    Attributes
    ----------
    mark
        Part of every key: two tests of one name are two.
    page
        Address of the page for others; empty where nobody said by which name it is reached.
    """

    name: str
    mark: str
    page: str = ""


def test_of(row: ExperimentRow, page: str) -> Test:
    """Return the test that a catalogue is of."""
    own = f"{row.name}\n{row.configuration_hash}\n{row.created_utc_ns}"
    return Test(name=row.name, mark=hashlib.sha256(own.encode()).hexdigest()[:12], page=page)


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """One message; the same key is the same message, sent again."""

    key: str
    kind: Literal["alarm", "heartbeat", "test"]
    title: str
    text: str
    facts: Mapping[str, Any]

    def encoded(self) -> bytes:
        """Give the body of a webhook."""
        own = {"version": FORMAT_VERSION, "key": self.key, "kind": self.kind}
        return orjson.dumps({**own, "title": self.title, "text": self.text, **self.facts})


def key_of(test: Test, receiver: str, event_ids: Sequence[int]) -> str:
    """Name a message by test, receiver and events: what is sent again after a crash has the same key."""
    first, others = event_ids[0], ",".join(map(str, event_ids))
    of_group = f"-{hashlib.sha256(others.encode()).hexdigest()[:8]}" if len(event_ids) > 1 else ""
    return f"{test.mark}.{receiver}.{first}{of_group}"


def alarm_message(
    test: Test, receiver: str, news: Sequence[News], qualities: Mapping[int, str], *, now_ns: int
) -> Message:
    """Tell of changes of alarms.

    Parameters
    ----------
    qualities
        Quality of the set at which an alarm came, by event.
    now_ns
        Wall clock: the age of the news is told.
    """
    shown = [_item(test, item, qualities.get(item.event_id), now_ns) for item in news[:MOST_LISTED]]
    left = news[MOST_LISTED:]
    paragraphs = [item["text"] for item in shown]
    if left:
        paragraphs.append(f"And {len(left)} more: {_counted(left)}.")
    worst = max((item.severity for item in news), key=SEVERITIES.index)
    title = _title(news[0]) if len(news) == 1 else f"{len(news)} changes of alarms: {_counted(news)}"
    return Message(
        key=key_of(test, receiver, [item.event_id for item in news]),
        kind="alarm",
        title=f"{title} - {test.name}",
        text="\n\n".join(paragraphs),
        facts={
            "test": test.name,
            "receiver": receiver,
            "sent_utc": format_utc(now_ns, 0),
            "severity": worst,
            "counts": dict(Counter(f"{item.severity} {item.what}" for item in news)),
            "alarms": shown,
            "not_shown": len(left),
        },
    )


def heartbeat_message(test: Test, receiver: str, facts: Mapping[str, Any], *, now_ns: int) -> Message:
    """Tell that service and recorder live; ``facts`` as `source.Source.signs_of_life` gives them."""
    age_h = facts["last_set_age_h"]
    last = "no set is stored yet" if age_h is None else f"the last set is {_age(age_h * 3600.0)} old"
    return Message(
        key=f"{test.mark}.{receiver}.beat-{now_ns // NS_PER_S}",
        kind="heartbeat",
        title=f"Alive - {test.name}",
        text=f"The recorder is {facts['recorder']} ({facts['doing']}); {last} on the test's clock.",
        facts={"test": test.name, "receiver": receiver, "sent_utc": format_utc(now_ns, 0), **facts},
    )


def trial_message(test: Test, receiver: str, author: str, *, now_ns: int) -> Message:
    """Return a message that says of itself that it is a trial."""
    return Message(
        key=f"{test.mark}.{receiver}.test-{now_ns}",
        kind="test",
        title=f"TEST, no alarm - {test.name}",
        text=f"{author or 'Somebody'} tries whether {receiver} is reached. Nothing is wrong, nothing to do.",
        facts={"test": test.name, "receiver": receiver, "sent_utc": format_utc(now_ns, 0)},
    )


def _title(item: News) -> str:
    return f"{item.severity.upper()} {item.kind}{_place(item)} {_SAID[item.what]}"


def _place(item: News) -> str:
    return f" at {item.position}" if item.position else ""


def _counted(news: Sequence[News]) -> str:
    counts = Counter((item.severity, item.what) for item in news)
    order = sorted(counts, key=lambda pair: -SEVERITIES.index(pair[0]))
    return ", ".join(f"{counts[pair]} {pair[0]} {pair[1]}" for pair in order)


def _item(test: Test, item: News, quality: str | None, now_ns: int) -> dict[str, Any]:
    age_s = max(0.0, (now_ns - item.wall_utc_ns) / NS_PER_S)
    at_set = "" if item.set_index is None else f", set {item.set_index}, quality {quality or 'unknown'}"
    sentences = [
        f"{_title(item)}: {item.message.rstrip('.')}.",
        f"First raised at hour {item.raised_h:.2f} of the test{at_set}.",
        f"This change is of {format_utc(item.changed_utc_ns, 0)} and was stored {_age(age_s)} ago.",
    ]
    if item.what != "over":
        sentences += [item.evidence] if item.evidence else []
        guidance = GUIDANCE.get(item.kind)
        sentences.append(f"Look first: {guidance.short if guidance else 'see the alarm and its proof.'}")
    link = _link(test, item)
    return {
        "event_id": item.event_id,
        "alarm_id": item.alarm_id,
        "change": item.what,
        "position": item.position,
        "kind": item.kind,
        "severity": item.severity,
        "message": item.message,
        "set_index": item.set_index,
        "quality": quality,
        "raised_h": item.raised_h,
        "changed_utc": format_utc(item.changed_utc_ns, 0),
        "age_s": age_s,
        "link": link,
        "text": " ".join([*sentences, *([link] if link else [])]),
    }


def _link(test: Test, item: News) -> str | None:
    if not test.page:
        return None
    view = {"position": item.position, "set": item.set_index}
    query = urlencode({name: value for name, value in view.items() if value is not None and item.position})
    return f"{test.page}?{query}" if query else test.page


def _age(seconds: float) -> str:
    for size, unit in ((NS_PER_H / NS_PER_S, "h"), (60.0, "min")):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.0f} s"
