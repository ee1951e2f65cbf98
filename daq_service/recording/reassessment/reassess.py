"""Reassess a stored test from its files into a temporary catalogue; the folder is only read.

Sets and the actions of people follow in the order of their commits. Alarms are raised again; acknowledgements
and resets are repeated if the alarm is active at that time.
"""

from __future__ import annotations

import logging
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from analysis.waves.features import ALL_FEATURE_NAMES, ShotFeatures
from daq_service.acquisition.shot_features import FeaturesOf
from daq_service.alarms.operator_actions import AFTER_ACKNOWLEDGEMENT, acknowledge_alarm, reset_alarm
from daq_service.alarms.states import Change, Moment
from daq_service.archive import FolderSetReader, SetRecord, SetReference
from daq_service.assessment.baseline_lifecycle import STEPS, get_baseline_range
from daq_service.catalogue import Catalogue, RecorderCatalogue, SetCommit
from daq_service.catalogue.rows import (
    AlarmRow,
    BaselineRow,
    EventRow,
    ExperimentRow,
    FeatureRow,
    SetRow,
    ShotRow,
)
from daq_service.catalogue.store import create_temporary
from daq_service.recording.reassessment.changes import LIFE
from daq_service.recording.reassessment.stored_runs import Progress, full_row, group_sets, repeat_action
from daq_service.recording.set_assessor import SetAssessor
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import SetKey
from hardware_drivers.nanoseconds import NS_PER_H

FeaturesOfSet = Callable[[SetRecord], Mapping[int, ShotFeatures]]
"""Features of a set's shots by their sequence."""
ReadSet = Callable[[SetReference], SetRecord]


@contextmanager
def make_temp_catalogue(experiment: ExperimentRow) -> Iterator[RecorderCatalogue]:
    """Create a catalogue with only this experiment in a temporary folder; delete it after the block.

    Raises CatalogueError if it cannot be created.
    """
    with (
        tempfile.TemporaryDirectory(prefix="solimon-again-") as folder,
        create_temporary(Path(folder)) as catalogue,
    ):
        catalogue.restore_rows([experiment])
        yield catalogue


def read_stored_features(
    catalogue: Catalogue, features_of: FeaturesOf, record: SetRecord
) -> dict[int, ShotFeatures]:
    """Read the stored features of a set's shots by sequence; ``features_of`` gives those that lack."""
    places = {shot.key.position for shot in record.shots}
    flags = {
        row.sequence: tuple(row.flags)
        for place in places
        for row in catalogue.rows(ShotRow, position=place, **record.set_key._asdict())
    }
    found = {
        row.sequence: _to_shot_features(row, flags.get(row.sequence, ()))
        for row in catalogue.rows(FeatureRow, **record.set_key._asdict(), scope="shot")
        if row.sequence is not None
    }
    return {shot.sequence: found.get(shot.sequence) or features_of(shot) for shot in record.shots}


def _to_shot_features(row: FeatureRow, flags: tuple[str, ...]) -> ShotFeatures:
    """Convert a row of stored features to the form of extracted ones; a missing value becomes NaN."""
    known = {name: getattr(row, name) for name in ALL_FEATURE_NAMES}
    values: dict[str, Any] = {name: math.nan if value is None else value for name, value in known.items()}
    return ShotFeatures(**values, flags=flags, valid=bool(row.n_valid), quality=row.quality, compared=True)


def reassess(
    stored: Catalogue,
    again: RecorderCatalogue,
    folder: Path,
    settings: Settings,
    features: FeaturesOfSet,
    *,
    up_to_set: int | None = None,
    read_set: ReadSet | None = None,
    progress: Progress = lambda done, total: None,
) -> set[int]:
    """Reassess the sets of a folder in their order; the results are stored in ``again``.

    Actions of people are repeated between the sets.

    Parameters
    ----------
    again
        Catalogue with only the experiment.
    settings
        Settings of the assessment, which may differ from the test's own.
    features
        Returns the features of a record's shots by sequence.
    up_to_set
        The last set that is assessed; None: all.
    read_set
        Reads a set's record; None: as it is stored.
    progress
        Called with the sets that are done and their number.

    Returns
    -------
    set of int
        Indices of the assessed scheduled sets.

    Raises
    ------
    ArchiveError
        A set cannot be read, or not wholly.
    """
    archive = FolderSetReader(folder)
    return _Reassessment(stored, again, archive, settings, features, read_set or archive.read_set).run(
        up_to_set, progress
    )


class _Reassessment:
    """Reassesses the sets of a test into another catalogue."""

    def __init__(
        self,
        stored: Catalogue,
        again: RecorderCatalogue,
        archive: FolderSetReader,
        settings: Settings,
        features: FeaturesOfSet,
        read_set: ReadSet,
    ) -> None:
        """Create the assessor for the other catalogue, without a rig; its alarms are not printed."""
        self._stored, self._again, self._settings = stored, again, settings
        self._features, self._read_set = features, read_set
        self._epoch_utc_ns = stored.read_experiment().epoch_utc_ns
        self._assessor = SetAssessor(settings, archive, again, None, rehearsal=settings.rig.dry_run)
        # Alarms of this assessment are not reported.
        logging.getLogger(SetAssessor.__module__).addHandler(logging.NullHandler())

    def run(self, up_to_set: int | None, progress: Progress) -> set[int]:
        """Reassess the sets and repeat actions of people in the order of events, up to a set (None: all).

        Returns the indices of the reassessed scheduled sets. Raises ArchiveError for a set that cannot be
        read.
        """
        events = self._stored.rows(EventRow, topics=("sets", "alarms", "assessments"))
        last = None if up_to_set is None else SetKey(up_to_set)
        keys = {event.set_key for event in events if event.topic == "sets"}
        total = sum(key is not None and (last is None or key <= last) for key in keys)
        done: set[SetKey] = set()
        for set_key, run in group_sets(events):
            if set_key is None:
                for event in run:
                    self._repeat_action(event)
            elif (last is None or set_key <= last) and any(event.topic == "sets" for event in run):
                self._assess_set(set_key)
                done.add(set_key)
                progress(len(done), total)
                if set_key == last:
                    break
        return {key.set_index for key in done if not key.unscheduled_index}

    def _assess_set(self, set_key: SetKey) -> None:
        """Assess a set from its file or, without one, its rows, and commit the results.

        A confirmation set of a position that the settings lack is left out. Raises errors of ``read_set``.
        """
        rows = self._stored.rows(SetRow, **set_key._asdict())
        file = next((row.file for row in rows if row.file), None)
        if file is None:
            self._store_set_without_records(rows)
            return
        record = self._read_set(SetReference(file))
        due = record.due
        if due.position in (None, *self._settings.positions):
            self._assessor.commit(self._assessor.assessed(due, record, file, self._features(record)))

    def _store_set_without_records(self, rows: list[SetRow]) -> None:
        """Store the rows of a set without records under new ids.

        Missed strikes of a scheduled set may raise alarms, which are stored, too.
        """
        self._assessor.commit(SetCommit(sets=[replace(row, id=None) for row in rows]))
        for row in rows:
            if row.purpose is None and row.state != "disabled" and row.n_missed:
                utc_ns = row.ended_utc_ns or row.due_utc_ns
                moment = Moment(utc_ns=utc_ns, due_h=row.due_h, set_index=row.set_index)
                for condition in self._assessor.apply_stored_row(row):
                    self._assessor.update_alarm(condition, moment)

    def _repeat_action(self, event: EventRow) -> None:
        """Repeat a person's action on a baseline, an alarm or a transducer; ignore other events."""
        if event.kind in STEPS:
            self._repeat_baseline_action(full_row(BaselineRow, event))
        else:
            self._repeat_alarm_action(event)
        repeat_action(event, self._assessor.assessors, self._settings.positions)

    def _repeat_baseline_action(self, stored: BaselineRow) -> None:
        """Repeat a person's action on a baseline: copy its state, not its numbers, which this assessment has.

        A baseline that is not there is added as a new one, with as many sets as these settings require.
        """
        rows = {row.id: row for row in self._again.rows(BaselineRow, position=stored.position)}
        if (present := rows.get(stored.id)) is not None:
            step = {name: getattr(stored, name) for name in LIFE}
            self._again.restore_rows([replace(present, **step)])
        else:  # a successor that begins: as many sets as a baseline has by these settings
            baseline_plan = get_baseline_range(
                stored.position, self._settings, self._again.baseline(stored.position)
            )
            last_set = stored.first_set_index + baseline_plan.last_set - baseline_plan.first_set
            self._again.restore_rows([replace(stored, last_set_index=last_set)])

    def _repeat_alarm_action(self, event: EventRow) -> None:
        """Repeat a person's acknowledgement or reset of an alarm, if the alarm is active in this assessment.

        An alarm that a command or an instrument raised is raised again; other events are ignored.
        """
        if event.topic != "alarms" or "kind" not in event.payload:
            return
        kind = event.payload["kind"]
        row = self._assessor.alarms.get((event.position, kind))
        due_h = (event.utc_ns - self._epoch_utc_ns) / NS_PER_H
        moment = Moment(utc_ns=event.utc_ns, due_h=due_h, set_index=None)
        author = event.payload.get("author") or event.payload.get("acknowledged_by") or ""
        note = event.payload.get("note") or ""
        change = None
        if event.kind == "alarm_raised":  # by a person's command, or not from records
            change = Change(row=replace(full_row(AlarmRow, event), id=None), event_kind=event.kind)
        elif row is not None and event.kind == "alarm_acknowledged" and row.state in AFTER_ACKNOWLEDGEMENT:
            change = acknowledge_alarm(row, author, note, moment)
        elif row is not None and event.kind == "alarm_reset" and row.state != "normal":
            change = reset_alarm(row, author, note, moment)
        if change is not None:
            transaction = SetCommit()
            transaction.add_alarm(change.row, change.event(moment))
            self._assessor.commit(transaction)
