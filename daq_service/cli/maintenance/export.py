"""``export --hdf5``: one file of a whole test; records stay in the sets' files, rows are copied."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from daq_service.archive import ArchiveError, FolderSetReader, SetNotFoundError, SetReference
from daq_service.archive.consolidated import (
    Block,
    Column,
    Columns,
    Facts,
    Sampling,
    build_consolidated_image,
    list_record_blocks,
    name_groups,
)
from daq_service.catalogue import Catalogue, open_catalogue
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.published_columns import choose_published_form
from daq_service.catalogue.rows import (
    AssessmentRow,
    FeatureRow,
    Row,
    SetRow,
    ShotRow,
    ThicknessRow,
    list_columns,
)
from daq_service.clock import format_utc
from daq_service.errors import StorageError, UsageError
from daq_service.processes.data_folder import OWN_NAMES
from daq_service.processes.lost_catalogue import describe_loss
from daq_service.shared_file import write_output
from daq_service.web.tables.formats import to_array
from hardware_drivers.measurement import SetKey
from hardware_drivers.methods import PULSE_ECHO

_SETS_AT_ONCE = 500
"""Rows of so many sets are held as objects."""
_OF_A_SHOT = ("set_index", "shot_index", "attempt", "utc_ns", "valid", "flags", "outcome")
_OF_A_SET = (
    *("due_h", "due_utc_ns", "state", "reason"),
    *("n_planned", "n_taken", "n_valid", "n_missed", "n_restrikes"),
)
_NO_RESULT = (
    "id",
    "set_index",
    "unscheduled_index",
    "position",
    "shot_index",
    "sequence",
    "due_h",
    "n_valid",
    "baseline_id",
)
"""Columns that results share with what they belong to."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """Result of an export.

    Attributes
    ----------
    sets, shots
        In it.
    arrays
        Records and samples of each group.
    waiting
        Sets that have no file yet: their recorder is about to make it.
    left_out
        Files that cannot be read, and why.
    """

    file: str
    n_bytes: int
    sets: int
    shots: int
    arrays: Mapping[str, tuple[int, int]]
    waiting: int
    left_out: Mapping[str, str]


def export_hdf5(
    folder: Path,
    target: Path,
    *,
    overwrite: bool = False,
    progress: Callable[[int, int], None] = lambda done, planned: None,
) -> Exported:
    """Write one HDF5 file of a test, also of one that runs.

    Unreadable sets and sets without a file are left out and listed in the result. ``progress`` receives the
    numbers of sets done and in all.

    Raises
    ------
    UsageError
        There is no test in the folder; the file exists, or would be among what is the test's own.
    StorageError
        No set has a file yet, or the catalogue cannot be read.
    StorageUnavailableError
        The disk does not take the file; one that was there stays.
    """
    refuse_unsafe_target(folder, target, overwrite=overwrite)
    with open_catalogue(folder) as catalogue:
        experiment = catalogue.read_experiment()
        positions = sorted(experiment.configuration["positions"])
        rows = {name: catalogue.rows(SetRow, position=name) for name in positions}
        files = {row.set_key: SetReference(row.file) for found in rows.values() for row in found if row.file}
        blocks, waiting, left_out = _list_record_blocks(folder, files, progress)
        if not blocks:
            raise StorageError(
                f"{folder}: no set has a file that can be read; wait for one, or solimon verify"
            )
        shots = {
            sampling: (found, _read_shot_columns(catalogue, sampling, found, rows.get(sampling.position, [])))
            for sampling, found in blocks.items()
        }
        facts = Facts(
            title=experiment.name,
            start_time=format_utc(experiment.epoch_utc_ns),
            maker_version=version("solimon"),
            version=experiment.solimon_version,
            configuration_hash=experiment.configuration_hash,
            provenance={"configuration": experiment.configuration, "epoch_utc_ns": experiment.epoch_utc_ns},
        )
        sets = {name: _read_set_columns(catalogue, name, found) for name, found in rows.items() if found}
    image = build_consolidated_image(target, folder, facts, shots, sets)
    write_output(target, image)
    return Exported(
        file=str(target),
        n_bytes=len(image),
        sets=len(files) - waiting - len(left_out),
        shots=sum(len(block.shot_ids) for found in blocks.values() for block in found),
        arrays={
            name: (sum(len(block.shot_ids) for block in blocks[sampling]), sampling.n_samples)
            for sampling, name in name_groups(blocks).items()
        },
        waiting=waiting,
        left_out=left_out,
    )


def refuse_unsafe_target(folder: Path, target: Path, *, overwrite: bool) -> None:
    """Raise an error for an output file that must not be written; the check changes nothing.

    Raises
    ------
    UsageError
        There is no test in the folder; the target's folder is missing; the target exists without
        ``overwrite`` or is no file, or would be among the test's own files.
    StorageError
        The test's catalogue is lost.
    """
    if not (folder / FILE_NAME).is_file():
        if reason := describe_loss(folder):
            raise StorageError(reason)
        raise UsageError(
            f"{folder} holds no test of solimon (no {FILE_NAME}); choose its folder with --data-dir"
        )
    if not target.parent.is_dir():
        raise UsageError(f"the folder {target.parent} is not there; make it, or choose another file")
    absolute, test_folder = target.absolute().parent.resolve() / target.name, folder.resolve()
    if absolute.is_relative_to(test_folder) and absolute.relative_to(test_folder).parts[0] in OWN_NAMES:
        raise UsageError(f"{target} lies among the test's own files; choose a place outside the data folder")
    if target.exists() and not (overwrite and target.is_file()):
        raise UsageError(f"{target} exists; choose another file, or replace it with --overwrite")


def _list_record_blocks(
    folder: Path, files: Mapping[SetKey, SetReference], progress: Callable[[int, int], None]
) -> tuple[dict[Sampling, list[Block]], int, dict[str, str]]:
    """Return the blocks of records by sampling, the number of sets without a file yet, and unreadable files.

    A block has the records of one set's file; a set that is still in the journal counts as without a file.
    Unreadable files have their reason as value. ``progress`` receives the numbers of sets done and in all.
    """
    blocks, waiting, left_out = dict[Sampling, list[Block]](), 0, dict[str, str]()
    journaled = FolderSetReader(folder).sets()
    for number, (set_key, file) in enumerate(sorted(files.items())):
        progress(number, len(files))
        try:
            for sampling, block in list_record_blocks(folder, file):
                blocks.setdefault(sampling, []).append(block)
        except SetNotFoundError as error:
            if set_key in journaled:
                waiting += 1
            else:
                left_out[file] = str(error)
        except ArchiveError as error:
            left_out[file] = str(error)
    progress(len(files), len(files))
    return blocks, waiting, left_out


def _read_shot_columns(
    catalogue: Catalogue, sampling: Sampling, blocks: Sequence[Block], sets: Sequence[SetRow]
) -> Columns:
    """Collect the columns of shots and their results, in the order of the records in the blocks.

    Results are features or, of echoes, thickness. A record without a row has missing values (`_to_columns`).
    Reads `_SETS_AT_ONCE` sets at a time. ``sets`` are the rows with the due hours.
    """
    due_h = {row.set_index: row.due_h for row in sets}
    kind: type[FeatureRow] | type[ThicknessRow] = ThicknessRow if sampling.is_echo else FeatureRow
    parts = []
    for start in range(0, len(blocks), _SETS_AT_ONCE):
        step, at = blocks[start : start + _SETS_AT_ONCE], sampling.position
        first, last = step[0].set_key.set_index, step[-1].set_key.set_index
        found = catalogue.rows(ShotRow, position=at, first_set=first, last_set=last)
        shots = {row.sequence: row for row in found}
        results_found = catalogue.rows(kind, position=at, first_set=first, last_set=last)
        results = {row.sequence: row for row in results_found}
        of_set = [(shot_id, block.set_key.set_index) for block in step for shot_id in block.shot_ids]
        ids = [shot_id for shot_id, _ in of_set]
        parts.append(
            {
                **_to_columns([shots.get(shot_id) for shot_id in ids], ShotRow, _OF_A_SHOT),
                "due_h": np.array([due_h.get(index, math.nan) for _, index in of_set]),
                **_to_columns([results.get(shot_id) for shot_id in ids], kind, _select_result_columns(kind)),
            }
        )
    return {name: _concatenate_column([part[name] for part in parts]) for name in parts[0]}


def _read_set_columns(catalogue: Catalogue, position: str, sets: Sequence[SetRow]) -> Columns:
    """Collect the columns of a position's sets and their results, in the order of ``sets`` (not empty).

    Results are features and assessments or, of pulse-echo positions, thickness. A set without a result has
    missing values (`_to_columns`).
    """
    kinds: tuple[type[FeatureRow | AssessmentRow | ThicknessRow], ...] = (FeatureRow, AssessmentRow)
    if sets[0].method == PULSE_ECHO:
        kinds = (ThicknessRow,)
    columns: dict[str, Column] = {"set_index": np.array([row.set_index for row in sets])}
    columns |= _to_columns(sets, SetRow, _OF_A_SET)
    for kind in kinds:
        parts = []
        for start in range(0, len(sets), _SETS_AT_ONCE):
            step = sets[start : start + _SETS_AT_ONCE]
            found = catalogue.rows(
                kind,
                position=position,
                scope="set" if kind is FeatureRow else None,
                first_set=step[0].set_index,
                last_set=step[-1].set_index,
            )
            results = {row.set_index: row for row in found}
            parts.append(
                _to_columns([results.get(row.set_index) for row in step], kind, _select_result_columns(kind))
            )
        columns |= {name: _concatenate_column([part[name] for part in parts]) for name in parts[0]}
    return columns


def _select_result_columns(kind: type[Row]) -> tuple[str, ...]:
    """Return the names of a result row's columns, without keys and nested values."""
    nested = ("contributions", "statistics", "limits", "averages")
    return tuple(name for name in kind.__slots__ if name not in (*_NO_RESULT, *nested))


def _to_columns(rows: Sequence[Row | None], kind: type[Row], names: Sequence[str]) -> dict[str, Column]:
    """Convert rows to one array or list of strings per column; missing values are NaN, -1, or "".

    Rows may be None, and then all their values are missing. Lists become one string, separated by blanks.
    """
    forms = {column.name: choose_published_form(column.type) for column in list_columns(kind)}
    columns: dict[str, Column] = {}
    for name in names:
        values = [None if row is None else getattr(row, name) for row in rows]
        if forms[name] in ("number", "integer", "truth"):
            columns[name] = to_array(forms[name], values)
        else:
            columns[name] = [" ".join(value) if isinstance(value, list) else value or "" for value in values]
    return columns


def _concatenate_column(parts: Sequence[Column]) -> Column:
    """Concatenate the parts of a column, arrays or lists of strings, in order."""
    if isinstance(parts[0], list):
        return [value for part in parts for value in part]
    return np.concatenate(parts)
