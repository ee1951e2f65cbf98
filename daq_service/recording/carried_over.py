"""What the last recorder left: open sets, files without rows, corrupt parts of the journal."""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial

from analysis.waves.quality_gate import RestrikeRule
from daq_service.archive import CorruptArchiveError, OpenSet
from daq_service.catalogue.rows import SetRow
from daq_service.recording.acquire_set import SetAcquisition, TakenSet
from daq_service.recording.experiment import find_foreign_reason, raise_if_foreign, raise_if_foreign_open_set
from daq_service.recording.persistence import Persistence
from daq_service.recording.resources import Resources
from daq_service.recording.set_assessor import SetAssessor
from hardware_drivers.measurement import DueSet, SetKey
from hardware_drivers.nanoseconds import NS_PER_H

log = logging.getLogger(__name__)


class CarriedOver:
    """Sets of earlier recorders that are not finished.

    Attributes
    ----------
    open_sets
        Sets that were started and have no rows, by key.
    corruption_of
        What is corrupt of a set, by key.
    """

    def __init__(
        self,
        resources: Resources,
        assessor: SetAssessor,
        persistence: Persistence,
        acquisition: SetAcquisition,
    ) -> None:
        """Collect the unfinished sets of earlier recorders and set the acquisition's next shot number.

        Sets that have rows already leave `open_sets`: their journal is finished. Raises OtherExperimentError
        if an open set is of another test, StorageError if archive or catalogue cannot be read.
        """
        self._positions, self._plan = tuple(resources.settings.positions), resources.plan
        self._archive, self._catalogue = resources.archive, resources.catalogue
        self._set_assessor, self._persistence, self._acquisition = assessor, persistence, acquisition
        self._epoch_ns = resources.epoch_ns
        done, corrupt = self._catalogue.list_committed_sets(), self._archive.journal_damage
        self.open_sets = dict(self._archive.open_sets())
        for opened in self.open_sets.values():
            if opened.is_dated:
                raise_if_foreign_open_set(opened, self._plan, self._archive.name)
        self._rowless_files = {
            index: file
            for index, file in self._archive.sets().items()
            if index not in done and index not in self.open_sets
        }
        reason = f"its part of the journal was damaged: {', '.join(corrupt.files)}"
        self.corruption_of = dict.fromkeys(corrupt.sets, reason)
        self.open_sets = {
            index: opened if opened.is_dated else self._restore_set_start(opened)
            for index, opened in self.open_sets.items()
        }
        for index in done & self.open_sets.keys():
            opened = self.open_sets.pop(index)
            if not opened.records:
                self._archive.settle(index)
            elif index in corrupt.sets:
                persistence.do(partial(self._store_end_again, opened))
            else:
                persistence.after_set(
                    index
                )  # a frame of it is corrupt: that is reported, and the others stay
        sequences = [item.sequence + 1 for opened in self.open_sets.values() for item in opened.records]
        known = [self._catalogue.next_sequence(), corrupt.next_sequence, *sequences]
        acquisition.next_sequence = max(known) + corrupt.n_lost

    def has_strikes_of(self, set_key: SetKey) -> bool:
        """Return whether an earlier recorder left a set without rows: open, or complete in a file."""
        return set_key in self.open_sets or set_key in self._rowless_files

    def list_unscheduled_sets(self) -> list[DueSet]:
        """List the open unscheduled sets as due sets, also if their requests were lost with the catalogue."""
        found = []
        for set_key, opened in self.open_sets.items():
            if set_key.unscheduled_index:
                (position,) = (name for name in self._positions if name not in opened.disabled)
                found.append(replace(self._build_due_set(opened), position=position))
        return found

    def resume(self, opened: OpenSet) -> TakenSet:
        """Continue a set that the last recorder left open in the journal; return its acquired part.

        The features of its shots are extracted again; a warning names the number of its records.
        """
        self._archive.resume_set(opened)
        return self._restore_with_features(opened)

    def _restore_with_features(self, opened: OpenSet) -> TakenSet:
        """Restore the acquired part of an open set and extract the features of its shots again.

        Its shots are not reported as acknowledged a second time; a warning is logged.
        """
        taken = restore_taken_set(opened, self._acquisition.select_restrike_rule())
        taken.features.update({shot.sequence: self._acquisition.features_of(shot) for shot in taken.shots})
        self._persistence.skip_acknowledged_shots(item.sequence for item in opened.records)
        log.warning("set %s goes on: %d records of it are there", opened.set_key, len(opened.records))
        return taken

    def _build_due_set(self, opened: OpenSet) -> DueSet:
        """Build the due set of an open set from its key and due time, without a position."""
        due_h = (opened.due_utc_ns - self._epoch_ns) / NS_PER_H
        return DueSet(**opened.set_key._asdict(), due_h=due_h, due_utc_ns=opened.due_utc_ns)

    def _restore_set_start(self, opened: OpenSet) -> OpenSet:
        """Return an open set whose start frame is corrupt with a due time and disabled positions.

        They come from its rows, else from the schedule and the state of the positions; without these the due
        time stays as it is. Positions with a measurement are never disabled.
        """
        index, unscheduled_index = opened.set_key
        rows = self._catalogue.rows(SetRow, **opened.set_key._asdict())
        planned_set = [] if unscheduled_index else self._plan[index : index + 1]
        known = [row.due_utc_ns for row in rows] + [due.due_utc_ns for due in planned_set]
        struck = {item.key.position for item in (*opened.records, *opened.missed)}
        left_out = (
            dict.fromkeys(self._positions, "not asked for")
            if unscheduled_index
            else self._set_assessor.disabled()
        )
        return replace(
            opened,
            due_utc_ns=known[0] if known else opened.due_utc_ns,
            disabled={name: reason for name, reason in left_out.items() if name not in struck},
        )

    def _store_end_again(self, opened: OpenSet) -> None:
        """Store the end of a set again with its intact records; the stored end or a record is corrupt.

        Also lets the background tasks write its file. Raises ArchiveError if the disk refuses.
        """
        file = self._archive.sets().get(opened.set_key)
        if file is not None:
            record = self._archive.read_set(file, skip_damaged=True)
        else:
            taken, reason = self._restore_with_features(opened), self.corruption_of[opened.set_key]
            record = self._acquisition.record_of(self._build_due_set(opened), taken, reason)
        self._archive.resume_set(opened)
        self._archive.store_set(record)
        self._persistence.after_set(opened.set_key)

    def quarantine_corrupt_files(self) -> None:
        """Move corrupt files without rows to the quarantine, so that each set is due again, or missed.

        Reads every file without rows; logs an error for each corrupt one. Raises OtherExperimentError at a
        file of another test, ArchiveError if one cannot be read or moved.
        """
        for set_key, file in list(self._rowless_files.items()):
            try:
                reason = find_foreign_reason(self._archive.read_set(file), self._catalogue.read_experiment())
                raise_if_foreign([f"{file}: {reason}"] if reason else [], self._archive.name)
            except CorruptArchiveError as error:
                log.error("set %s is set aside: %s", set_key, error)
                self._archive.set_aside(file)
                del self._rowless_files[set_key]
                self.corruption_of[set_key] = f"its file was damaged and is set aside ({error})"

    def adopt(self, due: DueSet) -> int | None:
        """Queue the rows of a set whose recorder stopped after its file was complete, before the commit.

        The set is assessed again from its file, with a warning in the log.

        Returns
        -------
        int or None
            When its set ended (UTC in ns); None: the set has no such file.

        Raises
        ------
        ArchiveError
            The file cannot be read.
        """
        file = self._rowless_files.get(due.set_key)
        if file is None:
            return None
        record = self._archive.read_set(file)
        features = {shot.sequence: self._acquisition.features_of(shot) for shot in record.shots}
        sha256 = self._archive.digest(file)
        assess = partial(self._set_assessor.assessed, due, record, file, features, sha256=sha256)
        self._persistence.post(assess, self._set_assessor.commit)
        if sha256 is None:  # it is still in the journal
            self._persistence.do(partial(self._persistence.after_set, due.set_key))
        self._acquisition.advance_next_shot_number(record)
        log.warning("set %s: rows made again from %s/%s", due.set_key, self._archive.name, file)
        return record.ended_utc_ns


def restore_taken_set(opened: OpenSet, rule: RestrikeRule) -> TakenSet:
    """Restore the acquired part of a set from the journal, with its counts of repetitions by ``rule``.

    The features are added separately.
    """
    taken = TakenSet(
        rule=rule,
        disabled=dict(opened.disabled),
        missed=list(opened.missed),
        started_ns=opened.started_utc_ns,
        ended_ns=opened.last_utc_ns,
    )
    for record in opened.records:
        taken.keep(record)
    taken.restrikes.update(item.key.position for item in taken.tried if item.key.attempt > 0)
    return taken
