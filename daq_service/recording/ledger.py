"""Every planned set ends as rows: judged, empty, missed or retired, in one transaction with its alarms."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace

from analysis.waves.features import ShotFeatures
from analysis.waves.quality_gate import ACCEPTED
from daq_service.acquisition.schedule import DueSet
from daq_service.acquisition.taken_set import TakenSet, n_missed, n_restrikes, n_tried
from daq_service.alarms.rig_trouble import lost_cause, rig_condition
from daq_service.alarms.states import Condition, Moment, retired_positions, update
from daq_service.archive import SetReader, SetRecord
from daq_service.catalogue import RecorderCatalogue
from daq_service.catalogue.rows import AlarmRow, SetRow
from daq_service.corrosion_drive.watch import drive_watch
from daq_service.judgement.restored import restored_assessors
from daq_service.judgement.solitary_wave import Assessment, SolitaryWaveAssessor
from daq_service.judgement.transaction import Transaction
from daq_service.recording.cost import Cost
from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Rig

log = logging.getLogger(__name__)


class Ledger:
    """Judges what was taken and writes it down; holds what later sets are judged by.

    Attributes
    ----------
    alarms
        The newest alarm of each position and kind, as stored.
    drive
        The corrosion drive; None where the test has neither supply nor climate probe.
    """

    def __init__(
        self, settings: Settings, archive: SetReader, catalogue: RecorderCatalogue, rig: Rig, cost: Cost
    ) -> None:
        self._settings = settings
        self._catalogue = catalogue
        self._dry_run = rig.dry_run
        self._cost = cost
        self._assessors = restored_assessors(settings, catalogue, archive)
        self.alarms = {(row.position, row.kind): row for row in catalogue.rows(AlarmRow)}
        self.drive = drive_watch(settings, rig, catalogue, self.alarms, self.commit)

    def retired(self) -> dict[str, str]:
        """Transducers that strike no more, and why."""
        return retired_positions(self.alarms.values())

    def reinstated(self, position: str) -> None:
        """Forget what retired a transducer: a person says that it may strike again."""
        assessor = self._assessors[position]
        if isinstance(assessor, SolitaryWaveAssessor):
            assessor.reinstate()

    def n_planned(self, position: str) -> int:
        """Count the records wanted of a position in a set."""
        place = self._settings.positions[position]
        return 1 if place.method == "pulse_echo" else self._settings.schedule.shots_per_set

    def judge(self, due: DueSet, record: SetRecord, file: str, features: Mapping[int, ShotFeatures]) -> None:
        """Assess every position; store rows, alarms and events in one transaction."""
        moment = Moment(utc_ns=record.ended_utc_ns, due_h=due.due_h, set_index=due.set_index)
        causes = {position.position: position.cause for position in record.positions}
        retired = self.retired()
        transaction = Transaction()
        for position, place in self._settings.positions.items():
            if position not in causes:
                cause = retired.get(position, "retired")
                transaction.sets.append(self._gap_row(due, position, retired=True, cause=cause))
                continue
            measurements = [item for item in record.records if item.key.position == position]
            with self._cost.of("judge_s"):
                assessment = self._assess(position, due, record, features)
            row = SetRow(
                set_index=due.set_index,
                position=position,
                method=place.method,
                due_utc_ns=due.due_utc_ns,
                due_h=due.due_h,
                state="done" if not causes[position] else "partial" if measurements else "missed",
                cause=causes[position] or None,
                n_planned=self.n_planned(position),
                n_taken=len(measurements),
                n_valid=assessment.n_valid,
                n_missed=n_missed(record, position),
                n_restrikes=n_restrikes(record, position),
                started_utc_ns=record.started_utc_ns,
                ended_utc_ns=record.ended_utc_ns,
                file=file if measurements else None,
            )
            transaction.add_position(row, measurements, assessment, moment, record.outcomes)
            for condition in assessment.conditions:
                self._carry_alarm(condition, moment, transaction)
        self._carry_alarm(self._rig_condition(due, record), moment, transaction)
        self._commit_set(due, moment, transaction)

    def _assess(
        self, position: str, due: DueSet, record: SetRecord, features: Mapping[int, ShotFeatures]
    ) -> Assessment:
        assessor = self._assessors[position]
        if isinstance(assessor, SolitaryWaveAssessor):
            shots = [shot for shot in record.shots if shot.key.position == position]
            found = assessor.assess(
                due,
                shots,
                [features[shot.sequence] for shot in shots],
                outcomes=[record.outcomes.get(shot.sequence, ACCEPTED) for shot in shots],
                n_tried=n_tried(record, position),
            )
            # A rehearsal records noise: what it says of wall and transducer is no alarm.
            return replace(found, conditions=()) if self._dry_run else found
        echoes = [item for item in record.echoes if item.key.position == position]
        return assessor.assess(due, echoes[0]) if echoes else Assessment()

    def _rig_condition(self, due: DueSet, record: SetRecord) -> Condition:
        """Tell whether the instruments of either method had trouble; strikes and echoes have their own."""
        unanswered = ""
        for method in ("solitary_wave", "pulse_echo"):
            names = self._settings.names_of(method)
            if not any(item.key.position in names for item in record.records):
                unanswered = unanswered or lost_cause(
                    [item for item in record.missed if item.key.position in names]
                )
        return rig_condition(due, record.trouble, unanswered)

    def _carry_alarm(self, condition: Condition, moment: Moment, transaction: Transaction) -> None:
        change = update(self.alarms.get((condition.position, condition.kind)), condition, moment)
        if change is not None:
            if self.drive is not None and condition.kind == "hole" and change.event_kind == "alarm_raised":
                # At once: through a hole the solution reaches what it should not, and the current with it.
                self.drive.trip(condition.message, moment.due_h)
            transaction.add_alarm(change, moment)
            log.warning("%s at hour %g: %s", change.event_kind, moment.due_h, change.row.message)

    def _commit_set(self, due: DueSet, moment: Moment, transaction: Transaction) -> None:
        """Store a set's rows, with what supply and climate probe said since the last one."""
        if self.drive is not None:
            self.drive.add_row(transaction, due, moment)
        self.commit(transaction)

    def commit(self, transaction: Transaction) -> None:
        """Store it; what later sets build on is taken over only after that."""
        with self._cost.of("commit_s"):
            committed = self._catalogue.commit_set(transaction)
        for row, alarm_id in zip(transaction.alarms, committed.alarm_ids, strict=True):
            self.alarms[(row.position, row.kind)] = replace(row, id=alarm_id)

    def judge_empty(self, due: DueSet, taken: TakenSet, causes: Mapping[str, str]) -> None:
        """Not one record: rows with the causes and the device's alarms, but no file."""
        moment = Moment(utc_ns=taken.ended_ns, due_h=due.due_h, set_index=due.set_index)
        transaction = Transaction()
        retired = taken.retired
        for position in self._settings.positions:
            missed = [item.key for item in taken.missed if item.key.position == position]
            restrikes = sum(key.attempt > 0 for key in missed)
            assessor = self._assessors[position]
            assessment = Assessment()
            if isinstance(assessor, SolitaryWaveAssessor) and position not in retired:
                assessment = assessor.assess(due, [], [], n_tried=len(missed) - restrikes)
            cause = retired.get(position) or causes[position]
            row = self._gap_row(due, position, retired=position in retired, cause=cause)
            row = replace(row, n_missed=len(missed), n_restrikes=restrikes)
            transaction.add_position(row, [], assessment, moment)
            for condition in assessment.conditions:
                self._carry_alarm(condition, moment, transaction)
        if taken.trouble is not None or taken.missed:  # where nothing was tried nothing is known
            unanswered = "" if taken.trouble is not None else lost_cause(taken.missed)
            self._carry_alarm(rig_condition(due, taken.told_trouble(), unanswered), moment, transaction)
        self._commit_set(due, moment, transaction)

    def gap(self, due: DueSet, causes: Mapping[str, str], *, utc_ns: int) -> None:
        """Rows of a set in which nothing was tried."""
        moment = Moment(utc_ns=utc_ns, due_h=due.due_h, set_index=due.set_index)
        transaction = Transaction()
        retired = self.retired()
        for position in self._settings.positions:
            cause = retired.get(position) or causes[position]
            row = self._gap_row(due, position, retired=position in retired, cause=cause)
            transaction.add_position(row, [], Assessment(), moment)
        self._commit_set(due, moment, transaction)
        log.warning("set %d missed: %s", due.set_index, next(iter(causes.values())))

    def _gap_row(self, due: DueSet, position: str, *, retired: bool, cause: str) -> SetRow:
        return SetRow(
            set_index=due.set_index,
            position=position,
            method=self._settings.positions[position].method,
            due_utc_ns=due.due_utc_ns,
            due_h=due.due_h,
            state="retired" if retired else "missed",
            cause=cause,
            n_planned=0 if retired else self.n_planned(position),
        )
