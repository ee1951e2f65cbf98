"""Alarms after ISA-18.2, their states and texts, as pure functions over rows; the caller stores the rows.

::

               condition true                    acknowledge
    normal ───────────────────► unacknowledged ──────────────► acknowledged
      ▲                             │  ▲                            │
      │                condition    │  │ condition true             │ condition false
      │                false        ▼  │                            ▼
      └──────────── returned_unacknowledged                      normal
        acknowledge

An alarm may also be suppressed: shelved for a limited time, or out of service until a person returns it. Its
state changes as usual meanwhile (`operator_actions`).

A latched alarm (a hole does not heal) returns to normal only by a person's reset.
Priority is kept at the highest reached until the alarm is acknowledged.
Delays and deadbands are in `delays`. All texts are in one table (`texts.toml`).
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from string import Formatter
from types import MappingProxyType
from typing import Any

from daq_service.catalogue.rows import AlarmClass, AlarmRow, AlarmState, EventRow, Priority
from hardware_drivers.measurement import DueSet

Evidence = Mapping[str, Any]

TEXTS: Mapping[str, Mapping[str, Any]] = tomllib.loads(
    Path(__file__).with_name("texts.toml").read_text(encoding="utf-8")
)
"""The table: kinds of alarm, diagnoses, names of features, lines of evidence."""
LONGEST_HEADLINE, LONGEST_MESSAGE = 80, 160
RESPOND_WITHIN_H: Mapping[Priority, float] = {"critical": 0.25, "high": 8.0, "medium": 24.0, "low": 168.0}
"""Time to respond to an alarm by its priority, h of real time: at once, a shift, a day, a week."""
PRIORITIES: tuple[Priority, ...] = ("low", "medium", "high", "critical")
SUPPRESSION = (
    *("suppressed", "suppressed_by", "suppressed_reason"),
    *("shelved_until_utc_ns", "shelved_until_wall_utc_ns"),
)
"""Columns of an alarm about its suppression."""
NOT_SUPPRESSED: Mapping[str, Any] = MappingProxyType(dict.fromkeys(SUPPRESSION))
RETIRING = ("no_reflection", "transducer_disabled")
"""Kinds of alarm that stop a transducer's strikes until a person enables it."""
ALARMS_OF_CHANGE = ("wall_change", "transducer_change")
"""Kinds of alarm with the result of a confirmation set in their evidence; the diagnosis selects one."""
NOT_ASSESSED = "not_assessed"
"""Kind of alarm of a baseline without limits, and status of a position that is not assessed."""
AlarmKey = tuple[str | None, str]
"""Position (None: the test) and kind of an alarm."""
_AFTER_CONDITION: Mapping[str, AlarmState] = {
    "unacknowledged": "returned_unacknowledged",
    "acknowledged": "normal",
}
"""States of an active alarm, and the state after its condition has gone."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """Condition of one possible alarm after one assessment.

    Attributes
    ----------
    times_limit
        Measured quantity divided by its limit; None if it has no limit, or no value now.
    known
        Confirmed diagnosis, if it is at least as severe as the alarm; it is reported once while the alarm is
        active.
    """

    position: str | None = None
    kind: str
    alarm_class: AlarmClass = "diagnostic"
    priority: Priority
    present: bool
    latched: bool = False
    times_limit: float | None = None
    known: str = ""
    evidence: Evidence = field(default_factory=dict)

    def build_texts(self, hour: float) -> AlarmTexts:
        """Return headline, message and action of its alarm at an hour of the test."""
        return build_alarm_texts(self.kind, self.position, self.evidence, hour)


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A row to store, and the kind of its event.

    Attributes
    ----------
    author
        Person who made the change, if the row may name another person, who acknowledged the alarm before.
    """

    row: AlarmRow
    event_kind: str
    author: str | None = None

    def event(self, moment: Moment) -> EventRow:
        """Return the event of the change: topic ``alarms``, kind, time, set, position, and author if known.

        The row is not in its payload: the commit adds it (`SetCommit.add_alarm`).
        """
        author = {} if self.author is None else {"author": self.author}
        return moment.event("alarms", self.event_kind, author, position=self.row.position)


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """Time of an assessment on the experiment's clock."""

    utc_ns: int
    due_h: float
    set_index: int | None
    unscheduled_index: int = 0

    @classmethod
    def of_set(cls, due: DueSet, utc_ns: int) -> Moment:
        """Create the moment of a set: its indices, its scheduled hour, and a time in ns of UTC."""
        return cls(
            utc_ns=utc_ns, due_h=due.due_h, set_index=due.set_index, unscheduled_index=due.unscheduled_index
        )

    def event(
        self, topic: str, kind: str, payload: Mapping[str, Any], *, position: str | None = None
    ) -> EventRow:
        """Create an event row with the time and the set of this moment; the payload is copied."""
        return EventRow(
            utc_ns=self.utc_ns,
            topic=topic,
            kind=kind,
            position=position,
            set_index=self.set_index,
            unscheduled_index=self.unscheduled_index,
            payload=dict(payload),
        )


def find_disabled(alarms: Iterable[AlarmRow]) -> dict[str, str]:
    """Return the disabled transducers by position, each with the message of the alarm that disabled it.

    Parameters
    ----------
    alarms
        Alarm rows; only `RETIRING` kinds that have not returned to normal count, the last row of a position.
    """
    return {
        row.position: row.message
        for row in alarms
        if row.position is not None and row.kind in RETIRING and row.state != "normal"
    }


def find_alarm(alarms: Mapping[AlarmKey, AlarmRow], condition: Condition) -> AlarmRow | None:
    """Return the latest alarm of a condition's fault: an active one of change of either kind is the same."""
    same = alarms.get((condition.position, condition.kind))
    if condition.kind in ALARMS_OF_CHANGE and (same is None or same.state == "normal"):
        rows = [alarms.get((condition.position, kind)) for kind in ALARMS_OF_CHANGE]
        return next((row for row in rows if row is not None and row.state != "normal"), same)
    return same


def index_alarm(alarms: dict[AlarmKey, AlarmRow], row: AlarmRow) -> None:
    """Add the newest row of an alarm by its key; remove its entry under another kind."""
    for key in [key for key, known in alarms.items() if known.id == row.id]:
        del alarms[key]
    alarms[(row.position, row.kind)] = row


def update_alarm(row: AlarmRow | None, condition: Condition, moment: Moment) -> Change | None:
    """Return the change of an alarm by the condition of one assessment; None if nothing changes.

    It is raised, becomes active again, rises in priority or diagnosis (then it is unacknowledged again and no
    longer shelved), changes from wall to transducer, or is cleared. A latched alarm is never cleared. A new
    row keeps the suppression of ``row``.

    Parameters
    ----------
    row
        The latest alarm of this fault (`find_alarm`), or None. After a return to normal the next alarm has a
        new row.
    """
    if condition.present and (row is None or row.state == "normal"):
        # Suppression applies to position and kind, so it continues for the next alarm.
        suppressed = {name: getattr(row, name) for name in SUPPRESSION} if row is not None else {}
        return Change(row=replace(_build_new_row(condition, moment), **suppressed), event_kind="alarm_raised")
    if row is None:
        return None
    if condition.present:
        if row.state == "returned_unacknowledged":
            updated = _compute_updated_columns(row, condition, moment.due_h)
            return change_state(
                row, "unacknowledged", moment, "alarm_reactivated", cleared_utc_ns=None, **updated
            )
        is_more_urgent = PRIORITIES.index(condition.priority) > PRIORITIES.index(row.priority)
        becomes_wall = condition.kind == "wall_change" != row.kind
        if is_more_urgent or becomes_wall or condition.known not in ("", row.evidence.get("known")):
            return change_state(
                row,
                "unacknowledged",
                moment,
                "alarm_priority_raised",
                **_compute_updated_columns(row, condition, moment.due_h),
                # A shelf does not cover the new priority or diagnosis, nor "out of service" another kind.
                **(NOT_SUPPRESSED if row.suppressed == "shelved" or becomes_wall else {}),
            )
        is_verified = row.evidence.get("unverified") and not condition.evidence.get("unverified")
        if is_verified or condition.kind != row.kind:
            updated = _compute_updated_columns(row, condition, moment.due_h)
            return change_state(row, row.state, moment, "alarm_evidence_added", **updated)
        return None
    state = None if condition.latched else _AFTER_CONDITION.get(row.state)
    if state is None:
        return None
    return change_state(row, state, moment, "alarm_cleared", cleared_utc_ns=moment.utc_ns)


def add_evidence(row: AlarmRow, evidence: Mapping[str, object], moment: Moment) -> Change:
    """Return the change that adds later results to the evidence of an alarm, replacing keys of the same name.

    State, priority and message do not change.
    """
    return change_state(
        row, row.state, moment, "alarm_evidence_added", evidence=row.evidence | dict(evidence)
    )


def _build_new_row(condition: Condition, moment: Moment) -> AlarmRow:
    """Return the row of a new alarm, unacknowledged and not suppressed, that a condition raises."""
    return AlarmRow(
        position=condition.position,
        kind=condition.kind,
        alarm_class=condition.alarm_class,
        priority=condition.priority,
        state="unacknowledged",
        raised_utc_ns=moment.utc_ns,
        raised_h=moment.due_h,
        raised_set_index=moment.set_index,
        raised_unscheduled_index=moment.unscheduled_index,
        changed_utc_ns=moment.utc_ns,
        message=condition.build_texts(moment.due_h).message,
        evidence=_build_evidence(condition),
    )


def _compute_updated_columns(row: AlarmRow, condition: Condition, hour: float) -> dict[str, Any]:
    """Return the updated kind, priority (never lower), message and evidence of an alarm."""
    return {
        "kind": condition.kind,
        "alarm_class": condition.alarm_class,
        "priority": max(row.priority, condition.priority, key=PRIORITIES.index),
        "message": condition.build_texts(hour).message,
        "evidence": _build_evidence(condition),
    }


def _build_evidence(condition: Condition) -> dict[str, object]:
    """Return a copy of a condition's evidence, with a confirmed diagnosis, if any, as the key ``known``."""
    return dict(condition.evidence) | ({"known": condition.known} if condition.known else {})


def change_state(row: AlarmRow, state: AlarmState, moment: Moment, event_kind: str, **changed: Any) -> Change:
    """Return the change of an alarm to a state at a moment, with new values of other columns (``changed``).

    The transition is not checked. Raise TypeError for an unknown column.
    """
    return Change(
        row=replace(row, **changed, state=state, changed_utc_ns=moment.utc_ns), event_kind=event_kind
    )


# Texts --------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmTexts:
    """Texts of an alarm: headline (at most 80 characters), message (160; the action comes last), action."""

    headline: str
    message: str
    action: str


def build_alarm_texts(kind: str, position: str | None, evidence: Evidence, hour: float) -> AlarmTexts:
    """Return the texts of an alarm from its evidence.

    A value that the evidence of an older folder lacks is shown as a dash. A message that is too long loses
    its evidence first; a headline is cut. A kind that the table lacks is named as it is.

    Parameters
    ----------
    hour
        Hour of the test when the alarm was raised.
    """
    kind_texts = TEXTS["kinds"].get(kind, {"headline": kind.replace("_", " "), "action": ""})
    texts = {**kind_texts, **kind_texts.get("variants", {}).get(_find_variant(kind, evidence), {})}
    values = {**evidence, **_derive_values(evidence), "position": position}
    headline = _shorten(fill_text(texts["headline"], values, missing="-"), LONGEST_HEADLINE)
    action = fill_text(texts["action"], values, missing="-")
    quantity = next(filter(None, (fill_text(text, values) for text in texts.get("quantity", ()))), "")
    stated = [headline, *([quantity[0].upper() + quantity[1:].rstrip(".")] if quantity else [])]
    at_hour = f" (hour {hour:.1f})."
    message = f"{'. '.join(stated)}{at_hour} {action}".rstrip()
    if len(message) > LONGEST_MESSAGE:
        room = LONGEST_MESSAGE - len(f"{headline}. {at_hour} {action}")
        # An error message still helps when it is cut; a few letters of it do not.
        stated = [headline, _shorten(stated[-1], room)] if room >= 24 else [headline]
        message = f"{'. '.join(stated)}{at_hour} {action}".rstrip()
    return AlarmTexts(headline=headline, message=message, action=action)


def describe_alarm(row: AlarmRow) -> AlarmTexts:
    """Return the texts of a stored alarm; the message is the stored one."""
    texts = build_alarm_texts(row.kind, row.position, row.evidence, row.raised_h)
    return AlarmTexts(headline=texts.headline, message=row.message, action=texts.action)


def fill_text(template: str, values: Evidence, *, missing: str = "") -> str:
    """Fill a template; return an empty text if a value is missing or None, unless ``missing`` replaces it."""
    try:
        return _Filler(missing).vformat(template, (), values)
    except KeyError:
        return ""


def format_probability(probability: float) -> str:
    """Format a probability of the diagnosis model in whole percent, rounded down: "< 1 %" to "> 99 %"."""
    if probability > 0.99:
        return "> 99 %"
    return f"{math.floor(100.0 * probability):d} %" if probability >= 0.01 else "< 1 %"


def format_number(value: float) -> str:
    """Format a number with three significant digits; from 1000 on (absolute value) as an integer."""
    return f"{value:#.3g}".rstrip(".") if abs(value) < 999.5 else f"{value:.0f}"


class _Filler(Formatter):
    """Fills templates; an unknown value raises KeyError or is replaced, and units are formats."""

    def __init__(self, missing: str) -> None:
        """Keep the text in place of an unknown value; empty: raise KeyError."""
        self._missing = missing

    def get_field(self, field_name: str, args: Sequence[object], kwargs: Mapping[str, object]) -> object:
        """Return the value of a placeholder, with its key; raise KeyError if it is missing or None."""
        name, *_ = field_name.partition("[")
        if kwargs.get(name) is None or (found := super().get_field(field_name, args, kwargs))[0] is None:
            if self._missing:
                return self._missing, field_name
            raise KeyError(field_name)
        return found

    def format_field(self, value: object, format_spec: str) -> str:
        """Format a number in the unit that the format spec names (`_UNITS`, from SI); else as Python does."""
        if isinstance(value, str):
            return value
        unit = _UNITS.get(format_spec)
        if unit is not None and isinstance(value, int | float):
            return unit(value)
        return str(super().format_field(value, format_spec))


_UNITS: Mapping[str, Callable[[float], str]] = {
    "number": format_number,
    "mm": lambda value_m: f"{format_number(1e3 * value_m)} mm",
    "us": lambda value_s: f"{1e6 * value_s:.3f} µs",
    "milli": lambda value: f"{1e3 * value:.2f}",
    "mA": lambda value_a: f"{1e3 * value_a:.2f} mA",
    "ampere": lambda value_a: f"{value_a:g}",
    "percent": format_probability,
}


def _find_variant(kind: str, evidence: Evidence) -> str:
    """Return the name of the variant of a kind's texts that the evidence asks for; it may not exist."""
    if evidence.get("stopped") or evidence.get("unverified"):
        return "stopped" if evidence.get("stopped") else "unverified"
    diagnosis = evidence.get("diagnosis") or ""
    if kind == "wall_change" and diagnosis == "undetermined":
        return "abrupt" if (evidence.get("diagnosis_details") or {}).get("abrupt", 0.0) > 0.5 else ""
    return str(diagnosis)


def _derive_values(evidence: Evidence) -> dict[str, object]:
    """Return values that templates name and that follow from the evidence; None where it lacks them."""
    damaged, aside = evidence.get("damaged") or {}, evidence.get("set_aside") or ()
    n_files = len(damaged) + len(aside)
    low_m, high_m = evidence.get("interval_m") or (None, None)
    probability = evidence.get("diagnosis_probability")
    return {
        "diagnosed": "In two consecutive sets" if evidence.get("raised_by") == "diagnosis" else None,
        "model": None if probability is None else f"model: {format_probability(probability)}",
        "low_mm": None if low_m is None else 1e3 * low_m,
        "high_mm": None if high_m is None else 1e3 * high_m,
        "n_files": n_files or None,
        "files": "file" if n_files == 1 else "files",
        "first_file": next((f"{name}: {fault}" for name, fault in damaged.items()), next(iter(aside), None)),
    }


def _shorten(text: str, most: int) -> str:
    """Return a text of at most ``most`` characters; a longer one ends with "..."."""
    return text if len(text) <= most else f"{text[: max(0, most - 3)].rstrip()}..."
