"""``repair``: unambiguous repairs; only unfinished files are deleted."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from daq_service.archive import Results, SetReference
from daq_service.archive.finalize_set import finalize_set
from daq_service.archive.journal.checking import check_journal
from daq_service.archive.journal.reader import JournaledSet
from daq_service.archive.records import SETS_FOLDER, TEMPORARY_SUFFIX, to_references
from daq_service.archive.verification import check_set_file
from daq_service.archive.writer import move_to_quarantine
from daq_service.assessment.results_in_file import read_set_results
from daq_service.catalogue import open_catalogue
from daq_service.catalogue.errors import CatalogueError
from daq_service.catalogue.verification import UnchangedCatalogue
from daq_service.cli.maintenance.rows import RowsOfSet, find_row_differences
from daq_service.cli.maintenance.verify import TABLES, Report, find_stored_sha256
from daq_service.shared_file import read_shared, remove_quietly, write_durably
from hardware_drivers.measurement import SetKey

log = logging.getLogger(__name__)

OF_A_FILE = ("set_missing", "set_unreadable", "set_touched", "shot", "metadata")
"""Kinds of damage that another copy of a set's file heals."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """Step to repair one file.

    Attributes
    ----------
    does
        ``remove``, ``from_journal``, ``from_backup``, ``set_aside``; ``nothing``: a person has to decide.
    reason
        The reason, or what a person can do.
    """

    does: str
    file: str
    reason: str


def plan_repair(folder: Path, report: Report, backup: Path | None) -> list[Step]:
    """List the repair step for each corrupt file and for unfinished files; nothing is changed.

    Unfinished files come first, then the others by name. Raises OSError if the journal cannot be read.

    Parameters
    ----------
    report
        Of `verify_folder`, a moment before.
    backup
        A folder that `solimon backup` made; None: there is none.
    """
    journal = check_journal(folder).sets
    damaged = {finding.file: finding for finding in reversed(report.damage)}
    steps = [
        _plan_file_repair(folder, SetReference(file), journal, backup)
        if finding.kind in OF_A_FILE
        else Step(does="nothing", file=file, reason=finding.description)
        for file, finding in damaged.items()
    ]
    left_over = [
        Step(does="remove", file=f"{SETS_FOLDER}/{path.name}", reason="it was never finished")
        for path in sorted((folder / SETS_FOLDER).glob(f"*{TEMPORARY_SUFFIX}"))
    ]
    return [*left_over, *sorted(steps, key=lambda step: step.file)]


def _plan_file_repair(
    folder: Path, file: SetReference, journal: Mapping[SetKey, JournaledSet], backup: Path | None
) -> Step:
    """Choose the repair step for a corrupt or missing file of a set.

    In this order: the journal; the backup if one is given; without a backup, quarantine if the set has no
    rows. Otherwise the step is "nothing".
    """
    ((set_key, _),) = to_references([Path(file).name]).items()
    journaled = journal.get(set_key)
    if journaled is not None and journaled.is_whole and journaled.reference == file:
        return Step(does="from_journal", file=file, reason="the journal still has every record of the set")
    rows = _read_rows_of_set(folder, set_key)
    if backup is not None:
        objection = _find_backup_objection(backup, file, rows)
        if not objection:
            return Step(
                does="from_backup", file=file, reason=f"{backup / file} is complete and agrees with the rows"
            )
        return Step(does="nothing", file=file, reason=f"the backup does not help: {objection}")
    if rows is not None and not rows.sets:
        return Step(does="set_aside", file=file, reason="it has no rows: its set is taken again, or missed")
    return Step(
        does="nothing",
        file=file,
        reason="what of it can be read stays readable; only a backup has the rest: --from BACKUP",
    )


def _read_rows_of_set(folder: Path, set_key: SetKey) -> RowsOfSet | None:
    """Read the rows of a set in all tables; None if the catalogue is unreadable."""
    try:
        with UnchangedCatalogue(folder) as catalogue:
            return RowsOfSet(**{table: catalogue.of_set(table, set_key) for table in TABLES})
    except CatalogueError:  # reported as a separate finding
        return None


def _read_results_of_set(folder: Path, set_key: SetKey) -> Results:
    """Read a set's results for its file; empty, with a logged warning, if the catalogue is unreadable."""
    try:
        with open_catalogue(folder) as catalogue:
            return read_set_results(catalogue, set_key)
    except CatalogueError as error:
        log.warning("set %s gets a file without its results: %s", set_key, error)
        return {}


def _find_backup_objection(backup: Path, file: SetReference, rows: RowsOfSet | None) -> str:
    """Return why a backup's file cannot replace the lost one; empty if it is intact and fits the rows."""
    if not (backup / file).is_file():
        return f"{backup / file} is not there"
    if rows is None:
        return "there are no rows to compare it with; repair the catalogue first"
    found = check_set_file(backup / file, sha256=find_stored_sha256(rows.sets, file))
    if found.touched or found.damages or found.record is None:
        return f"{backup / file} is damaged, too"
    against = list(find_row_differences(rows, found.record, file, frozenset())) if rows.sets else []
    return f"{backup / file} differs from the rows: {against[0][1]}" if against else ""


def execute_repair_step(folder: Path, step: Step, backup: Path | None) -> None:
    """Execute one repair step; the caller holds the lock of the folder.

    A file that is replaced moves to the quarantine; only unfinished ones are deleted.

    Raises
    ------
    OSError, ArchiveError
        The step failed; every file is as it was or in the quarantine.
    """
    path, file = folder / step.file, SetReference(step.file)
    if step.does == "remove":
        remove_quietly(path)
    elif step.does != "nothing" and path.exists():
        move_to_quarantine(folder, file)
    if step.does == "from_journal":
        ((set_key, _),) = to_references([path.name]).items()
        finalize_set(folder, set_key, results=_read_results_of_set(folder, set_key))
    elif step.does == "from_backup":
        assert backup is not None, "a plan with a backup's file has a backup"
        path.parent.mkdir(exist_ok=True)
        write_durably(path, read_shared(backup / file), temporary=path.with_suffix(TEMPORARY_SUFFIX))
