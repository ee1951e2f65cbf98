"""Reassess a stored test with other settings, and compare the results with the stored ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from analysis.waves.features import EXTRACTOR_VERSION
from daq_service.acquisition.shot_features import choose_extraction
from daq_service.archive import FolderSetReader
from daq_service.assessment.baseline_lifecycle import get_baseline_range
from daq_service.catalogue import Catalogue, open_catalogue
from daq_service.catalogue.rows import AssessmentRow, FeatureRow
from daq_service.errors import UsageError
from daq_service.processes.data_folder import require_data_folder
from daq_service.processes.executors import count_workers, open_executor
from daq_service.recording.reassessment.changes import (
    ASSESSED,
    EXTRACTED,
    AlarmChanges,
    Difference,
    compare_alarm_onsets,
    compare_rows,
    list_onsets,
)
from daq_service.recording.reassessment.features_ahead import ExtractedAhead
from daq_service.recording.reassessment.other_settings import apply_setting_changes, parse_assignments
from daq_service.recording.reassessment.reassess import make_temp_catalogue, read_stored_features, reassess
from daq_service.recording.reassessment.stored_runs import Progress
from daq_service.settings.tree import Settings
from hardware_drivers.methods import SOLITARY_WAVE


@dataclass(frozen=True, slots=True, kw_only=True)
class NotAssessed:
    """All sets of a position belong to its baseline, or to one that is never complete.

    Attributes
    ----------
    first_set_index, last_set_index
        Sets that the baseline takes.
    last_set
        The position's last one.
    description
         Message with the remedy.
    """

    position: str
    first_set_index: int
    last_set_index: int
    last_set: int
    description: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Replayed:
    """Result of a reassessment with other settings.

    Attributes
    ----------
    extractor_version
        Extractor of the assessed features.
    """

    experiment: str
    changed: Mapping[str, Any]
    extracted: bool
    extractor_version: str
    sets: int
    not_assessed: list[NotAssessed]
    alarms: AlarmChanges
    differences: list[Difference]


def replay_test(
    folder: Path,
    given: Iterable[str],
    *,
    extract_by: tuple[str, int] | None = None,
    progress: Progress = lambda done, total: None,
) -> Replayed:
    """Reassess a stored test with changed settings; return the differences to the stored results.

    Blocks until all sets are assessed; the folder is only read.

    Parameters
    ----------
    given
        ``KEY=VALUE`` each; without any the test's own settings are used.
    extract_by
        Executor and number of workers that take the features from the waveforms again; None: the stored ones.
    progress
        Called with the sets that are done and their number.

    Raises
    ------
    UsageError
        A setting is invalid or does not concern the assessment, or stored features differ in extractor.
    StorageError
        There is no test, or a set of it cannot be read.
    """
    settings_given = parse_assignments(tuple(given))
    require_data_folder(folder)
    with ExitStack() as stack:
        stored = stack.enter_context(open_catalogue(folder))
        experiment = stored.read_experiment()
        settings = apply_setting_changes(experiment.configuration, settings_given)
        again = stack.enter_context(make_temp_catalogue(experiment))
        assess_set = partial(reassess, stored, again, folder, settings, progress=progress)
        features_of = choose_extraction(settings.positions, rehearsal=settings.rig.dry_run)
        if extract_by is None:
            versions = stored.columns(FeatureRow, ("extractor_version",))["extractor_version"]
            extractor = _find_common_extractor(versions)
            sets = assess_set(partial(read_stored_features, stored, features_of))
        else:
            extractor, (name, workers) = EXTRACTOR_VERSION, extract_by
            executor = stack.enter_context(open_executor(name, workers))
            archive = FolderSetReader(folder)
            files = archive.sets()
            ahead = ExtractedAhead(
                executor=executor,
                workers=count_workers(executor, workers),
                features_of=features_of,
                read=archive.read_set,
                references=iter(files.values()),
            )
            sets = assess_set(ahead.features, read_set=ahead.read_set)
        last = max(sets, default=None)
        return Replayed(
            experiment=experiment.name,
            changed={".".join(path): value for path, value in settings_given.items()},
            extracted=extract_by is not None,
            extractor_version=extractor,
            sets=len(sets),
            not_assessed=[
                one
                for name in settings.list_positions(SOLITARY_WAVE)
                for one in _describe_unassessed(name, again, settings)
            ],
            alarms=compare_alarm_onsets(list_onsets(stored, last), list_onsets(again, last)),
            differences=compare_rows(
                (*EXTRACTED, *ASSESSED) if extract_by else ASSESSED, stored, again, up_to_set=last
            ),
        )


def _describe_unassessed(position: str, recomputed: Catalogue, settings: Settings) -> Iterator[NotAssessed]:
    """Yield one message if all assessed sets of a position belong to its baseline, else nothing.

    No alarm would report this. A position without assessments yields nothing.
    """
    found = recomputed.columns(AssessmentRow, ("set_index", "in_baseline"), position=position)
    if not all(found["in_baseline"]) or not found["set_index"]:
        return
    sets, last_set = (
        get_baseline_range(position, settings, recomputed.baseline(position)),
        max(found["set_index"]),
    )
    yield NotAssessed(
        position=position,
        first_set_index=sets.first_set,
        last_set_index=sets.last_set,
        last_set=last_set,
        description=f"no set is assessed at {position}: baseline.hours = {settings.baseline.hours:g} makes "
        f"the sets {sets.first_set} to {sets.last_set} the baseline, and the last one there is set "
        f"{last_set}; give fewer hours",
    )


def _find_common_extractor(versions: Iterable[str]) -> str:
    """Return the one extractor version of stored features; this version's own if there are none.

    Raises UsageError for different extractors, whose features are different quantities.
    """
    found = sorted(set(versions))
    if len(found) > 1:
        raise UsageError(
            f"the stored features are of the extractors {' and '.join(found)}, which are different "
            "quantities; take them all from the waveforms with --extract"
        )
    return found[0] if found else EXTRACTOR_VERSION
