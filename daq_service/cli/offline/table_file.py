"""A table of features from a file: a row a set in the order of time, a column a feature."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq_service.cli.offline.csv_lines import COMMENTS, NoTableError, csv_lines, is_comment
from daq_service.errors import UsageError

MOST_ROWS = 5_000_000
"""Of a table: 40 MB a feature."""
SEPARATORS = ";\t,"
"""Of a CSV file: the first of these in its first line, for beside the others a comma may be decimal."""
MISSING = frozenset({"", "na", "n/a", "nan", "nil", "null", "none", "-"})
"""What stands in a cell without a value, in small letters."""
MOST_CELLS = 100_000_000
"""Of a table whose size stands in its header: 800 MB of numbers."""
NAMES_SHOWN = 12


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
    NoTableError
        The file holds no table.
    UsageError
        There is no such file, or it has no such column; with what it has.
    """
    columns, decimal = _columns(path)
    healthy_by = baseline_where[0] if baseline_where else None
    if healthy_by is not None and healthy_by not in columns:
        raise UsageError(f"{path}: no column {healthy_by!r}; it has {_listed(columns)}")
    missing = [name for name in features if name not in columns]
    if missing:
        raise UsageError(f"{path}: no column {_listed(missing)}; it has {_listed(columns)}")
    chosen = list(features) or [name for name in columns if name not in ("", healthy_by)]
    numbers = {name: _numbers(columns[name], decimal) for name in chosen}
    if features:
        for name, column in numbers.items():
            if column is None:
                cell = _no_number(columns[name], decimal)
                raise UsageError(f"{path}: column {name!r} holds {cell!r}, no number")
    kept = {name: column for name, column in numbers.items() if column is not None}
    if not kept:
        first = ", ".join(repr(columns[name][0]) for name in chosen[:NAMES_SHOWN])
        raise NoTableError(
            f"{path}: no column of numbers; it has {_listed(columns)}, with {first} in row 0: a number has a "
            "decimal point, or a comma where semicolons or tabs separate, and none between thousands"
        )
    vectors = np.stack(list(kept.values()), axis=1)
    if baseline_where is None:
        healthy = np.arange(len(vectors)) < (baseline_rows or 0)
    else:
        healthy = _equal(columns[baseline_where[0]], baseline_where[1], decimal)
        if not healthy.any():
            there = _listed(dict.fromkeys(map(str, columns[baseline_where[0]])))
            raise NoTableError(f"{path}: no row has {'='.join(baseline_where)}; there is {there}")
    return TableFile(vectors=vectors, names=tuple(kept), in_baseline=healthy)


def _columns(path: Path) -> tuple[dict[str, Any], str]:
    """Every column by its name, as the file has it, and what may be a decimal point in its texts."""
    reader = {".csv": _of_csv, ".parquet": _of_parquet, ".npy": _of_npy}.get(path.suffix.lower())
    if reader is None:
        ending = path.suffix or "one without ending"
        raise UsageError(f"{path}: a table is a .csv, .parquet or .npy file, not {ending}")
    try:
        columns, decimal = reader(path)
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror or error}") from error
    lengths = {len(column) for column in columns.values()}
    if len(lengths) != 1 or not 0 < max(lengths) <= MOST_ROWS:
        rows = max(lengths, default=0)
        raise NoTableError(f"{path}: {rows} rows; a table has a row a set, 1 to {MOST_ROWS:,} of them")
    return columns, decimal


def _of_csv(path: Path) -> tuple[dict[str, Any], str]:
    comments, lines = csv_lines(path)
    separator = next((one for one in SEPARATORS if lines and one in lines[0]), ",")
    cells = partial(csv.reader, delimiter=separator, skipinitialspace=True)
    try:
        rows = list(cells(lines))
        (last_comment,) = cells([comments[-1].lstrip("# ") if comments else ""])
    except csv.Error as error:
        raise NoTableError(f"{path} is no CSV file: {error}") from error
    if not rows:
        raise NoTableError(f"{path} is empty; its first line names the columns")
    decimal = "." if separator == "," else ","
    header, body = _named(last_comment, rows, decimal)
    _require_names_once(path, header)
    for number, row in enumerate(body):
        known = len(row) == len(header) and any(
            _is_missing(cell) or _is_number(cell, decimal) for cell in row
        )
        if not known and is_comment(text := separator.join(row)):
            raise NoTableError(f"{path}: row {number} is a comment, {text[:40]!r}; {COMMENTS}")
        if len(row) != len(header):
            raise NoTableError(
                f"{path}: row {number} has {len(row)} cells, the first line {len(header)}: leave a cell "
                "empty where a value is missing, and separate by semicolons or tabs where a comma is decimal"
            )
    return {name: [row[k] for row in body] for k, name in enumerate(header)}, decimal


def _named(last_comment: list[str], rows: list[list[str]], decimal: str) -> tuple[list[str], list[list[str]]]:
    """Give names of columns and the rows that are none: the first line names them, or the last comment."""
    header = [cell.strip() for cell in rows[0]]
    numbered = [str(k) for k in range(len(header))]
    numbers = [_is_number(cell, decimal) for cell in header]
    if header == numbered or not any(numbers):
        return header, rows[1:]
    names = [cell.strip() for cell in last_comment]
    if len(names) == len(header) and not all(_is_number(name, decimal) for name in names):
        return names, rows
    return (numbered, rows) if all(numbers) else (header, rows[1:])


def _require_names_once(path: Path, names: Sequence[str]) -> None:
    named = [name for name in names if name]
    if len(set(named)) < len(named):
        raise NoTableError(f"{path}: each column must be named once; they are {','.join(names)[:80]!r}")


def _of_parquet(path: Path) -> tuple[dict[str, Any], str]:
    from daq_service.web.tables.formats import pyarrow

    arrow = pyarrow()
    from pyarrow import parquet

    try:
        with parquet.ParquetFile(path) as file:
            n_rows, n_columns = file.metadata.num_rows, file.metadata.num_columns
            if n_rows * n_columns > MOST_CELLS:
                raise NoTableError(
                    f"{path}: {n_rows} rows of {n_columns} columns; at most {MOST_CELLS:,} cells are read"
                )
            table = file.read()
    except arrow.ArrowInvalid as error:
        raise NoTableError(f"{path} is no Parquet file: {error}") from error
    _require_names_once(path, table.column_names)
    numbers = (arrow.types.is_floating, arrow.types.is_integer)
    columns = {
        name: column.to_numpy() if any(kind(column.type) for kind in numbers) else column.to_pylist()
        for name, column in zip(table.column_names, table.columns, strict=True)
    }
    return columns, "."


def _of_npy(path: Path) -> tuple[dict[str, Any], str]:
    try:
        with np.errstate(over="ignore"):  # of a claimed shape; mapped, a claim takes no memory
            array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, EOFError, OverflowError) as error:  # numpy's words would advise to unpickle it
        raise NoTableError(f"{path} is no .npy file of numbers, rows x features") from error
    if not isinstance(array, np.ndarray) or array.ndim != 2 or array.dtype.kind not in "fiu":
        what = f"{array.dtype} of shape {array.shape}" if isinstance(array, np.ndarray) else "an archive"
        raise NoTableError(f"{path}: {what}; it must be numbers, rows x features")
    return {str(k): array[:, k] for k in range(array.shape[1])}, "."


def _numbers(column: Any, decimal: str) -> NDArray[np.float64] | None:
    """Column as numbers, NaN where there is none; None where most of what stands in it is no number."""
    if isinstance(column, np.ndarray):
        return column.astype(np.float64)
    told = [None if _is_missing(cell) else cell for cell in column]
    values = [_number(cell, decimal) for cell in told]
    strange = sum(value is None and cell is not None for value, cell in zip(values, told, strict=True))
    if 2 * strange > len(told) - told.count(None):
        return None
    return np.array([np.nan if value is None else value for value in values])


def _is_missing(cell: Any) -> bool:
    return cell is None or (isinstance(cell, str) and cell.strip().lower() in MISSING)


def _number(cell: Any, decimal: str) -> float | None:
    if isinstance(cell, bool):
        return None
    try:
        return float(cell.replace(decimal, ".") if isinstance(cell, str) else cell)
    except (TypeError, ValueError):
        return None


def _is_number(cell: str, decimal: str) -> bool:
    return _number(cell, decimal) is not None


def _no_number(column: Sequence[Any], decimal: str) -> Any:
    return next(cell for cell in column if not _is_missing(cell) and _number(cell, decimal) is None)


def _equal(column: Any, value: str, decimal: str) -> NDArray[np.bool_]:
    """Rows whose cell is a value, as text or as a number."""
    wanted = _numbers([value], decimal)
    numbers = _numbers(column, decimal)
    if numbers is not None and wanted is not None and np.isfinite(wanted[0]):
        return np.asarray(numbers == wanted[0])
    return np.array([str(cell).strip().lower() == value.lower() for cell in column], dtype=bool)


def _listed(names: Any) -> str:
    told = list(map(str, names))
    return ", ".join(told[:NAMES_SHOWN]) + (f" ... ({len(told)})" if len(told) > NAMES_SHOWN else "")
