"""Read the data of an acceptance report from a data folder, also while a recorder runs."""

from __future__ import annotations

import logging
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq_service.acquisition.schedule import plan_sets
from daq_service.archive import ArchiveError, FolderSetReader
from daq_service.catalogue import Catalogue, open_catalogue
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.errors import CatalogueError
from daq_service.catalogue.rows import AlarmRow, EventRow, ExperimentRow, SetRow, ShotRow
from daq_service.catalogue.verification import UnchangedCatalogue
from daq_service.cli.forecast import predict_set_file_bytes
from daq_service.cli.maintenance.verify import Report
from daq_service.processes.data_folder import BACKUP_FILE
from daq_service.processes.heartbeat import compute_test_time_ns
from daq_service.processes.recorder_state import FAREWELLS, RecorderState, read_recorder_state
from daq_service.settings.stored import restore_settings
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import DueSet
from hardware_drivers.nanoseconds import NS_PER_H

log = logging.getLogger(__name__)

SHOTS_AT_ONCE = 20_000
"""Maximum number of rows in memory."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """Data of a test for its acceptance report.

    Attributes
    ----------
    planned
        Every set of the schedule; ``due`` of them should have their rows by now.
    accepted
        Records by set and position; of a shot that was struck again one counts.
    flags
        Records by what they are flagged with, repeated ones too.
    service, machine, alarm_events
        Events of these topics.
    provenance
        Of the newest set that can be read; empty: there is none.
    file_bytes
        Size of each set's file, by set index.
    forecast_bytes
        Size of a whole set's file as `check-config` foretells it.
    is_copy
        A backup: nothing will follow in it.
    verified
        What `solimon verify` found just now; None: it was not asked.
    """

    folder: Path
    experiment: ExperimentRow
    settings: Settings
    planned: Sequence[DueSet]
    due: int
    sets: Sequence[SetRow]
    accepted: Mapping[tuple[int, str], int]
    flags: Mapping[str, int]
    service: Sequence[EventRow]
    machine: Sequence[EventRow]
    alarm_events: Sequence[EventRow]
    alarms: Sequence[AlarmRow]
    provenance: Mapping[str, Any]
    file_bytes: Mapping[int, int]
    forecast_bytes: float
    recorder: RecorderState
    is_copy: bool
    now_ns: int
    verified: Report | None = None

    def hour(self, utc_ns: int) -> float:
        """Convert a UTC time in ns to hours of the test, since its hour 0."""
        return (utc_ns - self.experiment.epoch_utc_ns) / NS_PER_H


def read_evidence(folder: Path, verified: Report | None = None) -> Evidence:
    """Read the data of the acceptance report from a folder without changing it.

    Blocks while the catalogue is copied to a temporary folder; the test may be running. ``verified`` is the
    report of `verify`; None if it was not run.

    Raises
    ------
    NoDataYetError
        No test has started here.
    CatalogueError
        The catalogue is damaged, or a newer version's.
    ValidationError
        This version knows no such configuration.
    """
    with _open_catalogue_copy(folder) as catalogue:
        experiment = catalogue.read_experiment()
        sets = catalogue.rows(SetRow)
        service = catalogue.rows(EventRow, topic="service")
        machine = catalogue.rows(EventRow, topic="machine")
        alarm_events = catalogue.rows(EventRow, topic="alarms")
        alarms = catalogue.rows(AlarmRow)
        accepted, flags = _count_records(catalogue)
    settings = restore_settings(experiment.configuration)
    recorder = read_recorder_state(folder, [row.kind for row in service])
    is_copy = (folder / BACKUP_FILE).exists()
    now_ns = _compute_evaluation_time_ns(
        experiment, sets, service, recorder, ended=is_copy or recorder.status in _ENDED
    )
    planned = plan_sets(settings.schedule.phases, experiment.epoch_utc_ns, end_h=settings.schedule.end_h)
    return Evidence(
        folder=folder,
        experiment=experiment,
        settings=settings,
        planned=planned,
        due=_count_due_sets(planned, sets, now_ns),
        sets=sets,
        accepted=accepted,
        flags=flags,
        service=service,
        machine=machine,
        alarm_events=alarm_events,
        alarms=alarms,
        provenance=_read_provenance(folder),
        file_bytes=_read_file_sizes(folder, sets),
        forecast_bytes=predict_set_file_bytes(settings),
        recorder=recorder,
        is_copy=is_copy,
        now_ns=now_ns,
        verified=verified,
    )


_ENDED = tuple(word for word, _ in FAREWELLS.values())


@contextmanager
def _open_catalogue_copy(folder: Path) -> Iterator[Catalogue]:
    """Open a temporary copy of the catalogue in one state; an older version is migrated in the copy only.

    The copy is deleted at the end. Raises CatalogueError, which names the folder, if it cannot be opened.
    """
    with tempfile.TemporaryDirectory(prefix="solimon-") as path:
        with UnchangedCatalogue(folder) as source:
            source.copy_to(Path(path) / FILE_NAME)
        try:
            catalogue = open_catalogue(Path(path), writer=True)
        except CatalogueError as error:
            raise type(error)(str(error).replace(path, str(folder))) from error
        with catalogue:
            yield catalogue


def _count_records(catalogue: Catalogue) -> tuple[Counter[tuple[int, str]], Counter[str]]:
    """Count the accepted records by set and position, and the quality flags of all records.

    Reads `SHOTS_AT_ONCE` rows at a time.
    """
    accepted, flags, last = Counter[tuple[int, str]](), Counter[str](), 0
    while rows := catalogue.rows(ShotRow, after_id=last, limit=SHOTS_AT_ONCE):
        accepted.update((row.set_index, row.position) for row in rows if row.outcome == "accepted")
        flags.update(flag for row in rows for flag in row.flags)
        last = rows[-1].sequence
    return accepted, flags


def _compute_evaluation_time_ns(
    experiment: ExperimentRow,
    sets: Sequence[SetRow],
    service: Sequence[EventRow],
    recorder: RecorderState,
    *,
    ended: bool,
) -> int:
    """Return the UTC time in ns until which sets are due.

    For an ended or simulated test that is its last event (``service``) or set, otherwise the present time of
    the test.
    """
    last = max([experiment.epoch_utc_ns, *(row.utc_ns for row in service), *(row.due_utc_ns for row in sets)])
    if ended or experiment.clock != "wall":
        return last
    return max(last, compute_test_time_ns(recorder.beat) or time.time_ns())


def _count_due_sets(planned: Sequence[DueSet], sets: Sequence[SetRow], now_ns: int) -> int:
    """Count the sets that should have rows by now.

    A set is due when its successor was due by ``now_ns`` (UTC), or when it or a later set has rows.
    """
    n_with_rows = max((row.set_index + 1 for row in sets), default=0)
    n_ended = sum(following.due_utc_ns <= now_ns for following in planned[1:])
    return max(n_with_rows, n_ended)


def _read_provenance(folder: Path) -> Mapping[str, object]:
    """Read the provenance of the newest readable set; empty if there is none. Unreadable ones are logged."""
    reader = FolderSetReader(folder)
    for reference in list(reader.sets().values())[::-1]:
        try:
            return reader.read_set(reference, skip_damaged=True).provenance
        except ArchiveError as error:
            log.warning("%s", error)
    return {}


def _read_file_sizes(folder: Path, sets: Sequence[SetRow]) -> dict[int, int]:
    """Return the sizes in bytes of existing files by set index; a set still in the journal has no file."""
    sizes = {}
    for row in sets:
        if row.file is not None and row.set_index not in sizes:
            try:
                sizes[row.set_index] = (folder / row.file).stat().st_size
            except OSError as error:
                log.debug("%s has no size: %s", row.file, error)
    return sizes
