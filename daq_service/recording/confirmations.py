"""Unscheduled sets: which were requested, which of them wait, and their results.

All of it follows from the catalogue: a request is an event, its result is rows. So a restart and a rebuild
know it, and no set is requested twice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace

from daq_service.acquisition.schedule import build_unscheduled_set, list_due_hours
from daq_service.alarms.states import ALARMS_OF_CHANGE, Condition, Moment, add_evidence, find_disabled
from daq_service.assessment.confirmation import (
    CONFIRMATION_ASKED,
    Confirmation,
    ConfirmationResult,
    compute_longest_set_ns,
    explain_overlap,
    find_next_unscheduled_index,
    find_rejection_reason,
    parse_confirmation_payload,
    read_confirmations,
    read_newest_confirmation,
    summarize_confirmation,
)
from daq_service.catalogue import RecorderCatalogue, SetCommit
from daq_service.catalogue.rows import AlarmRow, EventRow
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import DueSet, SetKey
from hardware_drivers.nanoseconds import NS_PER_H

Alarms = Mapping[tuple[str | None, str], AlarmRow]


class Confirmations:
    """What is known of the confirmation sets of a test.

    Attributes
    ----------
    asked
        Every one that was asked for, by its key.
    waiting
        Those of them without rows, by key in the order in which they were asked for.
    last_results
        Result of the newest one of each position that has one.
    set_ns
        How long one takes at most.
    """

    def __init__(self, settings: Settings, catalogue: RecorderCatalogue) -> None:
        """Read the requests and results of confirmation sets from a catalogue; raise CatalogueError."""
        self._rules = settings.alarms
        self._hours = list_due_hours(settings.schedule.phases, end_h=settings.schedule.end_h)
        self.set_ns = compute_longest_set_ns(
            settings.schedule, settings.quality.restrikes_per_set, settings.rig.read_timeout_s
        )
        self.asked: dict[SetKey, Confirmation] = {}
        self.waiting: dict[SetKey, Confirmation] = {}
        self.last_results: dict[str, ConfirmationResult] = {}
        for one in read_confirmations(catalogue):
            self.asked[one.due.set_key] = self.waiting[one.due.set_key] = one
        for set_key in catalogue.list_committed_sets(self.waiting) if self.waiting else ():
            del self.waiting[set_key]
        for position in {one.due.position for one in self.asked.values()} - {None}:
            last = read_newest_confirmation(catalogue, str(position))
            if last is not None:
                self.last_results[str(position)] = last

    def apply_event(self, event: EventRow) -> None:
        """Add the request in a stored event to `asked` and `waiting`; other events are ignored."""
        if event.kind == CONFIRMATION_ASKED and event.position is not None:
            one = parse_confirmation_payload(event.position, event.payload)
            self.asked[one.due.set_key] = self.waiting[one.due.set_key] = one

    def apply_rows(self, stored: SetCommit) -> None:
        """Remove stored confirmation sets from `waiting` and keep their results as the last ones.

        Rows of scheduled sets are ignored.
        """
        for row in stored.sets:
            if row.purpose == "confirmation":
                self.waiting.pop(row.set_key, None)
                assessment = next((one for one in stored.assessments if one.set_key == row.set_key), None)
                self.last_results[row.position] = summarize_confirmation(row, assessment)

    def compute_time_to_next_set_ns(self, planned: DueSet, utc_ns: int) -> float:
        """Compute the time in ns from ``utc_ns`` to the scheduled set after ``planned``; inf without one."""
        following = self._hours[planned.set_index + 1 : planned.set_index + 2]
        left_h = following[0] - planned.due_h if following else float("inf")
        return planned.due_utc_ns + left_h * NS_PER_H - utc_ns

    def request(
        self,
        reason: str,
        planned: DueSet,
        position: str,
        alarms: Alarms,
        moment: Moment,
        transaction: SetCommit,
    ) -> None:
        """Add the request for a confirmation set to the transaction of a scheduled set, if it is allowed.

        Nothing is added for a position that is disabled or out of service, above the daily maximum, or
        without time until the next set.
        """
        own = [row for row in alarms.values() if row.position == position]
        if find_disabled(own) or any(row.suppressed == "out_of_service" for row in own):
            return
        at_h = planned.due_h + (moment.utc_ns - planned.due_utc_ns) / NS_PER_H
        if not find_rejection_reason(
            position,
            self.asked.values(),
            at_h=at_h,
            maximum_per_day=self._rules.confirmation_sets_a_day,
            available_ns=self.compute_time_to_next_set_ns(planned, moment.utc_ns),
            set_ns=self.set_ns,
        ):
            self.add(reason, planned, position, moment, transaction)

    def order(self, planned: DueSet, position: str, author: str, note: str, moment: Moment) -> SetCommit:
        """Build the transaction with a person's request for a set after ``planned``; the caller commits it.

        Raises ValueError with the reason: the next scheduled set is too near, or there are too many since the
        last.
        """
        if too_late := explain_overlap(self.compute_time_to_next_set_ns(planned, moment.utc_ns), self.set_ns):
            raise ValueError(f"{too_late}; wait for that one")
        transaction = SetCommit()
        if self.add(note, planned, position, moment, transaction, author) is None:
            raise ValueError(
                "there are too many unscheduled sets since the last scheduled set; wait for the next one"
            )
        return transaction

    def add(
        self,
        reason: str,
        planned: DueSet,
        position: str,
        moment: Moment,
        transaction: SetCommit,
        author: str = "",
    ) -> Confirmation | None:
        """Add the event that requests a set after a planned one to the transaction; return the request.

        Returns None, and adds nothing, if there are too many since the planned one.
        """
        requested = [
            parse_confirmation_payload(str(event.position), event.payload)
            for event in transaction.events
            if event.kind == CONFIRMATION_ASKED
        ]
        number = find_next_unscheduled_index([*self.asked.values(), *requested], planned.set_index)
        if number is None:
            return None
        due = build_unscheduled_set(number, planned, moment.utc_ns, position)
        one = Confirmation(due=due, reason=reason, author=author)
        transaction.events.append(
            moment.event("service", CONFIRMATION_ASKED, one.payload(), position=position)
        )
        return one

    def add_result_to_evidence(
        self, last: ConfirmationResult, conditions: Sequence[Condition], planned_set: int
    ) -> Sequence[Condition]:
        """Return conditions with a confirmation result in the evidence of each alarm about a change.

        Unchanged if the result is n or more sets older than ``planned_set`` (n: the rule "m of n" of the
        alarms).
        """
        if planned_set - last.set_index >= self._rules.n:
            return conditions
        confirmation = {"confirmation": asdict(last)}
        return [
            replace(condition, evidence={**condition.evidence, **confirmation})
            if condition.kind in ALARMS_OF_CHANGE
            else condition
            for condition in conditions
        ]


def add_confirmation_evidence(alarms: Alarms, position: str, transaction: SetCommit, moment: Moment) -> None:
    """Add the result of a confirmation set to the evidence of the active alarms of change at its position.

    ``transaction`` has the rows of the set and gets the changed alarms with their events.
    """
    assessment = transaction.assessments[0] if transaction.assessments else None
    payload = asdict(summarize_confirmation(transaction.sets[0], assessment))
    for kind in ALARMS_OF_CHANGE:
        row = alarms.get((position, kind))
        if row is not None and row.state != "normal":
            change = add_evidence(row, {"confirmation": payload}, moment)
            transaction.add_alarm(change.row, change.event(moment))
