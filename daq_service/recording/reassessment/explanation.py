"""Recompute an alarm from the records of its position and compare it with the stored one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from analysis.ultrasound.thickness import EXTRACTOR_VERSION as ECHO_EXTRACTOR_VERSION
from analysis.waves.features import EXTRACTOR_VERSION
from analysis.waves.quality_gate import ACCEPTED
from daq_service.acquisition.shot_features import choose_extraction
from daq_service.archive import CorruptArchiveError, FolderSetReader, SetRecord, SetReference
from daq_service.assessment.methods import METHODS, MeasuringMethod
from daq_service.catalogue import Catalogue, open_catalogue
from daq_service.catalogue.reader import Filters
from daq_service.catalogue.rows import (
    AlarmRow,
    AssessmentRow,
    BaselineRow,
    EventRow,
    ExperimentRow,
    FeatureRow,
    Row,
    SetRow,
    ShotRow,
    ThicknessRow,
    WallRow,
)
from daq_service.errors import UsageError
from daq_service.processes.data_folder import require_data_folder
from daq_service.recording.reassessment.changes import (
    ASSESSED,
    EXTRACTED,
    NOT_COMPARED,
    Difference,
    Onset,
    compare_rows,
    find_differing_columns,
    list_onsets,
)
from daq_service.recording.reassessment.pulses_of_sets import Pulses, read_mean_pulses
from daq_service.recording.reassessment.reassess import make_temp_catalogue, reassess
from daq_service.recording.reassessment.stored_runs import Progress
from daq_service.settings.stored import restore_settings
from daq_service.settings.tree import Settings
from hardware_drivers.methods import SOLITARY_WAVE, Method

EXTRACTORS: Mapping[type[Row], str] = {
    FeatureRow: EXTRACTOR_VERSION,
    ThicknessRow: ECHO_EXTRACTOR_VERSION,
}
"""This version's extractor of each kind of result."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recomputed:
    """Reassessment of the records of the alarm's position up to the set that raised it.

    Attributes
    ----------
    n_sets, n_records
         Numbers of sets and records that were read.
    raised
        Onsets of alarms of this kind there.
    differences
        Differences from the stored values; empty if none.
    baseline
        None where there is none.
    measured
        Features or thickness of the sets.
    silent
        Shots without a reflected wave, by set.
    pulses
        Waves of the set that raised it and of the baseline; None if there are none.
    """

    n_sets: int
    n_records: int
    raised: Sequence[Onset]
    differences: Sequence[Difference]
    baseline: BaselineRow | None
    assessments: Sequence[AssessmentRow]
    measured: Sequence[FeatureRow | ThicknessRow | WallRow]
    sets: Sequence[SetRow]
    silent: Mapping[int, int]
    pulses: Pulses | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Explained:
    """An alarm with its evidence.

    Attributes
    ----------
    history
        Its events.
    again
        None if it does not follow from records; ``why_not`` is the reason.
    """

    experiment: ExperimentRow
    settings: Settings
    alarm: AlarmRow
    history: Sequence[EventRow]
    again: Recomputed | None
    why_not: str

    @property
    def agrees(self) -> bool | None:
        """Return whether no recomputed value differs; None if the alarm does not follow from records."""
        return None if self.again is None else not self.again.differences


def explain_alarm(folder: Path, alarm_id: int, progress: Progress = lambda done, total: None) -> Explained:
    """Recompute an alarm of a stored or running test from its records; the folder is only read.

    ``progress`` is called with the sets that are done and their number. Blocks until all are read.

    Raises
    ------
    UsageError
        There is no such alarm, or its results are of another version's extractor.
    StorageError
        There is no test, or a set that counts cannot be read.
    """
    require_data_folder(folder)
    with open_catalogue(folder) as stored:
        alarm = stored.alarm(alarm_id)
        if alarm is None:
            raise UsageError(_describe_unknown_alarm(alarm_id, stored.rows(AlarmRow)))
        experiment = stored.read_experiment()
        settings = restore_settings(experiment.configuration)
        history = [
            event
            for event in stored.rows(EventRow, topic="alarms")
            if event.payload.get("alarm_id") == alarm_id
        ]
        why_not, again = _find_no_records_reason(alarm), None
        if not why_not:
            again = _recompute_alarm(stored, folder, settings, alarm, history, progress)
        return Explained(
            experiment=experiment,
            settings=settings,
            alarm=alarm,
            history=history,
            again=again,
            why_not=why_not,
        )


def _describe_unknown_alarm(alarm_id: int, alarms: Sequence[AlarmRow]) -> str:
    """Format the message for an unknown alarm, with id, kind and position of each alarm that exists."""
    alarm_texts = [f"{row.id} ({row.kind}{f' at {row.position}' if row.position else ''})" for row in alarms]
    available = f"there are {', '.join(alarm_texts)}" if alarm_texts else "none was raised in this test"
    return f"there is no alarm {alarm_id}; {available}"


def _find_no_records_reason(alarm: AlarmRow) -> str:
    """Return why an alarm does not follow from the records of a position, as a text; empty if it does."""
    if alarm.position is None:
        return "it is about the complete test, not about the waveforms of a position"
    if alarm.raised_set_index is None:
        return "no set raised it, but a person's command or an instrument"
    return ""


def _recompute_alarm(
    stored: Catalogue,
    folder: Path,
    settings: Settings,
    alarm: AlarmRow,
    history: Sequence[EventRow],
    progress: Progress,
) -> Recomputed:
    """Reassess the position of an alarm up to its set, in a temporary catalogue, and compare the results.

    ``history`` has the alarm's events. Raises UsageError for results of another extractor, StorageError for a
    set that cannot be read.
    """
    position, up_to_set = alarm.position, alarm.raised_set_index
    assert position is not None and up_to_set is not None, "it follows from records"  # noqa: PT018
    _raise_if_other_extractor(stored, settings.positions[position].method, position, up_to_set)
    archive = FolderSetReader(folder)
    features_of = choose_extraction(settings.positions, rehearsal=settings.rig.dry_run)
    read_set = partial(_read_position_records, position, archive)
    with ExitStack() as stack:
        again = stack.enter_context(make_temp_catalogue(stored.read_experiment()))
        reassess(
            stored,
            again,
            folder,
            settings,
            lambda record: {shot.sequence: features_of(shot) for shot in record.shots},
            up_to_set=up_to_set,
            read_set=read_set,
            progress=progress,
        )
        baseline = again.baseline(position)
        shots = again.rows(ShotRow, position=position)
        raised = [one for one in list_onsets(again) if (one.position, one.kind) == (position, alarm.kind)]
        method = METHODS[settings.positions[position].method]
        found = [
            *_compare_alarm(alarm, history, again),
            *compare_rows((*EXTRACTED, *ASSESSED), stored, again, position=position, up_to_set=up_to_set),
        ]
        pulses = None
        if settings.positions[position].method == SOLITARY_WAVE and not settings.rig.dry_run:
            pulses = read_mean_pulses(again, read_set, baseline, position, up_to_set)
        return Recomputed(
            n_sets=len({shot.set_index for shot in shots}),
            n_records=len(shots),
            raised=raised,
            differences=found,
            baseline=baseline,
            assessments=again.rows(AssessmentRow, position=position),
            measured=_read_set_results(again, method, position, alarm.kind),
            sets=again.rows(SetRow, position=position),
            silent=_count_silent_shots(shots),
            pulses=pulses,
        )


def _raise_if_other_extractor(stored: Catalogue, method: Method, position: str, up_to_set: int) -> None:
    """Raise UsageError if results at a position, up to the set, are of another version's extractor."""
    kind = METHODS[method].row
    columns = stored.columns(kind, ("extractor_version",), position=position, last_set=up_to_set)
    if others := sorted(set(columns["extractor_version"]) - {EXTRACTORS[kind]}):
        raise UsageError(
            f"the results at {position} are of the extractor {' and '.join(others)}, this version of solimon "
            f"has {EXTRACTORS[kind]}: their numbers are different quantities. Explain the alarm with solimon "
            f"{stored.read_experiment().solimon_version}, which started the test, or reassess the test by "
            "this version with solimon replay --extract"
        )


def _read_position_records(position: str, archive: FolderSetReader, reference: SetReference) -> SetRecord:
    """Read a set and keep the records of one position; if it has none there, keep the complete set.

    Corruption of other positions is ignored; that of the position or the set raises CorruptArchiveError.
    """
    try:
        record = archive.read_set(reference)
    except CorruptArchiveError:
        # What other positions lost is no evidence here.
        if any(damage.position in (None, position) for damage in archive.verify_set(reference)):
            raise
        record = archive.read_set(reference, skip_damaged=True)
    shots = [shot for shot in record.shots if shot.key.position == position]
    echoes = [echo for echo in record.echoes if echo.key.position == position]
    if not (shots or echoes):
        return record
    return replace(
        record,
        positions=[place for place in record.positions if place.position == position],
        shots=shots,
        echoes=echoes,
        missed=[item for item in record.missed if item.key.position == position],
    )


def _compare_alarm(alarm: AlarmRow, history: Sequence[EventRow], again: Catalogue) -> list[Difference]:
    """Compare the stored alarm, as it was raised, with the recomputed one of the same set.

    Returns a difference per column, one named ``row`` if either is missing; empty if they agree.
    """
    stored_alarm = next((event.payload for event in history if event.kind == "alarm_raised"), None)
    new_alarm: Mapping[str, Any] | None = next(
        (
            event.payload
            for event in again.rows(EventRow, topic="alarms", kind="alarm_raised", position=alarm.position)
            if (event.payload["kind"], event.set_index) == (alarm.kind, alarm.raised_set_index)
        ),
        None,
    )
    if stored_alarm is not None and new_alarm is not None:
        of_raising = stored_alarm.keys() & new_alarm.keys() - NOT_COMPARED - {"alarm_id"} - _SUPPRESSION
        stored_alarm, new_alarm = (
            {name: row[name] for name in sorted(of_raising)} for row in (stored_alarm, new_alarm)
        )
    assert alarm.position is not None and alarm.raised_set_index is not None, "it follows from records"  # noqa: PT018
    return [
        Difference(
            table="alarm",
            position=alarm.position,
            column=name,
            n_rows=1,
            first_set_index=alarm.raised_set_index,
            stored=left,
            again=right,
        )
        for name, left, right in find_differing_columns(stored_alarm, new_alarm)
    ]


_SUPPRESSION = frozenset(name for name in AlarmRow.__slots__ if name.startswith(("suppressed", "shelved")))
"""Columns that a person filled for an earlier alarm of this kind."""


def _read_set_results(
    catalogue: Catalogue, method: MeasuringMethod, position: str, alarm_kind: str
) -> Sequence[FeatureRow | ThicknessRow | WallRow]:
    """Read the results of all scheduled sets of a position in order, without those of single shots.

    For an alarm of a transducer's wall thickness, that is this thickness.
    """
    if alarm_kind == "thickness_low" and method.row is FeatureRow:
        return catalogue.rows(WallRow, position=position)
    of_place: Filters = {**method.of_sets, "position": position}
    return catalogue.rows(method.row, **of_place)


def _count_silent_shots(shots: Sequence[ShotRow]) -> dict[int, int]:
    """Count the accepted shots without reflected wave (flag ``no_psw``) by set index.

    A set with shots whose waves all have one counts 0; sets without shots are omitted.
    """
    counts: dict[int, int] = {}
    for shot in shots:
        silent = shot.outcome == ACCEPTED and "no_psw" in shot.flags
        counts[shot.set_index] = counts.get(shot.set_index, 0) + silent
    return counts
