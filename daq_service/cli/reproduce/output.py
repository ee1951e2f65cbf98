"""Prepare the output folder and write complete files."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

from daq_service.cli.reproduce.item import Table
from daq_service.errors import StorageError
from daq_service.settings.foreign_text import escape_spreadsheet_cell
from daq_service.shared_file import write_output

RECORD = "reproduction.json"
"""Marks the folder as a reproduction, and finally lists its contents."""
REPORT = "report.html"
DATA_FOLDER = "data"
"""Of a test that was run for the figures."""


def prepare_output(folder: Path) -> None:
    """Create the folder and mark it, or accept one of an earlier reproduction, whose files are replaced.

    Raises
    ------
    StorageError
        It holds something else, or cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        names = {path.name for path in folder.iterdir()}
        if names and RECORD not in names:
            raise StorageError(
                f"{folder} is not empty and no reproduction made it (it holds {min(names)!r}); choose a new "
                "or empty one with --out"
            )
        if RECORD not in names:
            write_output(folder / RECORD, b"{}\n")
    except OSError as error:
        raise StorageError(f"cannot write {folder}: {error.strerror}; choose another with --out") from error


def format_csv(table: Table) -> bytes:
    """Encode columns as CSV in UTF-8: a header, then one line per row; missing values are empty cells.

    Floats are written with all their digits, so that they read back as the same numbers.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.columns)
    for row in table.rows():
        writer.writerow([_format_cell(value) for value in row])
    return text.getvalue().encode()


def _format_cell(value: object) -> str:
    """Format a value as a CSV cell: None and NaN empty, whole floats as integers.

    Texts that a spreadsheet would take for a formula are escaped.
    """
    if value is None:
        return ""
    if isinstance(value, float):  # numpy's float64 too
        number = float(value)
        if math.isnan(number):
            return ""
        return repr(int(number)) if number.is_integer() and abs(number) < 1e15 else repr(number)
    return escape_spreadsheet_cell(value) if isinstance(value, str) else str(value)
