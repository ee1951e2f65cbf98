"""Read a table of features from a file: a row per set in the order of time, a column per feature."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import SupportsFloat, TypedDict

import numpy as np
from numpy.typing import NDArray

from daq_service.cli.offline.csv_lines import COMMENTS, NoTableError, is_comment, mmap_npy, read_csv_lines
from daq_service.errors import UsageError

MOST_ROWS = 5_000_000
"""Of a table: 40 MB a feature."""
SEPARATORS = ";\t,"
"""Separators of CSV: the first one in the first line counts, since a comma may also be a decimal mark."""
MISSING = re.compile(r"|n/?a|nan|nil|null|none|-|[+-]?ol|ovld|overload", re.IGNORECASE)
"""Texts of a cell without a value; the last ones are an instrument's overload."""
OVERLOAD, NO_READINGS = 1e38, (-999.0, -9999.0, -99999.0)
"""Numbers for an overload, of either sign (SCPI: 9.9E37, 9.91E37), and for no reading."""
MOST_CELLS = 100_000_000
"""Maximum size of a table according to its header: 800 MB of numbers."""
NAMES_SHOWN = 12
ROWS_BY_NAME = re.compile(
    r"unnamed: \d+|__index_level_\d+__|level_\d+|index|idx|#|no|nr|number|(.*[_ ])?(id|uid|uuid|guid)"
    r"|(row|set|shot|sample|record|serial|sequence)([_ ]?(no|nr|number|index))?"
    r"|date|time|date[_ ]?time|time[_ ]?stamp|utc|epoch|due_h|hours?|minutes?|seconds?|days?"
)
"""Names of columns that count, time or name rows, in small letters and without a unit."""
FEWEST_STEPS = 11
"""From row to row: those of a feature have one sign by chance once in a thousand columns."""
NEARLY = re.compile(
    r"[<>~≈=±$€£'\u2019]?\s*[(+\-\u2212\u2013]?\s*[.,]?\d[\d.,'\u2019\s]*([eEdD]\s?[+-]?\d+)?\s*(±.*)?[)%‰°A-Za-zµμΩ/²³·\s]*"
)
"""A number with a unit, marks between thousands, or a sign that is none of Python's."""
DATE = re.compile(r"\d{1,4}([-/.])\d{1,2}\1\d{1,4}")
NO_NUMBERS = "most of its cells are not numbers"
THOUSANDS = re.compile(r"\s*[+-]?\d{1,3}([.,]\d{3})+\s*")
TOTAL = re.compile(r"\s*(totals?|sum|mean|average|median|std(ev)?|min|max|count)\s*:?\s*", re.IGNORECASE)


Column = Sequence[object] | NDArray[np.generic]
"""Texts of a CSV file, numbers, or objects of a Parquet file."""
Columns = tuple[Mapping[str, Column], str]
"""Columns by name, and the decimal mark of texts."""


class LeftOut(TypedDict):
    """Column that is no feature, why, and its first cell with a value."""

    name: str
    reason: str
    row: int
    cell: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TableFile:
    """Contents of a file.

    Attributes
    ----------
    vectors
        Shape (rows, features), float64; NaN where a value is missing.
    names
        Of the features; of a `.npy` file without names the numbers of its columns, from 0.
    in_baseline
        Shape (rows,).
    left_out
        Columns that are no features.
    """

    vectors: NDArray[np.float64]
    names: tuple[str, ...]
    in_baseline: NDArray[np.bool_]
    left_out: tuple[LeftOut, ...] = ()


def read_table(
    path: Path, *, features: Sequence[str], baseline_rows: int | None, baseline_where: tuple[str, str] | None
) -> TableFile:
    """Read a table of features from a CSV, Parquet or `.npy` file.

    Parameters
    ----------
    features
        Names of columns; none: all that hold numbers, but for the one of ``baseline_where`` and those that
        count, time or name the rows.
    baseline_rows, baseline_where
        One of them: the first so many rows, or those whose column has this value.

    Raises
    ------
    NoTableError
        The file holds no table, has repeated names or malformed numbers, or no row is baseline by
        ``baseline_where``.
    UsageError
        There is no such file, or it has no such column of numbers; with what it has.
    """
    columns, decimal = read_columns(path)
    healthy_by = baseline_where[0] if baseline_where else None
    if healthy_by is not None and healthy_by not in columns:
        raise UsageError(f"{path}: no column {healthy_by!r}; it has {_join_names(columns)}")
    missing = [name for name in features if name not in columns]
    if missing:
        raise UsageError(f"{path}: no column {_join_names(missing)}; it has {_join_names(columns)}")
    chosen = list(features) or [name for name in columns if name != healthy_by]
    numbers = {name: convert_to_numbers(columns[name], decimal) for name in chosen}
    reasons = (
        {}
        if features
        else {name: _find_exclusion_reason(name, columns[name], numbers[name]) for name in chosen}
    )
    if features:
        for name, column in numbers.items():
            if column is None:
                cell = next(
                    c for c in columns[name] if not _is_missing(c) and _parse_number(c, decimal) is None
                )
                at = f"in row {list(columns[name]).index(cell)}: write the number alone, or choose others"
                raise UsageError(f"{path}: column {name!r} holds {cell!r}, no number, {at}")
    columns_of_numbers = {
        name: v for name, v in numbers.items() if name and v is not None and not reasons.get(name)
    }
    if not columns_of_numbers:
        first = ", ".join(repr(columns[name][0]) for name in chosen[:NAMES_SHOWN])
        raise NoTableError(
            f"{path}: no column of numbers; it has {_join_names(columns)}, with {first} in row 0: a number "
            "has a decimal point, or a comma where semicolons or tabs separate, and none between thousands"
        )
    for name in chosen:
        if not isinstance(columns[name], np.ndarray) and (
            name in columns_of_numbers or reasons[name] == NO_NUMBERS
        ):
            _refuse_malformed_numbers(path, name, columns[name], decimal)
    vectors = np.stack(list(columns_of_numbers.values()), axis=1)
    if baseline_where is None:
        healthy = np.arange(len(vectors)) < (baseline_rows or 0)
    else:
        healthy = _mask_equal_rows(columns[baseline_where[0]], baseline_where[1], decimal)
        if not healthy.any():
            values = _join_names(dict.fromkeys(map(str, columns[baseline_where[0]])))
            raise NoTableError(f"{path}: no row has {'='.join(baseline_where)}; there is {values}")
    left_out = tuple(_describe_left_out(name, columns[name], why) for name, why in reasons.items() if why)
    return TableFile(vectors=vectors, names=tuple(columns_of_numbers), in_baseline=healthy, left_out=left_out)


def _find_exclusion_reason(name: str, column: Column, numbers: NDArray[np.float64] | None) -> str:
    """Return the reason why a column is no feature; empty for a feature and an unnamed empty column.

    Reasons: its name, cells that are no numbers, identifiers with leading zeros, monotonic values.
    """
    if not name:
        return "" if numbers is not None and np.isnan(numbers).all() else "it has no name"
    if ROWS_BY_NAME.fullmatch(re.split(r"[\[(]", name)[0].strip().lower().rstrip(".:")):
        return "by its name an index, a time or an identifier"
    if numbers is None:
        return NO_NUMBERS
    if not isinstance(column, np.ndarray) and any(re.fullmatch(r"\s*0\d+\s*", str(c)) for c in column):
        return "identifiers: integers that start with 0"
    steps = np.diff(numbers[np.isfinite(numbers)])
    if np.count_nonzero(steps) >= FEWEST_STEPS and abs(np.sign(steps).sum()) == np.count_nonzero(steps):
        return "it only rises or only falls, as an index or a time does"
    return ""


def _describe_left_out(name: str, column: Column, reason: str) -> LeftOut:
    """Describe an unused column by name, reason and its first cell that is not missing (otherwise row 0)."""
    row = next((row for row, cell in enumerate(column) if not _is_missing(cell)), 0)
    return {"name": name, "reason": reason, "row": row, "cell": str(column[row])}


def _refuse_malformed_numbers(path: Path, name: str, column: Column, decimal: str) -> None:
    """Raise NoTableError for a column of numbers with units, thousands marks or two decimal marks.

    A column with mostly other texts is accepted.
    """
    known = {row: cell for row, cell in enumerate(column) if not _is_missing(cell)}
    mixed = decimal == "," and {",", "."} <= {*"".join(map(str, known.values()))}
    nearly = [row for row, cell in known.items() if _is_malformed_number(cell, decimal, mixed=mixed)]
    n_texts = sum(_parse_number(cell, decimal) is None for cell in known.values()) - len(nearly)
    if nearly and 2 * n_texts <= len(known):
        raise NoTableError(
            f"{path}: column {name!r} holds {str(column[nearly[0]])!r} in row {nearly[0]}, nearly a number: "
            "write the number alone, with no mark between thousands, or choose other columns by --features"
        )


def _is_malformed_number(cell: object, decimal: str, *, mixed: bool) -> bool:
    """Return whether a cell is a number with additional characters, such as ``3 mm``, but no date.

    With ``mixed`` decimal marks, numbers with thousands marks count, too. A duration (timedelta) also counts.
    """
    if not isinstance(cell, str) or _parse_number(cell, decimal) is not None:
        return isinstance(cell, timedelta) or (mixed and THOUSANDS.fullmatch(str(cell)) is not None)
    return NEARLY.fullmatch(cell.strip()) is not None and not DATE.match(cell.strip())


def read_columns(path: Path) -> Columns:
    """Read all columns by name, and the decimal mark of the texts, in the format of the suffix.

    Raises UsageError for another suffix or an unreadable file, NoTableError for none or more than `MOST_ROWS`
    rows.
    """
    reader = {".csv": _read_csv, ".parquet": _read_parquet, ".npy": _read_npy}.get(path.suffix.lower())
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
        raise NoTableError(f"{path}: {rows} rows; a table has one row per set, 1 to {MOST_ROWS:,} of them")
    return columns, decimal


def _read_csv(path: Path) -> Columns:
    """Read the columns of a CSV file as texts, and its decimal mark: a comma unless commas separate.

    Raises NoTableError for an empty file, late comments, rows of another length, or a row of totals at the
    end; OSError if the file cannot be read.
    """
    comments, lines = read_csv_lines(path)
    separator = next((one for one in SEPARATORS if lines and one in lines[0]), ",")
    cells = partial(csv.reader, delimiter=separator, skipinitialspace=True)
    try:
        rows = list(cells(lines))
        (last_comment,) = cells([comments[-1].lstrip("# ") if comments else ""])
    except csv.Error as error:
        raise NoTableError(f"{path} is not a CSV file: {error}") from error
    if not rows:
        raise NoTableError(f"{path} is empty; its first line names the columns")
    decimal = "." if separator == "," else ","
    header, body = _split_names_and_rows(last_comment, rows, decimal)
    _remove_empty_ends(header, body)
    _refuse_repeated_names(path, header)
    body = _remove_unit_row(path, header, body, decimal)
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
    total = next(filter(TOTAL.fullmatch, body[-1]), "") if body else ""
    if total and not any(total in row for row in body[:-1]):
        raise NoTableError(f"{path}: the last row is {total!r} of the others, not a set: take it out")
    return {name: [row[header.index(name)] for row in body] for name in header}, decimal


def _remove_empty_ends(header: list[str], body: list[list[str]]) -> None:
    """Remove trailing empty columns and trailing empty rows, in place."""
    while body and not any(map(str.strip, body[-1])):
        body.pop()
    width = max((k for row in (header, *body) for k, cell in enumerate(row, 1) if cell.strip()), default=0)
    for row in (header, *body):
        del row[width:]


def _remove_unit_row(path: Path, header: list[str], body: list[list[str]], decimal: str) -> list[list[str]]:
    """Return the rows without a row of units below the names.

    Raises NoTableError if that row names columns without a name. ``header`` has the names, ``body`` the rows
    of cells, and ``decimal`` is the decimal mark.
    """
    first, second = (*body, [], [])[:2]
    if not len(header) == len(first) > 0 or any(is_comment(one) or _is_number(one, decimal) for one in first):
        return body
    cells = enumerate(zip(first, second, strict=False))
    unit_columns = [k for k, (cell, below) in cells if _is_number(below, decimal) and not _is_missing(cell)]
    if any(not header[k] for k in unit_columns):
        raise NoTableError(
            f"{path}: row 0 ({','.join(first)}) names columns without a name: keep one such row"
        )
    return body[1:] if unit_columns else body


def _split_names_and_rows(
    last_comment: list[str], rows: list[list[str]], decimal: str
) -> tuple[list[str], list[list[str]]]:
    """Return the column names and the data rows of a CSV file.

    Names come from the first line, from the last comment, or, if the first line has numbers only, are column
    numbers from 0.
    """
    header = [cell.strip() for cell in rows[0]]
    numbered = [str(k) for k in range(len(header))]
    numbers = [_is_number(cell, decimal) for cell in header]
    if header == numbered or not any(numbers):
        return header, rows[1:]
    names = [cell.strip() for cell in last_comment]
    if len(names) == len(header) and not all(_is_number(name, decimal) for name in names):
        return names, rows
    return (numbered, rows) if all(numbers) else (header, rows[1:])


def _refuse_repeated_names(path: Path, names: Sequence[str]) -> None:
    """Raise NoTableError if a column name occurs twice; empty names may repeat."""
    named = [name for name in names if name]
    if len(set(named)) < len(named):
        raise NoTableError(f"{path}: each column must be named once; they are {','.join(names)[:80]!r}")


def _read_parquet(path: Path) -> Columns:
    """Read the columns of a Parquet file: arrays of numbers, lists of other objects.

    Raises NoTableError for another file or more than `MOST_CELLS` cells, UsageError without pyarrow.
    """
    from daq_service.web.tables.formats import import_pyarrow

    arrow = import_pyarrow()
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
        raise NoTableError(f"{path} is not a Parquet file: {error}") from error
    _refuse_repeated_names(path, table.column_names)
    numbers = (arrow.types.is_floating, arrow.types.is_integer)
    columns = {
        name: column.to_numpy() if any(kind(column.type) for kind in numbers) else column.to_pylist()
        for name, column in zip(table.column_names, table.columns, strict=True)
    }
    return columns, "."


def _read_npy(path: Path) -> Columns:
    """Map the columns of a `.npy` file of shape (rows, features), named by their numbers from 0.

    Raises NoTableError for other contents, OSError if the file cannot be read.
    """
    array = mmap_npy(path, "rows x features")
    return {str(k): array[:, k] for k in range(array.shape[1])}, "."


def convert_to_numbers(column: Column, decimal: str) -> NDArray[np.float64] | None:
    """Convert a column to float64, NaN if missing or overload; None if more than half are not numbers."""
    if isinstance(column, np.ndarray):
        return _replace_overload(column.astype(np.float64))
    cells = [None if _is_missing(cell) else cell for cell in column]
    values = [_parse_number(cell, decimal) for cell in cells]
    n_not_numbers = sum(value is None and cell is not None for value, cell in zip(values, cells, strict=True))
    if 2 * n_not_numbers > len(cells) - cells.count(None):
        return None
    return _replace_overload(np.array([np.nan if value is None else value for value in values]))


def _replace_overload(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Replace instrument values for overload (9.9E37) and for no reading (-999) by NaN."""
    over = np.abs(np.abs(values) - OVERLOAD) < 0.011 * OVERLOAD
    return np.asarray(np.where(over | np.isin(values, NO_READINGS), np.nan, values))


def _is_missing(cell: object) -> bool:
    """Return whether a cell is None, empty, or a text for a missing value, such as ``n/a`` or ``OL``."""
    return cell is None or (isinstance(cell, str) and MISSING.fullmatch(cell.strip()) is not None)


def _parse_number(cell: object, decimal: str) -> float | None:
    """Convert a cell to a float; None if it is not a number (truth values and ``1_2`` are not)."""
    if isinstance(cell, bool) or (isinstance(cell, str) and "_" in cell):  # 1_2 is Python's way, and a name
        return None
    number = cell.replace(decimal, ".") if isinstance(cell, str) else cell
    try:
        return float(number) if isinstance(number, str | SupportsFloat) else None
    except (TypeError, ValueError):
        return None


def _is_number(cell: str, decimal: str) -> bool:
    """Return whether a cell can be converted to a float with this decimal mark."""
    return _parse_number(cell, decimal) is not None


def _mask_equal_rows(column: Column, value: str, decimal: str) -> NDArray[np.bool_]:
    """Return a mask of the rows whose cell equals a value: as a number, or as text in any case."""
    wanted = convert_to_numbers([value], decimal)
    numbers = convert_to_numbers(column, decimal)
    if numbers is not None and wanted is not None and np.isfinite(wanted[0]):
        return np.asarray(numbers == wanted[0])
    return np.array([str(cell).strip().lower() == value.lower() for cell in column], dtype=bool)


def _join_names(names: Iterable[object]) -> str:
    """Join names with commas; of more than `NAMES_SHOWN` only the first ones, and the total number."""
    texts = list(map(str, names))
    return ", ".join(texts[:NAMES_SHOWN]) + (f" ... ({len(texts)})" if len(texts) > NAMES_SHOWN else "")
