"""Assess a set: its rows, alarms and events in one transaction, and the states that later sets build on."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from types import MappingProxyType
from typing import Any

from analysis.assessment.exact_json import to_json
from analysis.waves.features import ShotFeatures
from analysis.waves.quality_gate import ACCEPTED, SUPERSEDED
from daq_service.alarms.delays import DELAY_EVENT, apply_delays
from daq_service.alarms.operator_actions import end_expired_shelf, report_overdue_response
from daq_service.alarms.process_trouble import RECORDER_NOT_RUNNING, build_reason_condition
from daq_service.alarms.rig_trouble import RIG_UNAVAILABLE, build_rig_condition, find_connection_loss
from daq_service.alarms.states import (
    ALARMS_OF_CHANGE,
    Condition,
    Moment,
    find_alarm,
    find_disabled,
    index_alarm,
    update_alarm,
)
from daq_service.archive import SetReader, SetRecord, compute_crc32
from daq_service.assessment.assessor import Assessor, PositionResult
from daq_service.assessment.methods import METHODS
from daq_service.assessment.restore_state import STATE_FORMAT
from daq_service.catalogue import Catalogue, RecorderCatalogue, SetCommit
from daq_service.catalogue.rows import AlarmRow, AssessorStateRow, EventRow, Outcome, SetRow, ShotRow
from daq_service.catalogue.writer import build_event_payload
from daq_service.corrosion_drive.remote import RemoteDrive
from daq_service.corrosion_drive.watch import DriveWatch
from daq_service.recording.confirmations import Confirmations, add_confirmation_evidence
from daq_service.recording.report_changes import report_changes
from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Rig
from hardware_drivers.measurement import DueSet, PulseEchoRecord, Shot

log = logging.getLogger(__name__)

FROZEN_FIELDS = frozenset({"healthy", "n_left_out", "baseline", "reference"})
"""Fields of a state that rarely change. They are large and have a row of their own."""
WALL_FIELDS = frozenset({"wall"})
"""Fields that are large and change with each set; they have a row of their own."""


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
    n_planned
        Number of records wanted of each position in a set.
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
        """Read alarms, delays, requests and assessor states of the test; create the drive if there is one.

        Raises StorageError if they cannot be read.
        """
        self._settings, self._delays = settings, settings.alarms.kinds
        self._positions_by_method = [settings.list_positions(method) for method in METHODS]
        self.n_planned = {
            name: METHODS[place.method].records_planned(settings.schedule)
            for name, place in settings.positions.items()
        }
        self._catalogue = catalogue
        self._uncommitted: SetCommit | None = None
        self._news = news
        rehearsal = rehearsal if rig is None else rig.dry_run
        counts = catalogue.counts()
        self.proven = counts["sets"] > counts["partial_sets"]
        self.confirmations = Confirmations(settings, catalogue)
        self.assessors = PositionAssessors(settings, catalogue, archive, rehearsal)
        self.alarms = {(row.position, row.kind): row for row in catalogue.rows(AlarmRow)}
        self._delayed_since_ns: dict[tuple[str | None, str], int | None] = {}
        for event in catalogue.rows(EventRow, topic="alarms", kind=DELAY_EVENT):
            self.apply_stored_event(event)
        self.drive = None
        if rig is not None and (rig.supply or rig.climate or remote_drive):
            self.drive = DriveWatch(
                settings.rig, rig, catalogue, self.alarms, self.apply_alarm, self.commit, remote_drive
            )

    def adopt(self) -> None:
        """Read the stored alarms about a recorder that does not run, which another process raised.

        Raises CatalogueError.
        """
        rows = self._catalogue.rows(AlarmRow, kind=RECORDER_NOT_RUNNING)
        self.alarms |= {(row.position, row.kind): row for row in rows}

    def apply_stored_row(self, row: SetRow) -> Sequence[Condition]:
        """Update the assessor with the stored row of a set without records; return its alarm conditions."""
        position_result = self.assessors[row.position].assess_empty_set(
            DueSet(set_index=row.set_index, due_h=row.due_h, due_utc_ns=row.due_utc_ns),
            row.n_missed - row.n_restrikes,
        )
        return position_result.conditions

    def disabled(self) -> dict[str, str]:
        """Return the reason of each disabled transducer by position; empty if none is disabled."""
        return find_disabled(self.alarms.values())

    def assessed(
        self,
        due: DueSet,
        record: SetRecord,
        file: str,
        features: Mapping[int, ShotFeatures],
        *,
        sha256: str | None = None,
    ) -> SetCommit:
        """Assess every position once; return rows, alarms and events as one transaction to commit.

        An unscheduled set is assessed at its own position, and does not change later assessments. The states
        of the assessors change at once; nothing is stored.

        Parameters
        ----------
        features
            Features of each shot of the record, by sequence.
        file, sha256
            Reference of the record, and the SHA-256 of the file if it is made.
        """
        moment = Moment.of_set(due, record.ended_utc_ns)
        reasons = {position.position: position.cause for position in record.positions}
        disabled = self.disabled()
        transaction = SetCommit()
        suspicions: dict[str, str] = {}
        for position in self.list_set_positions(due):
            if position not in reasons:
                reason = disabled.get(position, "disabled")
                transaction.sets.append(self.build_empty_row(due, position, disabled=True, reason=reason))
                continue
            measurements = [item for item in record.records if item.key.position == position]
            assessor = self.assessors[position]
            assess_set = assessor.assess_set if due.position is None else assessor.assess_unscheduled
            position_result = assess_set(due, record, features)
            row = replace(
                self.build_empty_row(due, position, disabled=False, reason=reasons[position]),
                state="done" if not reasons[position] else "partial" if measurements else "missed",
                n_taken=len(measurements),
                n_valid=position_result.n_valid,
                n_missed=record.n_missed(position),
                n_restrikes=record.n_restrikes(position),
                started_utc_ns=record.started_utc_ns,
                ended_utc_ns=record.ended_utc_ns,
                file=file if measurements else None,
                file_sha256=sha256 if measurements else None,
            )
            add_position_rows(transaction, row, measurements, position_result, moment, record.outcomes)
            suspicions[position] = position_result.suspicion
            conditions, confirmed = position_result.conditions, self.confirmations.last_results.get(position)
            if confirmed is not None:
                conditions = self.confirmations.add_result_to_evidence(confirmed, conditions, due.set_index)
            for condition in conditions:
                self.apply_alarm(condition, moment, transaction)
        if due.position is not None:
            add_confirmation_evidence(self.alarms, due.position, transaction, moment)
        trouble, unanswered = record.trouble, self._find_unanswered_reason(record)
        has_trouble = bool(trouble or unanswered)
        # One position that works proves nothing of the other instruments.
        if has_trouble or (due.position is None and self._has_alarm_or_delay(None, RIG_UNAVAILABLE)):
            rig_now = build_rig_condition(due, trouble, unanswered, proven=self.proven)
            self.apply_alarm(rig_now, moment, transaction)
        if due.position is not None:
            return transaction
        if self._has_alarm_or_delay(None, RECORDER_NOT_RUNNING):
            self.apply_alarm(build_reason_condition(RECORDER_NOT_RUNNING, ""), moment, transaction)
        self.proven = self.proven or not (record.trouble or any(reasons.values()))
        standing = {**self.alarms, **{(row.position, row.kind): row for row in transaction.alarms}}
        for position, reason in suspicions.items():
            if reason:
                self.confirmations.request(reason, due, position, standing, moment, transaction)
        return self.add_environment(due, moment, transaction)

    def build_empty_row(self, due: DueSet, position: str, *, disabled: bool, reason: str) -> SetRow:
        """Build the row of a position without records, of state "missed" or, if not measured, "disabled"."""
        return SetRow(
            set_index=due.set_index,
            unscheduled_index=due.unscheduled_index,
            position=position,
            method=self._settings.positions[position].method,
            due_utc_ns=due.due_utc_ns,
            due_h=due.due_h,
            state="disabled" if disabled else "missed",
            reason=reason or None,
            n_planned=0 if disabled else self.n_planned[position],
            purpose=None if due.position is None else "confirmation",
        )

    def list_set_positions(self, due: DueSet) -> list[str]:
        """List the positions of a set: all in their order, or the one of an unscheduled set."""
        return list(self._settings.positions) if due.position is None else [due.position]

    def update_alarm(self, condition: Condition, moment: Moment) -> None:
        """Update an alarm that belongs to no set, and commit the change, if there is one.

        Raises CatalogueError if it is not stored.
        """
        transaction = SetCommit()
        self.apply_alarm(condition, moment, transaction)
        if transaction.events:
            self.commit(transaction)

    def update_alarms_by_time(self, moment: Moment) -> None:
        """Store and report expired shelves, and alarms that nobody acknowledged within their time to respond.

        Shelves end on the test's clock or in real time; the time to respond runs on a wall clock only. Raises
        CatalogueError.
        """
        rows, wall_utc_ns = list(self.alarms.values()), time.time_ns()
        changes = [change for row in rows if (change := end_expired_shelf(row, moment, wall_utc_ns))]
        if self._settings.clock.kind == "wall":
            changes += [change for row in rows if (change := report_overdue_response(row, moment))]
        if changes:
            transaction = SetCommit()
            for change in changes:
                transaction.add_alarm(change.row, change.event(moment))
            self.commit(transaction)

    def _find_unanswered_reason(self, record: SetRecord) -> str:
        """Return why no instrument of a method responded in a set, for the first such method; else ""."""
        for names in self._positions_by_method:
            if not any(item.key.position in names for item in record.records):
                missed = [item for item in record.missed if item.key.position in names]
                if missed and (cause := find_connection_loss(missed)):
                    return cause
        return ""

    def _has_alarm_or_delay(self, position: str | None, kind: str) -> bool:
        """Return whether the position (None: the test) has an alarm of the kind, or its delay runs."""
        return (position, kind) in self.alarms or (position, kind) in self._delayed_since_ns

    def apply_alarm(self, condition: Condition, moment: Moment, transaction: SetCommit) -> None:
        """Apply a condition to its alarm, after its delays, and add the changes to a transaction.

        Nothing is added if the alarm does not change, or its delay is running. A missing reflection trips the
        supply at once. A change is logged as a warning.
        """
        # Either alarm of change is the same fault: a delay does not restart with another diagnosis.
        fault = ALARMS_OF_CHANGE[0] if condition.kind in ALARMS_OF_CHANGE else condition.kind
        key = (condition.position, fault)
        row, since_ns = find_alarm(self.alarms, condition), self._delayed_since_ns.get(key)
        to_follow: Condition | None = condition
        now_since_ns, rule = None, self._delays.get(condition.kind)
        if rule is not None:
            to_follow, now_since_ns = apply_delays(row, condition, since_ns, moment, rule)
        if now_since_ns != since_ns:
            delay = {"alarm_kind": fault, "since_utc_ns": now_since_ns}
            transaction.events.append(moment.event("alarms", DELAY_EVENT, delay, position=condition.position))
        change = None if to_follow is None else update_alarm(row, to_follow, moment)
        if change is not None:
            if (
                self.drive is not None
                and condition.kind == "no_reflection"
                and change.event_kind == "alarm_raised"
            ):
                # At once: through a hole the solution reaches what it should not, and the current with it.
                self.drive.trip(condition.build_texts(moment.due_h).headline, moment.due_h)
            transaction.add_alarm(change.row, change.event(moment))
            log.warning("%s at hour %g: %s", change.event_kind, moment.due_h, change.row.message)

    def apply_stored_event(self, event: EventRow) -> None:
        """Update alarm delays and requested sets in memory from a stored event; ignore other events."""
        self.confirmations.apply_event(event)
        if event.kind == DELAY_EVENT:
            payload = event.payload
            self._delayed_since_ns[(event.position, payload["alarm_kind"])] = payload["since_utc_ns"]

    def add_environment(self, due: DueSet, moment: Moment, transaction: SetCommit) -> SetCommit:
        """Add the row of supply and climate readings since the last set to the transaction; return it.

        Nothing is added without a drive.
        """
        if self.drive is not None:
            self.drive.add_environment_row(transaction, due, moment)
        return transaction

    def commit(self, transaction: SetCommit) -> None:
        """Store rows, alarms and events in one transaction, then report them.

        Raises CatalogueError, with nothing stored.
        """
        self.store(transaction)
        self.publish(transaction)

    def store(self, transaction: SetCommit) -> None:
        """Store rows, alarms and events in one transaction; update `alarms` only after that.

        Called again after an error, it first checks whether the commit took place all the same. Raises
        CatalogueError; then nothing is stored.
        """
        keys = {row.set_key for row in transaction.sets}
        if transaction is self._uncommitted and keys <= self._catalogue.list_committed_sets(keys):
            for row in self._catalogue.rows(AlarmRow):
                index_alarm(self.alarms, row)
            return
        # Not with a change that overtakes a set: the state is that after the set, which is not stored yet.
        if keys or (self.assessors.enabled and self._uncommitted is None):
            transaction.states |= self.assessors.collect_changed_states()
        self._uncommitted = transaction if keys else self._uncommitted
        committed = self._catalogue.commit_set(transaction)
        self._uncommitted = None if transaction is self._uncommitted else self._uncommitted
        for row, alarm_id in zip(transaction.alarms, committed.alarm_ids, strict=True):
            index_alarm(self.alarms, replace(row, id=alarm_id))

    def publish(self, transaction: SetCommit) -> None:
        """Update delays and requested sets with a stored transaction, then report its alarms and gaps."""
        for event in transaction.events:
            self.apply_stored_event(event)
        self.confirmations.apply_rows(transaction)
        report_changes(transaction, self._news)


def build_shot_row(
    measurement: Shot | PulseEchoRecord, *, valid: bool, flags: Sequence[str], outcome: Outcome = ACCEPTED
) -> ShotRow:
    """Build the catalogue row of a record from key, time stamp and quality, with the CRC-32 of its counts."""
    key, stamp = measurement.key, measurement.stamp
    return ShotRow(
        sequence=measurement.sequence,
        set_index=key.set_index,
        unscheduled_index=key.unscheduled_index,
        position=key.position,
        shot_index=key.shot_index,
        attempt=key.attempt,
        utc_ns=stamp.utc_ns,
        mono_ns=stamp.mono_ns,
        boot_id=stamp.boot_id,
        crc32=compute_crc32(measurement.waveform),
        valid=valid,
        flags=list(flags),
        outcome=outcome,
    )


def add_position_rows(
    transaction: SetCommit,
    its_set: SetRow,
    measurements: Sequence[Shot | PulseEchoRecord],
    position_result: PositionResult,
    moment: Moment,
    outcomes: Mapping[int, str] = MappingProxyType({}),
) -> None:
    """Add the rows and events of a set at one position to a transaction.

    ``outcomes`` has the outcome of records that are not accepted, by sequence; ``moment`` dates the events
    and a new baseline.
    """
    event = partial(moment.event, position=its_set.position)
    transaction.sets.append(its_set)
    for measurement in measurements:
        flags = position_result.shot_flags[measurement.sequence]
        valid = measurement.sequence not in position_result.invalid
        outcome: Outcome = SUPERSEDED if outcomes.get(measurement.sequence) == SUPERSEDED else ACCEPTED
        transaction.shots.append(build_shot_row(measurement, valid=valid, flags=flags, outcome=outcome))
    transaction.features += position_result.features
    transaction.thickness += position_result.thickness
    transaction.assessments += position_result.assessments
    if position_result.wall is not None:
        transaction.wall.append(position_result.wall)
    # A reader joins the row, so the event holds no copy; that of a collecting baseline is replaced later.
    transaction.events.append(event("sets", f"set_{its_set.state}", {}))
    if any(row.shot_index is None for row in position_result.features):
        transaction.events.append(event("features", "set_features", {}))
    if position_result.thickness:
        transaction.events.append(event("thickness", "thickness_read", {}))
    if position_result.wall is not None:
        transaction.events.append(event("thickness", "wall_estimated", {}))
    if (baseline := position_result.baseline) is not None:
        approved_ns = moment.utc_ns if baseline.state == "approved" else None
        baseline = replace(baseline, created_utc_ns=moment.utc_ns, approved_utc_ns=approved_ns)
        frozen = event("assessments", "baseline_frozen", {})
        transaction.add_baseline(baseline, frozen, last="created_utc_ns")
    for assessment in position_result.assessments[-1:]:
        payload = build_event_payload(assessment) if assessment.in_baseline else {}
        transaction.events.append(event("assessments", "set_assessed", payload))


class PositionAssessors:
    """Assessors by position, restored when they are first used.

    Parameters
    ----------
    rehearsal
        The waveforms are noise of a rehearsal.

    Attributes
    ----------
    enabled
        A person has enabled a transducer since the states were stored.
    """

    def __init__(self, settings: Settings, catalogue: Catalogue, archive: SetReader, rehearsal: bool) -> None:
        """Restore the assessor of each position, so that an error of its stored state is raised at once."""
        self._settings, self._catalogue, self._archive = settings, catalogue, archive
        self._rehearsal, self._configuration_hash = rehearsal, settings.configuration_hash()
        self._assessors: dict[str, Assessor] = {}
        self._stored: dict[str, object] = {}
        self.enabled = False
        for position in settings.positions:
            self[position]  # an error of its state is reported at the start

    def __getitem__(self, position: str) -> Assessor:
        """Return the assessor of a position, restored on the first access; KeyError for an unknown one."""
        if position not in self._assessors:
            method = METHODS[self._settings.positions[position].method]
            self._assessors[position] = method.restored(
                position, self._settings, self._catalogue, self._archive, self._rehearsal
            )
        return self._assessors[position]

    def enable(self, position: str) -> None:
        """Enable the transducer of a position again, because a person has decided so."""
        self[position].enable()
        self.enabled = True

    def discard_state(self, position: str) -> None:
        """Discard the assessor of a position in memory, because a person has renewed the baseline.

        The following sets are assessed by the stored state, which the next access restores.
        """
        self._assessors.pop(position, None)
        self._stored.pop(position, None)

    @property
    def states(self) -> dict[str, object]:
        """Return the state of each position whose assessor is in memory."""
        return {position: assessor.state for position, assessor in self._assessors.items()}

    @states.setter
    def states(self, states: Mapping[str, object]) -> None:
        """Set the state of each position that is named; the others keep theirs."""
        for position, state in states.items():
            self[position].state = state

    def collect_changed_states(self) -> dict[str, AssessorStateRow]:
        """Build the rows of the states that changed since the last call, by ``place``; reset `enabled`."""
        rows: list[AssessorStateRow] = []
        for position, assessor in self._assessors.items():
            before, self._stored[position] = self._stored.get(position), assessor.state
            rows += find_changed_state_rows(
                before,
                assessor.state,
                position=position,
                baseline_id=assessor.baseline_id,
                configuration_hash=self._configuration_hash,
            )
        self.enabled = False
        return {row.place: row for row in rows}


def find_changed_state_rows(
    before: Any, after: Any, *, position: str, baseline_id: int | None, configuration_hash: str
) -> list[AssessorStateRow]:
    """Build the rows of a state for the parts (frozen, wall, running) that differ from the earlier state.

    All parts if that is None. Fields are compared by identity.
    """
    names_of_all = {item.name for item in fields(after)}
    running = names_of_all - FROZEN_FIELDS - WALL_FIELDS
    parts = {"frozen": FROZEN_FIELDS, "wall": WALL_FIELDS & names_of_all, "running": running}
    rows = []
    for part, names in parts.items():
        values = {item.name: getattr(after, item.name) for item in fields(after) if item.name in names}
        unchanged = before is not None and all(getattr(before, name) is values[name] for name in values)
        if unchanged or not values:
            continue
        rows.append(
            AssessorStateRow(
                place=f"{position}/{part}",
                position=position,
                baseline_id=baseline_id,
                configuration_hash=configuration_hash,
                format=STATE_FORMAT,
                state=to_json(values),
            )
        )
    return rows
