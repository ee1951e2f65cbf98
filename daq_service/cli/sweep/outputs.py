"""Write the table of a sweep as CSV with a file of facts, HDF5 or Parquet; files are complete or absent.

A CSV file follows RFC 4180 exactly, so that every program reads it: one header, no comments. The attributes
of the other formats are in ``FILE.csv.json``.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from daq_service.archive.sweep_table import build_sweep_image
from daq_service.cli.sweep.table import SweepTable, format_facts
from daq_service.errors import StorageError, UsageError
from daq_service.shared_file import write_durably
from daq_service.web.tables.formats import format_cell, import_pyarrow

HDF5_SUFFIXES = (".h5", ".hdf5")
SUFFIXES = (".csv", *HDF5_SUFFIXES, ".parquet")
OTHERWISE = "write .csv or .h5"


def check_outputs(paths: Sequence[Path], *, waveforms: bool) -> None:
    """Check before the computation that the outputs can be written; existing files are accepted.

    Raises
    ------
    UsageError
        An unknown or repeated name, a format that is not installed, or waveforms without HDF5.
    StorageError
        There is no such folder, or the name is a folder.
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
        import_pyarrow(OTHERWISE)
    if waveforms and not any(path.suffix.lower() in HDF5_SUFFIXES for path in paths):
        raise UsageError("--waveforms are stored in HDF5 only; add --out FILE.h5")


def list_output_files(path: Path) -> tuple[Path, ...]:
    """Return all files of an output: a CSV file has one of facts, too, which comes first."""
    return (build_facts_path(path), path) if path.suffix.lower() == ".csv" else (path,)


def build_facts_path(path: Path) -> Path:
    """Return the path of the facts for a CSV file: its name with ``.json`` appended."""
    return path.with_name(path.name + ".json")


def write_output(path: Path, table: SweepTable) -> None:
    """Write one output in the format of its name, replacing an existing file; CSV with its facts file.

    Raises
    ------
    StorageError
        The disk is full or refuses; nothing new is left of this file.
    UsageError
        A Parquet file is requested without pyarrow.
    """
    suffix = path.suffix.lower()
    if suffix == ".csv":
        _write_file(build_facts_path(path), format_facts(table).encode())
        _write_file(path, format_csv(table).encode())
    elif suffix == ".parquet":
        _write_file(path, format_parquet(table))
    else:
        image = build_sweep_image(
            swept=table.swept,
            results=table.results,
            status=table.status,
            forces=table.forces,
            facts=table.facts,
            facts_text=format_facts(table),
        )
        _write_file(path, image)


def format_csv(table: SweepTable) -> str:
    """Format the table as CSV (RFC 4180); numbers with all digits, missing ones empty."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(table.columns)
    writer.writerows([format_cell(cell) for cell in row.values()] for row in table.rows())
    return text.getvalue()


def format_parquet(table: SweepTable) -> bytes:
    """Encode the table as Parquet; its metadata hold the facts under the key ``solimon``.

    Raises UsageError without pyarrow.
    """
    arrow = import_pyarrow(OTHERWISE)
    from pyarrow import parquet

    content = arrow.table(dict(table.columns)).replace_schema_metadata({"solimon": format_facts(table)})
    buffer = io.BytesIO()
    parquet.write_table(content, buffer)
    return buffer.getvalue()


def _write_file(path: Path, content: bytes) -> None:
    """Write a file durably to the disk, complete or not at all; raise StorageError if that fails."""
    try:
        write_durably(path, content, temporary=path.with_name(path.name + ".part"))
    except OSError as error:
        raise StorageError(
            f"cannot write {path}: {error.strerror}; free some space or correct the permissions, then give "
            "the same command again: finished rows are kept"
        ) from error
