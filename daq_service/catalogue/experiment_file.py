"""Read and write ``experiment.json``, which identifies a folder's experiment if the catalogue is lost."""

from __future__ import annotations

import logging
import zlib
from pathlib import Path

import orjson

from daq_service.catalogue.earlier_names import to_current_row
from daq_service.catalogue.errors import (
    CatalogueDamagedError,
    CatalogueError,
    CatalogueWriteError,
    OtherExperimentError,
)
from daq_service.catalogue.rows import ExperimentRow, as_dict
from daq_service.clock import format_utc
from daq_service.shared_file import HINT_SUFFIX, read_shared, write_durably

log = logging.getLogger(__name__)

EXPERIMENT_FILE = "experiment.json"
HISTORY_FILE = "history.jsonl"
"""History of the test, see `history`."""


def write_experiment_file(folder: Path, row: ExperimentRow) -> None:
    """Write ``experiment.json`` durably, with the CRC-32 of its columns; replace an existing file.

    Raises
    ------
    CatalogueWriteError
        The disk refuses.
    """
    path = folder / EXPERIMENT_FILE
    columns = as_dict(row)
    content = orjson.dumps(
        {"crc32": _compute_crc32(columns), "experiment": columns}, option=orjson.OPT_INDENT_2
    )
    try:
        write_durably(path, content, temporary=path.with_suffix(HINT_SUFFIX))
    except OSError as error:
        raise CatalogueWriteError(
            f"{path} cannot be written: {error.strerror}; free disk space or repair the disk"
        ) from error


def read_experiment_file(folder: Path) -> ExperimentRow | None:
    """Read the experiment's row from ``experiment.json``; None if there is no file.

    Raises
    ------
    CatalogueDamagedError
        It is no JSON, lacks columns, or does not match its checksum.
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
            f"{path} cannot be read: {error.strerror}; check the disk and its permissions"
        ) from error
    try:
        stored = orjson.loads(content)
        if stored["crc32"] != _compute_crc32(stored["experiment"]):
            raise ValueError("its checksum is another one")
        return ExperimentRow(**to_current_row("experiment", stored["experiment"]))
    except (ValueError, TypeError, LookupError) as error:
        raise CatalogueDamagedError(
            f"{path} is damaged: {error}; `solimon rebuild` writes it again from catalogue, history or sets"
        ) from error


def ensure_experiment_file(folder: Path, row: ExperimentRow) -> None:
    """Check that ``experiment.json`` agrees with the catalogue's row; write it if it is missing or damaged.

    A damaged file is logged as a warning before it is replaced.

    Raises
    ------
    OtherExperimentError
         The file belongs to another experiment.
    CatalogueError
        The file cannot be read now, or (CatalogueWriteError) not written.
    """
    try:
        stored = read_experiment_file(folder)
    except CatalogueDamagedError as error:
        log.warning("written again from the catalogue: %s", error)
        stored = None
    if stored is None:
        write_experiment_file(folder, row)
    else:
        raise_if_other_record(row, stored, "its catalogue", EXPERIMENT_FILE, folder)


def raise_if_other_record(
    row: ExperimentRow, other_row: ExperimentRow, name: str, other_name: str, folder: Path
) -> None:
    """Raise an error if two records of a folder describe different experiments.

    Parameters
    ----------
    name, other_name
        Sources of the two records, for the message.

    Raises
    ------
    OtherExperimentError
         Configuration hash or hour 0 differ; contains both values.
    """
    text, other_text = describe_experiment(row), describe_experiment(other_row)
    if text != other_text:
        raise OtherExperimentError(
            f"{folder} holds two tests: {name} is of {text}, {other_name} of {other_text}; "
            "take out what does not belong here, or choose another folder with --data-dir"
        )


def describe_experiment(row: ExperimentRow) -> str:
    """Format the configuration hash and hour 0 (UTC) that identify an experiment as one text for messages."""
    return f"configuration {row.configuration_hash}, hour 0 at {format_utc(row.epoch_utc_ns)}"


def _compute_crc32(columns: object) -> int:
    """Compute the CRC-32 of a row's columns, serialized as JSON in their order."""
    return zlib.crc32(orjson.dumps(columns))
