"""Turn every set into rows: assessed, empty, missed or retired, in one transaction with its alarms."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace

from analysis.waves.features import ShotFeatures
from daq_service.acquisition.schedule import DueSet
from daq_service.acquisition.taken_set import TakenSet, n_missed, n_restrikes
from daq_service.alarms.delays import DELAY_EVENT, apply_delays
from daq_service.alarms.process_trouble import RECORDER_NOT_RUNNING, recorder_condition
from daq_service.alarms.rig_trouble import lost_cause, rig_condition
from daq_service.alarms.states import (
    ALARMS_OF_CHANGE,
    Condition,
    Moment,
    add_evidence,
    end_expired_shelf,
    retired_positions,
    update,
)
from daq_service.archive import SetReader, SetRecord
from daq_service.assessment.assessor import PositionResult
from daq_service.assessment.confirmation import summarize_confirmation
from daq_service.assessment.methods import METHODS
from daq_service.assessment.position_assessors import PositionAssessors
from daq_service.assessment.transaction import Transaction
from daq_service.catalogue import RecorderCatalogue
from daq_service.catalogue.rows import AlarmRow, EventRow, SetRow
from daq_service.corrosion_drive.remote import RemoteDrive
from daq_service.corrosion_drive.watch import DriveWatch
from daq_service.recording.confirmations import Alarms, Confirmations
from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Rig
from hardware_drivers.nanoseconds import NS_PER_H

log = logging.getLogger(__name__)


class SetAssessor:
    """Assesses sets and stores the results; holds the state for the assessment of later sets.

    Parameters
    ----------
    rig
        None for sets of a stored test; ``rehearsal`` then states whether they are noise only.
    news
        Called for each ``alarm`` that has changed and each ``gap``, once it is stored.

    Attributes
    ----------
    alarms
        The newest alarm of each position and kind, as stored.
    proven
        A whole set was taken in this folder: from then on trouble of its instruments costs sets only.
    confirmations
        Unscheduled sets.
    assessors
        Assessors by position.
    drive
        The corrosion drive; None where the test has neither supply nor climate probe.
    """

    def __init__(
        self,
        settings: Settings,
        archive: SetReader,
        catalogue: RecorderCatalogue,
        rig: Rig | None,
        remote_drive: RemoteDrive | None = None,
        *,
        rehearsal: bool = False,
        news: Callable[..., None] = lambda event, **values: None,
    ) -> None:
        self._settings = settings
        self._catalogue = catalogue
        self._uncommitted: Transaction | None = None
        self._news = news
        rehearsal = rehearsal if rig is None else rig.dry_run
        counts = catalogue.counts()
        self.proven = counts["sets"] > counts["partial_sets"]
        self.confirmations = Confirmations(settings, catalogue)
        self.assessors = PositionAssessors(settings, catalogue, archive, rehearsal)
        self.alarms = {(row.position, row.kind): row for row in catalogue.rows(AlarmRow)}
        self._delayed_since_ns: dict[tuple[str | None, str], int | None] = {}
        for event in catalogue.rows(EventRow, topic="alarms", kind=DELAY_EVENT):
            self.take_stored(event)
        self.drive = None
        if rig is not None and (rig.supply or rig.climate or remote_drive):
            self.drive = DriveWatch(
                settings.rig, rig, catalogue, self.alarms, self._carry_alarm, self.commit, remote_drive
            )

    def adopt(self) -> None:
        """Take over the alarm that another process raises while no recorder stores sets."""
        rows = self._catalogue.rows(AlarmRow, kind=RECORDER_NOT_RUNNING)
        self.alarms |= {(row.position, row.kind): row for row in rows}

    def passed(self, row: SetRow) -> Sequence[Condition]:
        """Update the state with the stored row of a set without waveforms; return its alarm conditions."""
        position_result = self.assessors[row.position].assess_empty_set(
            DueSet(set_index=row.set_index, due_h=row.due_h, due_utc_ns=row.due_utc_ns),
            row.n_missed - row.n_restrikes,
        )
        return position_result.conditions

    def retired(self) -> dict[str, str]:
        """Transducers that strike no more, and why."""
        return retired_positions(self.alarms.values())

    def assessed(
        self,
        due: DueSet,
        record: SetRecord,
        file: str,
        features: Mapping[int, ShotFeatures],
        *,
        sha256: str | None = None,
    ) -> Transaction:
        """Assess every position, once: rows, alarms and events of one transaction, to be committed.

        An unscheduled set is assessed at its own position, and does not change later assessments.

        Parameters
        ----------
        file, sha256
            Where the record lies, and the SHA-256 of the file if it is made.
        """
        moment = Moment(utc_ns=record.ended_utc_ns, due_h=due.due_h, **due.set_key._asdict())
        causes = {position.position: position.cause for position in record.positions}
        retired = self.retired()
        transaction = Transaction()
        suspicions: dict[str, str] = {}
        for position in self.positions_of(due):
            if position not in causes:
                cause = retired.get(position, "disabled")
                transaction.sets.append(
                    without_records(self._settings, due, position, retired=True, cause=cause)
                )
                continue
            measurements = [item for item in record.records if item.key.position == position]
            assessor = self.assessors[position]
            assess_set = assessor.assess_set if due.position is None else assessor.assess_unscheduled
            position_result = assess_set(due, record, features)
            row = replace(
                without_records(self._settings, due, position, retired=False, cause=causes[position]),
                state="done" if not causes[position] else "partial" if measurements else "missed",
                n_taken=len(measurements),
                n_valid=position_result.n_valid,
                n_missed=n_missed(record, position),
                n_restrikes=n_restrikes(record, position),
                started_utc_ns=record.started_utc_ns,
                ended_utc_ns=record.ended_utc_ns,
                file=file if measurements else None,
                file_sha256=sha256 if measurements else None,
            )
            transaction.add_position(row, measurements, position_result, moment, record.outcomes)
            suspicions[position] = position_result.suspicion
            for condition in position_result.conditions:
                further = self.confirmations.evidence(condition, due.set_index)
                self._carry_alarm(
                    replace(condition, evidence=dict(condition.evidence) | further), moment, transaction
                )
        rig_now = _rig_condition(self._settings, due, record, proven=self.proven)
        if due.position is not None:
            _add_confirmation(self.alarms, due.position, transaction, moment)
            if rig_now.present:  # one position that works proves nothing of the other instruments
                self._carry_alarm(rig_now, moment, transaction)
            return transaction
        self._carry_alarm(rig_now, moment, transaction)
        self._carry_alarm(recorder_condition("", due.due_h), moment, transaction)
        self.proven = self.proven or not (record.trouble or any(causes.values()))
        standing = {**self.alarms, **{(row.position, row.kind): row for row in transaction.alarms}}
        for position, reason in suspicions.items():
            if reason:
                self.confirmations.request(reason, due, position, standing, moment, transaction)
        return self._with_environment(due, moment, transaction)

    def positions_of(self, due: DueSet) -> list[str]:
        """Positions that a set is of."""
        return list(self._settings.positions) if due.position is None else [due.position]

    def order_confirmation(
        self, planned: DueSet, position: str, author: str, note: str, moment: Moment
    ) -> Transaction:
        """Request a confirmation set after a planned one by a person's command; to be committed.

        Raises
        ------
        ValueError
            It cannot be taken, and why.
        """
        if reason := self.assessors[position].not_assessed_reason:
            raise ValueError(f"{position} has nothing to compare a set with: {reason}")
        return self.confirmations.order(planned, position, author, note, moment)

    def update_alarm(self, condition: Condition, moment: Moment) -> None:
        """Store what becomes of an alarm that belongs to no set."""
        transaction = Transaction()
        self._carry_alarm(condition, moment, transaction)
        if transaction.events:
            self.commit(transaction)

    def expire_shelves(self, moment: Moment) -> None:
        """Tell again of alarms whose shelves have expired, on the test's clock or in real time."""
        shelved = [row for row in self.alarms.values() if row.suppressed == "shelved"]
        changes = [change for row in shelved if (change := end_expired_shelf(row, moment, time.time_ns()))]
        if changes:
            transaction = Transaction()
            for change in changes:
                transaction.add_alarm(change, moment)
            self.commit(transaction)

    def _carry_alarm(self, condition: Condition, moment: Moment, transaction: Transaction) -> None:
        key = (condition.position, condition.kind)
        row, since_ns = self.alarms.get(key), self._delayed_since_ns.get(key)
        to_follow, now_since_ns = apply_delays(row, condition, since_ns, moment, self._settings.alarms.kinds)
        if now_since_ns != since_ns:
            delay = {"alarm_kind": condition.kind, "since_utc_ns": now_since_ns}
            transaction.add_event(DELAY_EVENT, delay, moment, position=condition.position, topic="alarms")
        change = None if to_follow is None else update(row, to_follow, moment)
        if change is not None:
            if (
                self.drive is not None
                and condition.kind == "no_reflection"
                and change.event_kind == "alarm_raised"
            ):
                # At once: through a hole the solution reaches what it should not, and the current with it.
                self.drive.trip(condition.message, moment.due_h)
            transaction.add_alarm(change, moment)
            log.warning("%s at hour %g: %s", change.event_kind, moment.due_h, change.row.message)

    def take_stored(self, event: EventRow) -> None:
        """Take in since when an alarm is held back and what is asked for, once that is stored."""
        self.confirmations.take_event(event)
        if event.kind == DELAY_EVENT:
            payload = event.payload
            self._delayed_since_ns[(event.position, payload["alarm_kind"])] = payload["since_utc_ns"]

    def _with_environment(self, due: DueSet, moment: Moment, transaction: Transaction) -> Transaction:
        """Add the readings of supply and climate probe since the last set."""
        if self.drive is not None:
            self.drive.add_row(transaction, due, moment)
        return transaction

    def commit(self, transaction: Transaction) -> None:
        """Store rows, alarms and events in one transaction, then report them."""
        self.store(transaction)
        self.publish(transaction)

    def store(self, transaction: Transaction) -> None:
        """Store rows, alarms and events; what later sets build on is taken over only after that.

        Called again after an error, it first looks whether the commit took place all the same.
        """
        keys = {row.set_key for row in transaction.sets}
        if transaction is self._uncommitted and keys <= self._catalogue.committed_sets(keys):
            self.alarms |= {(row.position, row.kind): row for row in self._catalogue.rows(AlarmRow)}
            return
        # Not with a change that overtakes a set: the state is that after the set, which is not stored yet.
        if keys or (self.assessors.reinstated and self._uncommitted is None):
            transaction.states |= self.assessors.changed_states()
        self._uncommitted = transaction if keys else self._uncommitted
        committed = self._catalogue.commit_set(transaction)
        self._uncommitted = None if transaction is self._uncommitted else self._uncommitted
        for row, alarm_id in zip(transaction.alarms, committed.alarm_ids, strict=True):
            self.alarms[(row.position, row.kind)] = replace(row, id=alarm_id)

    def publish(self, transaction: Transaction) -> None:
        """Take over what was stored, and report its alarms and gaps."""
        for event in transaction.events:
            self.take_stored(event)
        self.confirmations.take_rows(transaction)
        _report_changes(transaction, self._news)

    def nothing_taken(
        self, due: DueSet, causes: Mapping[str, str], *, utc_ns: int, tried: TakenSet | None = None
    ) -> Transaction:
        """Not one record: rows with the causes, but no file; to be committed.

        Parameters
        ----------
        causes
            Why there is none, by position.
        tried
            The attempts, which show the state of the instruments; None: there were none.
        """
        moment = Moment(utc_ns=utc_ns, due_h=due.due_h, **due.set_key._asdict())
        transaction = Transaction()
        retired = self.retired() if tried is None else tried.retired
        for position in self.positions_of(due):
            gone = position in retired
            missed = (
                []
                if tried is None
                else [key for key in (item.key for item in tried.missed) if key.position == position]
            )
            restrikes = sum(key.attempt > 0 for key in missed)
            position_result = PositionResult()
            if tried is not None and not gone and due.position is None:
                position_result = self.assessors[position].assess_empty_set(due, len(missed) - restrikes)
            row = replace(
                without_records(
                    self._settings,
                    due,
                    position,
                    retired=gone,
                    cause=retired.get(position) or causes[position],
                ),
                n_missed=len(missed),
                n_restrikes=restrikes,
            )
            transaction.add_position(row, [], position_result, moment)
            for condition in position_result.conditions:
                self._carry_alarm(condition, moment, transaction)
        if tried is not None and (tried.trouble is not None or tried.missed):
            unanswered = "" if tried.trouble is not None else lost_cause(tried.missed)
            payload = rig_condition(due, tried.instrument_error(), unanswered, proven=self.proven)
            self._carry_alarm(payload, moment, transaction)
        log.warning("set %s missed: %s", due.set_key, next(iter(causes.values())))
        if due.position is not None:
            _add_confirmation(self.alarms, due.position, transaction, moment)
            return transaction
        return self._with_environment(due, moment, transaction)


def records_planned(settings: Settings, position: str) -> int:
    """Count the records wanted of a position in a set."""
    return METHODS[settings.positions[position].method].records_planned(settings.schedule)


def without_records(settings: Settings, due: DueSet, position: str, *, retired: bool, cause: str) -> SetRow:
    """Make the row of a position that gave not one record, or was not asked for any."""
    return SetRow(
        set_index=due.set_index,
        unscheduled_index=due.unscheduled_index,
        position=position,
        method=settings.positions[position].method,
        due_utc_ns=due.due_utc_ns,
        due_h=due.due_h,
        state="disabled" if retired else "missed",
        cause=cause or None,
        n_planned=0 if retired else records_planned(settings, position),
        purpose=None if due.position is None else "confirmation",
    )


def _add_confirmation(alarms: Alarms, position: str, transaction: Transaction, moment: Moment) -> None:
    """Add the result of a confirmation set to the active alarm of its position."""
    assessment = transaction.assessments[0] if transaction.assessments else None
    payload = asdict(summarize_confirmation(transaction.sets[0], assessment))
    for kind in ALARMS_OF_CHANGE:
        row = alarms.get((position, kind))
        if row is not None and row.state != "normal":
            transaction.add_alarm(add_evidence(row, {"confirmation": payload}, moment), moment)


def _rig_condition(settings: Settings, due: DueSet, record: SetRecord, *, proven: bool) -> Condition:
    """Return whether the instruments of any method had trouble; each method has its own."""
    unanswered = ""
    for method in METHODS:
        names = settings.names_of(method)
        if not any(item.key.position in names for item in record.records):
            missed = [item for item in record.missed if item.key.position in names]
            unanswered = unanswered or lost_cause(missed)
    return rig_condition(due, record.trouble, unanswered, proven=proven)


def _report_changes(transaction: Transaction, news: Callable[..., None]) -> None:
    """Report gaps and alarm changes to the program that started the test."""
    lacking: dict[tuple[int, str, str], list[str]] = {}
    for row in transaction.sets:
        if row.state in ("missed", "partial") and row.purpose is None:
            lacking.setdefault((row.set_index, row.state, row.cause or ""), []).append(row.position)
    for (set_index, state, cause), positions in lacking.items():
        news("gap", set_index=set_index, state=state, cause=cause, positions=positions)
    for at, row_at in transaction.alarm_of_event.items():
        alarm = transaction.alarms[row_at]
        since_h = (alarm.changed_utc_ns - alarm.raised_utc_ns) / NS_PER_H
        news(
            "alarm",
            change=transaction.events[at].kind,
            hour=alarm.raised_h + since_h,
            priority=alarm.priority,
            message=alarm.message,
        )
