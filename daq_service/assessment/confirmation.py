"""Suspicion, and the confirmation set that answers it: pure rules.

A transducer requests an unscheduled set when a set first exceeds a limit. It is struck at once, assessed and
shown. It separates a lasting change from one of a single set. The diagnosis state
(`analysis.diagnosis.state`) keeps it; control chart, alarm rules and baseline never use it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.statistics.baseline import Baseline
from analysis.statistics.distance import distance_squared
from daq_service.acquisition.schedule import DueSet
from daq_service.assessment.solitary_wave_step import AssessedSet, Rules, SetAssessment, State, alarms
from daq_service.assessment.stored_limits import limits_by_name
from daq_service.catalogue import Catalogue
from daq_service.catalogue.rows import AssessmentRow, EventRow, SetRow
from daq_service.settings.tree import ScheduleSettings
from hardware_drivers.measurement import MOST_EXTRA, in_order
from hardware_drivers.nanoseconds import NS_PER_S

ALARM = "the change of the wall became an alarm with it"
STEP = "it is the first set beyond the limit"
BUDGET_H = 24.0
"""Hours of the test over which confirmation sets are counted."""
CONFIRMATION_ASKED = "confirmation_asked"
"""Event: a confirmation set is asked for; its payload is a `Confirmation` without the position."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Confirmation:
    """A set beside the plan that somebody asks for.

    Attributes
    ----------
    author
        Who ordered it; empty: suspicion did.
    """

    due: DueSet
    because: str
    author: str = ""

    def payload(self) -> dict[str, Any]:
        """Give what its event tells beside the position."""
        due = self.due
        return {
            "confirmation_set_index": due.set_index,
            "due_h": due.due_h,
            "due_utc_ns": due.due_utc_ns,
            "because": self.because,
            "author": self.author,
        }


def asked_by(position: str, payload: Mapping[str, Any]) -> Confirmation:
    """Read what the event `CONFIRMATION_ASKED` of a position tells."""
    due = DueSet(
        set_index=payload["confirmation_set_index"],
        due_h=payload["due_h"],
        due_utc_ns=payload["due_utc_ns"],
        position=position,
    )
    return Confirmation(due=due, because=payload["because"], author=payload["author"])


def suspicion(before: State, after: State, assessment: SetAssessment, rules: Rules) -> str:
    """Say why a planned set asks for a confirmation; empty: it does not.

    Asked once when an outlier comes after `alarms.n` sets without one, and once when the alarm of the wall
    comes. Both come again only when that was over, which is their hysteresis.
    """
    if assessment.in_baseline or assessment.outlier is None:
        return ""
    if alarms(after, rules) and not alarms(before, rules):
        return ALARM
    return STEP if assessment.outlier and not any(before.alarm.recent) else ""


def why_not(
    position: str, asked: Iterable[Confirmation], *, at_h: float, most_a_day: int, room_ns: float, set_ns: int
) -> str:
    """Say why suspicion gets no confirmation set; empty: it gets one.

    Parameters
    ----------
    asked
        Those of every position so far.
    at_h
        Hour of the test.
    room_ns, set_ns
        Time until the next planned set, and how long the set takes.
    """
    n_recent = n_today(position, asked, at_h)
    if n_recent >= most_a_day:
        return f"{n_recent} of {most_a_day} confirmation sets a day are used (alarms.confirmation_sets_a_day)"
    return no_room(room_ns, set_ns)


def n_today(position: str, asked: Iterable[Confirmation], at_h: float) -> int:
    """Count the sets that suspicion has asked for at a transducer over the last `BUDGET_H`."""
    own = [one for one in asked if one.due.position == position and not one.author]
    return sum(one.due.due_h > at_h - BUDGET_H for one in own)


def no_room(room_ns: float, set_ns: int) -> str:
    """Say that a set would run into the next planned one; empty: it does not."""
    if set_ns <= room_ns:
        return ""
    room_s, set_s = room_ns / NS_PER_S, set_ns / NS_PER_S
    return f"it takes up to {set_s:.0f} s, and the next planned set is due in {max(room_s, 0.0):.0f} s"


def longest_ns(schedule: ScheduleSettings, restrikes: int, read_timeout_s: float) -> int:
    """Bound the time that one transducer's set takes, its repeated strikes and one lost record included."""
    strikes = schedule.shots_per_set + restrikes
    return round((strikes * schedule.shot_interval_s + read_timeout_s) * NS_PER_S)


def next_number(asked: Iterable[Confirmation], planned_set: int) -> int | None:
    """Give the number of the next set beside the plan after a planned one; None: there are too many."""
    places = (in_order(one.due.set_index) for one in asked)
    number = 1 + max((beside for planned, beside in places if planned == planned_set), default=0)
    return number if number <= MOST_EXTRA else None


def confirms(judged: Sequence[AssessedSet], baseline: Baseline, vector: Sequence[float]) -> bool | None:
    """Tell whether a set lies where the suspect planned sets do, rather than where the baseline does.

    Of two normal populations of the baseline's covariance it is the likelier one: the one whose mean is
    nearer by the Mahalanobis distance.

    Parameters
    ----------
    judged
        The last planned sets, at most n: suspect are those beyond the limit, or where none is (the chart has
        seen what no single set shows) all of them.
    vector
        The confirmation set's five features.
    """
    suspects = [found.vector for found in judged if found.outlier] or [found.vector for found in judged]
    if not suspects:
        return None
    shift = np.mean(np.array(suspects), axis=0) - baseline.mean
    own = np.array(vector)
    from_baseline, from_suspects = distance_squared(np.stack([own, own - shift]), baseline)
    return bool(from_suspects < from_baseline)


@dataclass(frozen=True, slots=True, kw_only=True)
class Confirmed:
    """What a confirmation set says, as an alarm's proof holds it.

    Attributes
    ----------
    confirms
        None: it cannot tell, and ``why_not`` says why.
    distance_squared, limit
        To the baseline, and the limit that judges sets; None: not judged.
    """

    set_index: int
    utc_ns: int
    due_h: float
    confirms: bool | None
    distance_squared: float | None = None
    limit: float | None = None
    why_not: str | None = None

    @property
    def after_set(self) -> int:
        """The planned set that it follows."""
        return in_order(self.set_index)[0]


def confirmed(its_set: SetRow, assessment: AssessmentRow | None) -> Confirmed:
    """Sum up the rows of a confirmation set; ``verdict`` None: not one record was taken."""
    facts: dict[str, Any] = {
        "set_index": its_set.set_index,
        "utc_ns": its_set.due_utc_ns,
        "due_h": its_set.due_h,
        "confirms": None if assessment is None else assessment.confirms,
    }
    if assessment is None:
        return Confirmed(**facts, why_not=its_set.cause)
    limit = limits_by_name(assessment).get(assessment.limit_name)
    return Confirmed(
        **facts, distance_squared=assessment.distance_squared, limit=limit, why_not=assessment.reason
    )


def asked_so_far(catalogue: Catalogue) -> list[Confirmation]:
    """Read everything that was asked for, in that order."""
    events = catalogue.rows(EventRow, topic="service", kind=CONFIRMATION_ASKED)
    return [asked_by(event.position, event.payload) for event in events if event.position is not None]


def confirmation_of(catalogue: Catalogue, position: str, set_index: int | None = None) -> Confirmed | None:
    """Give the newest confirmation set of a position, of all or after a planned set; None: there is none."""
    rows = catalogue.rows(SetRow, position=position, purpose="confirmation")
    after = [row for row in rows if set_index is None or in_order(row.set_index)[0] == set_index]
    if not after:
        return None
    newest = max(after, key=lambda row: in_order(row.set_index))
    assessments = catalogue.rows(AssessmentRow, position=position, set_index=newest.set_index)
    return confirmed(newest, assessments[0] if assessments else None)
