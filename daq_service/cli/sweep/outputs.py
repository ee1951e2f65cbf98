"""Write the table of a sweep as CSV with a file of facts, HDF5 or Parquet; files are complete or absent.

A CSV file follows RFC 4180 exactly, so that every program reads it: one header, no comments. The attributes
of the other formats are in ``FILE.csv.json``.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from daq_service.archive.sweep_table import hdf5_image
from daq_service.cli.sweep.table import Column, SweepTable, facts_text
from daq_service.errors import StorageError, UsageError
from daq_service.settings.foreign_text import spreadsheet_cell
from daq_service.shared_file import write_durably

HDF5_SUFFIXES = (".h5", ".hdf5")
SUFFIXES = (".csv", *HDF5_SUFFIXES, ".parquet")


def check_outputs(paths: Sequence[Path], *, waveforms: bool) -> None:
    """Check before the computation that the outputs can be written.

    Raises
    ------
    UsageError
        An unknown or repeated name, a format that is not installed, or waveforms without HDF5.
    StorageError
        There is no such folder.
    """
    for path in paths:
        if path.suffix.lower() not in SUFFIXES:
            raise UsageError(f"--out is {str(path)!r}; its name must end in {', '.join(SUFFIXES)}")
        try:
            is_folder = path.is_dir()
            has_folder = path.absolute().parent.is_dir()
        except OSError as error:
            raise StorageError(f"cannot write {path}: {error.strerror}; choose another --out") from error
        if not has_folder:
            raise StorageError(f"there is no folder {path.absolute().parent} for {path.name}; make it first")
        if is_folder:
            raise StorageError(f"--out {path} is a folder; name a file")
    if len({path.absolute() for path in paths}) < len(paths):
        raise UsageError("--out names a file twice")
    if any(path.suffix.lower() == ".parquet" for path in paths):
        _pyarrow()
    if waveforms and not any(path.suffix.lower() in HDF5_SUFFIXES for path in paths):
        raise UsageError("--waveforms are stored in HDF5 only; add --out FILE.h5")


def files_of(path: Path) -> tuple[Path, ...]:
    """Return all files of an output."""
    return (facts_path(path), path) if path.suffix.lower() == ".csv" else (path,)


def facts_path(path: Path) -> Path:
    """Return the path of the facts for a CSV file."""
    return path.with_name(path.name + ".json")


def write_output(path: Path, table: SweepTable) -> None:
    """Write one output in the format of its name.

    Raises
    ------
    StorageError
        The disk is full or refuses; nothing new is left of this file.
    """
    suffix = path.suffix.lower()
    if suffix == ".csv":
        _write(facts_path(path), facts_text(table).encode())
        _write(path, csv_text(table).encode())
    elif suffix == ".parquet":
        _write(path, parquet_bytes(table))
    else:
        _write(path, hdf5_bytes(table))


def csv_text(table: SweepTable) -> str:
    """Return the table as CSV (RFC 4180); numbers with all digits, missing ones empty."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(table.columns)
    columns = [_cells(values) for values in table.columns.values()]
    writer.writerows(zip(*columns, strict=True))
    return text.getvalue()


def _cells(values: Column) -> list[str]:
    """Return a column as cells of a CSV file."""
    if isinstance(values, list):
        return list(map(spreadsheet_cell, values))
    if values.dtype == np.bool_:
        return [str(cell).lower() for cell in values.tolist()]
    return ["" if cell != cell else repr(cell) for cell in values.tolist()]  # only NaN differs from itself


def hdf5_bytes(table: SweepTable) -> bytes:
    """Return the HDF5 file with the table, its facts and, if kept, the waveforms."""
    return hdf5_image(
        swept=table.swept,
        results=table.results,
        status=table.status,
        forces=table.forces,
        facts=table.facts,
        facts_text=facts_text(table),
    )


def parquet_bytes(table: SweepTable) -> bytes:
    """Return the Parquet file; its metadata hold the facts under the key ``solimon``."""
    pyarrow = _pyarrow()
    from pyarrow import parquet

    content = pyarrow.table(dict(table.columns)).replace_schema_metadata({"solimon": facts_text(table)})
    buffer = io.BytesIO()
    parquet.write_table(content, buffer)
    return buffer.getvalue()


def _pyarrow() -> Any:
    """Return the module pyarrow; raise an error with the remedy if it is not installed."""
    try:
        import pyarrow
    except ImportError as error:
        raise UsageError(
            "Parquet needs the package pyarrow, which is not installed: pip install 'solimon[parquet]', or "
            "write .csv or .h5"
        ) from error
    return pyarrow


def _write(path: Path, content: bytes) -> None:
    """Write a file durably."""
    try:
        write_durably(path, content, temporary=path.with_name(path.name + ".part"))
    except OSError as error:
        raise StorageError(
            f"cannot write {path}: {error.strerror}; free some space or correct the permissions, then give "
            "the same command again: finished rows are kept"
        ) from error
