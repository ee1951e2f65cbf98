"""``experiment.json``: which experiment a folder belongs to, beside the catalogue that may be lost."""

from __future__ import annotations

import logging
import zlib
from pathlib import Path

import orjson

from daq_service.catalogue.errors import (
    CatalogueDamagedError,
    CatalogueError,
    CatalogueWriteError,
    OtherExperimentError,
)
from daq_service.catalogue.rows import ExperimentRow, values
from daq_service.clock import format_utc
from daq_service.shared_file import HINT_SUFFIX, read_shared, write_durably

log = logging.getLogger(__name__)

EXPERIMENT_FILE = "experiment.json"
HISTORY_FILE = "history.jsonl"
"""Beside it: `history`."""


def write_experiment(folder: Path, row: ExperimentRow) -> None:
    """Write it durably, once for all; a person may read it.

    Raises
    ------
    CatalogueWriteError
        The disk refuses.
    """
    path = folder / EXPERIMENT_FILE
    told = values(row)
    content = orjson.dumps({"crc32": _crc32(told), "experiment": told}, option=orjson.OPT_INDENT_2)
    try:
        write_durably(path, content, temporary=path.with_suffix(HINT_SUFFIX))
    except OSError as error:
        raise CatalogueWriteError(
            f"{path} cannot be written: {error.strerror}; free or mend the disk"
        ) from error


def read_experiment(folder: Path) -> ExperimentRow | None:
    """Read it; None where there is none.

    Raises
    ------
    CatalogueDamagedError
        It is not what was written.
    CatalogueError
        It cannot be read now.
    """
    path = folder / EXPERIMENT_FILE
    try:
        content = read_shared(path)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise CatalogueError(
            f"{path} cannot be read: {error.strerror}; mend the disk or its rights"
        ) from error
    try:
        kept = orjson.loads(content)
        if kept["crc32"] != _crc32(kept["experiment"]):
            raise ValueError("its checksum is another one")
        return ExperimentRow(**kept["experiment"])
    except (ValueError, TypeError, LookupError) as error:
        raise CatalogueDamagedError(
            f"{path} is damaged: {error}; `solimon rebuild` writes it again from catalogue, history or sets"
        ) from error


def keep_experiment(folder: Path, row: ExperimentRow) -> None:
    """Have the file say what the catalogue says; a folder from before there was one gets it.

    Raises
    ------
    OtherExperimentError
        It tells of another experiment.
    """
    try:
        kept = read_experiment(folder)
    except CatalogueDamagedError as error:
        log.warning("written again from the catalogue: %s", error)
        kept = None
    if kept is None:
        write_experiment(folder, row)
    else:
        refuse_another(row, kept, "its catalogue", EXPERIMENT_FILE, folder)


def refuse_another(one: ExperimentRow, other: ExperimentRow, its: str, others: str, folder: Path) -> None:
    """Let two places of a folder tell of one experiment: the same configuration, the same hour 0.

    Raises
    ------
    OtherExperimentError
        They do not; with both values.
    """
    ours, theirs = experiment_text(one), experiment_text(other)
    if ours != theirs:
        raise OtherExperimentError(
            f"{folder} holds two experiments: {its} tells of {ours}, {others} of {theirs}; "
            "take out what does not belong here, or choose another folder with --data-dir"
        )


def experiment_text(row: ExperimentRow) -> str:
    """Name what makes an experiment: configuration and hour 0."""
    return f"configuration {row.configuration_hash}, hour 0 at {format_utc(row.epoch_utc_ns)}"


def _crc32(told: object) -> int:
    return zlib.crc32(orjson.dumps(told))
