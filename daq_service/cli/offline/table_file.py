"""A table of features from a file: a row a set in the order of time, a column a feature."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq_service.errors import UsageError
from daq_service.shared_file import read_shared

MOST_ROWS = 5_000_000
"""Of a table: 40 MB a feature."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TableFile:
    """What a file holds.

    Attributes
    ----------
    vectors
        Shape (rows, features), float64; NaN where a value is missing.
    names
        Of the features; of a `.npy` file without names the numbers of its columns, from 0.
    in_baseline
        Shape (rows,).
    """

    vectors: NDArray[np.float64]
    names: tuple[str, ...]
    in_baseline: NDArray[np.bool_]


def read_table(
    path: Path, *, features: Sequence[str], baseline_rows: int | None, baseline_where: tuple[str, str] | None
) -> TableFile:
    """Read a table.

    Parameters
    ----------
    features
        Names of columns; none: all that hold numbers, but for the one of ``baseline_where``.
    baseline_rows, baseline_where
        One of them: the first so many rows, or those whose column has this value.

    Raises
    ------
    UsageError
        The file is no such table, or has no such column; with what it has.
    """
    columns = _columns(path)
    healthy_by = baseline_where[0] if baseline_where else None
    if healthy_by is not None and healthy_by not in columns:
        raise UsageError(f"{path}: no column {healthy_by!r}; it has {_listed(columns)}")
    missing = [name for name in features if name not in columns]
    if missing:
        raise UsageError(f"{path}: no column {_listed(missing)}; it has {_listed(columns)}")
    chosen = list(features) or [name for name in columns if name != healthy_by]
    numbers = {name: _numbers(columns[name]) for name in chosen}
    if features:
        for name, column in numbers.items():
            if column is None:
                raise UsageError(f"{path}: column {name!r} holds {_no_number(columns[name])!r}, no number")
    kept = {name: column for name, column in numbers.items() if column is not None}
    if not kept:
        raise UsageError(f"{path}: no column of numbers; it has {_listed(columns)}")
    vectors = np.stack(list(kept.values()), axis=1)
    if baseline_where is None:
        healthy = np.arange(len(vectors)) < (baseline_rows or 0)
    else:
        healthy = _equal(columns[baseline_where[0]], baseline_where[1])
    return TableFile(vectors=vectors, names=tuple(kept), in_baseline=healthy)


def _columns(path: Path) -> dict[str, Any]:
    """Every column by its name, as the file has it."""
    reader = {".csv": _of_csv, ".parquet": _of_parquet, ".npy": _of_npy}.get(path.suffix.lower())
    if reader is None:
        ending = path.suffix or "one without ending"
        raise UsageError(f"{path}: a table is a .csv, .parquet or .npy file, not {ending}")
    try:
        columns = reader(path)
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror or error}") from error
    lengths = {len(column) for column in columns.values()}
    if len(lengths) != 1 or not 0 < max(lengths) <= MOST_ROWS:
        rows = max(lengths, default=0)
        raise UsageError(f"{path}: {rows} rows; a table has a row a set, at most {MOST_ROWS:,}")
    return columns


def _of_csv(path: Path) -> dict[str, Any]:
    try:
        lines = list(csv.reader(read_shared(path).decode("utf-8-sig").splitlines()))
    except (UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"{path} is no CSV file in UTF-8: {error}") from error
    rows = [row for row in lines if row]
    if not rows:
        raise UsageError(f"{path} is empty; its first line names the columns")
    header, *body = rows
    if len(set(header)) < len(header) or all(_is_number(cell) for cell in header):
        raise UsageError(
            f"{path}: the first line must name each column once; it is {','.join(header)[:80]!r}"
        )
    for number, row in enumerate(body):
        if len(row) != len(header):
            raise UsageError(f"{path}: row {number} has {len(row)} cells, the first line {len(header)}")
    return {name: [row[k] for row in body] for k, name in enumerate(header)}


def _of_parquet(path: Path) -> dict[str, Any]:
    from daq_service.web.tables.formats import pyarrow

    arrow = pyarrow()
    from pyarrow import parquet

    try:
        table = parquet.read_table(path)
    except arrow.ArrowInvalid as error:
        raise UsageError(f"{path} is no Parquet file: {error}") from error
    return {name: table[name].to_pylist() for name in table.column_names}


def _of_npy(path: Path) -> dict[str, Any]:
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, EOFError) as error:
        raise UsageError(f"{path} is no .npy file of numbers: {error}") from error
    if array.ndim != 2 or array.dtype.kind not in "fiu":
        raise UsageError(f"{path}: {array.dtype} of shape {array.shape}; it must be numbers, rows x features")
    return {str(k): array[:, k] for k in range(array.shape[1])}


def _numbers(column: Any) -> NDArray[np.float64] | None:
    """Column as numbers, NaN where it is empty; None where something else stands in it."""
    if isinstance(column, np.ndarray):
        return column.astype(np.float64)
    if any(isinstance(cell, bool) for cell in column):
        return None
    try:
        return np.array([np.nan if cell is None or cell == "" else float(cell) for cell in column])
    except (TypeError, ValueError):
        return None


def _is_number(cell: str) -> bool:
    return _numbers([cell]) is not None


def _no_number(column: Sequence[Any]) -> Any:
    return next(cell for cell in column if isinstance(cell, bool) or _numbers([cell]) is None)


def _equal(column: Any, value: str) -> NDArray[np.bool_]:
    """Rows whose cell is a value, as text or as a number."""
    wanted = _numbers([value])
    numbers = _numbers(column)
    if numbers is not None and wanted is not None:
        return np.asarray(numbers == wanted[0])
    return np.array([str(cell) == value or str(cell).lower() == value.lower() for cell in column], dtype=bool)


def _listed(names: Any) -> str:
    return ", ".join(map(str, names))
