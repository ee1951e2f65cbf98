"""Confirmation sets: their requests, budget and results. Pure, but for reading the catalogue.

A transducer requests an unscheduled set when a set first exceeds a limit. It is struck at once, assessed and
shown. It separates a lasting change from one of a single set. The diagnosis state
(`analysis.diagnosis.state`) keeps it; control chart, alarm rules and baseline never use it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from daq_service.assessment.stored_limits import collect_limits_by_name
from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import AssessmentRow, EventRow, SetRow
from daq_service.settings.tree import ScheduleSettings
from hardware_drivers.measurement import MOST_UNSCHEDULED, DueSet
from hardware_drivers.nanoseconds import NS_PER_S

BUDGET_H = 24.0
"""Hours of the test over which confirmation sets are counted."""
CONFIRMATION_ASKED = "confirmation_asked"
"""Event: a confirmation set is requested; its payload is a `Confirmation` without the position."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Confirmation:
    """Request for an unscheduled set at one position.

    Attributes
    ----------
    author
        Person who requested it; empty: solimon requested it by itself.
    """

    due: DueSet
    reason: str
    author: str = ""

    def payload(self) -> dict[str, Any]:
        """Return the payload of its event `CONFIRMATION_ASKED`: indices, due time, reason and author."""
        due = self.due
        return {
            "confirmation_set_index": due.set_index,
            "confirmation_unscheduled_index": due.unscheduled_index,
            "due_h": due.due_h,
            "due_utc_ns": due.due_utc_ns,
            "reason": self.reason,
            "author": self.author,
        }


def parse_confirmation_payload(position: str, payload: Mapping[str, Any]) -> Confirmation:
    """Convert the payload of an event `CONFIRMATION_ASKED` to a request at a position.

    Raises
    ------
    KeyError
        A value is missing.
    """
    due = DueSet(
        set_index=payload["confirmation_set_index"],
        unscheduled_index=payload["confirmation_unscheduled_index"],
        due_h=payload["due_h"],
        due_utc_ns=payload["due_utc_ns"],
        position=position,
    )
    return Confirmation(due=due, reason=payload["reason"], author=payload["author"])


def find_rejection_reason(
    position: str,
    requests: Iterable[Confirmation],
    *,
    at_h: float,
    maximum_per_day: int,
    available_ns: float,
    set_ns: int,
) -> str:
    """Return why an automatic request for a confirmation set is rejected; empty if it is accepted.

    The limit per day is checked first, then the overlap with the next scheduled set.

    Parameters
    ----------
    requests
        Earlier requests of every position; those with an author do not count.
    at_h
        Hour of the test.
    maximum_per_day
        Sets that solimon may request at this position in `BUDGET_H`.
    available_ns, set_ns
        Time until the next scheduled set, and duration of the confirmation set, ns.
    """
    n_recent = count_requests(position, requests, at_h)
    if n_recent >= maximum_per_day:
        return (
            f"{n_recent} of {maximum_per_day} confirmation sets per day are used "
            "(alarms.confirmation_sets_a_day)"
        )
    return explain_overlap(available_ns, set_ns)


def count_requests(position: str, requests: Iterable[Confirmation], at_h: float) -> int:
    """Count the automatic requests (without author) at a position in the `BUDGET_H` hours before ``at_h``."""
    recent = [request for request in requests if request.due.position == position and not request.author]
    return sum(request.due.due_h > at_h - BUDGET_H for request in recent)


def explain_overlap(available_ns: float, set_ns: int) -> str:
    """Return why a set of ``set_ns`` overlaps the next scheduled one, due in ``available_ns``; else empty."""
    if set_ns <= available_ns:
        return ""
    available_s, set_s = available_ns / NS_PER_S, set_ns / NS_PER_S
    return f"it takes up to {set_s:.0f} s, and the next scheduled set is due in {max(available_s, 0.0):.0f} s"


def compute_longest_set_ns(schedule: ScheduleSettings, restrikes: int, read_timeout_s: float) -> int:
    """Compute the maximum duration of a transducer's set, ns: all shots and restrikes, one read timeout."""
    strikes = schedule.shots_per_set + restrikes
    return round((strikes * schedule.shot_interval_s + read_timeout_s) * NS_PER_S)


def find_next_unscheduled_index(requests: Iterable[Confirmation], planned_set: int) -> int | None:
    """Return the index, from 1, of the next unscheduled set after the scheduled set ``planned_set``.

    It is one above the highest index requested there; None if that is `MOST_UNSCHEDULED`.
    """
    numbers = (
        due.unscheduled_index for due in (request.due for request in requests) if due.set_index == planned_set
    )
    number = 1 + max(numbers, default=0)
    return number if number <= MOST_UNSCHEDULED else None


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfirmationResult:
    """Result of a confirmation set, as stored in the evidence of an alarm.

    Attributes
    ----------
    confirms
        None: undetermined, for the reason ``reason``.
    distance_squared, limit
        Distance from the baseline, and the limit of sets; None: not assessed.
    """

    set_index: int
    unscheduled_index: int
    utc_ns: int
    due_h: float
    confirms: bool | None
    distance_squared: float | None = None
    limit: float | None = None
    reason: str | None = None


def summarize_confirmation(its_set: SetRow, assessment: AssessmentRow | None) -> ConfirmationResult:
    """Summarize the rows of a confirmation set for the evidence of an alarm.

    With an assessment: result, squared distance, limit and reason. Without one (no record) the result is
    undetermined, with the set's own reason.
    """
    facts: dict[str, Any] = {
        **its_set.set_key._asdict(),
        "utc_ns": its_set.due_utc_ns,
        "due_h": its_set.due_h,
        "confirms": None if assessment is None else assessment.confirms,
    }
    if assessment is None:
        return ConfirmationResult(**facts, reason=its_set.reason)
    limit = collect_limits_by_name(assessment).get(assessment.limit_name)
    return ConfirmationResult(
        **facts, distance_squared=assessment.distance_squared, limit=limit, reason=assessment.reason
    )


def read_confirmations(catalogue: Catalogue) -> list[Confirmation]:
    """Read all requests for confirmation sets from the catalogue, in the order of their events.

    Raise KeyError for an event without a value of the request, StorageError if the catalogue cannot be read.
    """
    events = catalogue.rows(EventRow, topic="service", kind=CONFIRMATION_ASKED)
    return [
        parse_confirmation_payload(event.position, event.payload)
        for event in events
        if event.position is not None
    ]


def read_newest_confirmation(catalogue: Catalogue, position: str) -> ConfirmationResult | None:
    """Read and summarize the newest confirmation set of a position; return None if it has none.

    Raise StorageError if the catalogue cannot be read.
    """
    rows = catalogue.read_last_rows(SetRow, position, 1, purpose="confirmation")
    if not rows:
        return None
    newest = rows[0]
    assessments = catalogue.rows(AssessmentRow, position=position, **newest.set_key._asdict())
    return summarize_confirmation(newest, assessments[0] if assessments else None)
