"""Which experiment a data folder holds: catalogue, experiment.json, history, files and journal must agree."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from daq_service.archive import ArchiveError, OpenSet, SetReader, SetRecord
from daq_service.catalogue.earlier_names import to_current_row
from daq_service.catalogue.errors import CatalogueDamagedError, OtherExperimentError
from daq_service.catalogue.experiment_file import (
    EXPERIMENT_FILE,
    HISTORY_FILE,
    raise_if_other_record,
    read_experiment_file,
)
from daq_service.catalogue.history import History
from daq_service.catalogue.rows import ExperimentRow
from daq_service.clock import format_utc
from hardware_drivers.measurement import DueSet
from hardware_drivers.nanoseconds import NS_PER_H

log = logging.getLogger(__name__)


def find_stored_experiment(folder: Path, history: History, archive: SetReader) -> ExperimentRow | None:
    """Find the experiment of a folder without a catalogue; return None for a new folder.

    The sources are experiment.json, else the history, else the first readable set. A damaged experiment.json
    is logged and ignored.

    Raises
    ------
    OtherExperimentError
        experiment.json and history name two experiments.
    CatalogueError, ArchiveError
        experiment.json or the archive cannot be read.
    """
    try:
        kept = read_experiment_file(folder)
    except CatalogueDamagedError as error:
        log.warning("%s", error)
        kept = None
    stored = history.experiment
    if kept is not None and stored is not None:
        raise_if_other_record(kept, stored, EXPERIMENT_FILE, HISTORY_FILE, folder)
    return kept or stored or _read_experiment_from_files(archive)


def _read_experiment_from_files(archive: SetReader) -> ExperimentRow | None:
    """Build the row of the experiment from the provenance of the first readable set; None if there is none.

    Unreadable sets are logged as warnings and skipped.
    """
    for reference in archive.sets().values():
        try:
            record = archive.read_set(reference, skip_damaged=True)
        except ArchiveError as error:
            log.warning("%s", error)
            continue
        stored = record.provenance
        configuration = stored.get("configuration")
        if not configuration or "configuration_hash" not in stored:
            continue
        identity = {name: stored.get("experiment", {}).get(name) for name in ("uuid", "site")}
        row = {
            "name": configuration["name"],
            "configuration_hash": stored["configuration_hash"],
            "configuration": configuration,
            "created_utc_ns": _read_hour_0(record),
            "epoch_utc_ns": _read_hour_0(record),
            "clock": configuration["clock"]["kind"],
            "solimon_version": stored["versions"]["solimon"],
            **{name: value for name, value in identity.items() if value is not None},
        }
        return ExperimentRow(**to_current_row("experiment", row))
    return None


def find_foreign_reason(record: SetRecord, experiment: ExperimentRow) -> str:
    """Return why a set is not of this test (another configuration or hour 0); empty if it is."""
    stored = record.provenance.get("configuration_hash", experiment.configuration_hash)
    if stored != experiment.configuration_hash:
        return f"configuration {stored} instead of {experiment.configuration_hash}"
    if _read_hour_0(record) != experiment.epoch_utc_ns:
        return (
            f"hour 0 at {format_utc(_read_hour_0(record))} instead of {format_utc(experiment.epoch_utc_ns)}"
        )
    return ""


def _read_hour_0(record: SetRecord) -> int:
    """Return hour 0 of a set's test in ns of UTC, from its provenance (since format 1.2) or its due time."""
    counted: int = record.due_utc_ns - round(record.due_h * NS_PER_H)
    return int(record.provenance.get("experiment", {}).get("epoch_utc_ns", counted))


def raise_if_foreign(found: Sequence[str], where: str) -> None:
    """Raise an error if there are sets of another experiment.

    Parameters
    ----------
    found
        Sets that are not of this experiment, each with the reason.
    where
        Name of the folder, for the message.

    Raises
    ------
    OtherExperimentError
        There are such sets; lists the first ten with both values.
    """
    if found:
        more = f"\n  and {len(found) - 10} more" if len(found) > 10 else ""
        raise OtherExperimentError(
            f"{where} holds sets of another experiment:\n"
            + "\n".join(f"  {line}" for line in found[:10])
            + f"{more}\nTake out what does not belong here, or choose another folder with --data-dir."
        )


def raise_if_foreign_open_set(opened: OpenSet, planned: Sequence[DueSet], where: str) -> None:
    """Raise an error for an open set that the schedule expects at another time: it is of another test.

    A set that is not ``planned`` passes. ``where`` names the folder.

    Raises
    ------
    OtherExperimentError
        Contains both times.
    """
    due = next((due.due_utc_ns for due in planned if due.set_key == opened.set_key), opened.due_utc_ns)
    if due != opened.due_utc_ns:
        stored = f"due at {format_utc(opened.due_utc_ns)} instead of {format_utc(due)}"
        raise_if_foreign([f"journal, set {opened.set_key}: {stored}"], where)
