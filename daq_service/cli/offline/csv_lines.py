"""Read the lines of a CSV file, or the numbers of a `.npy` file, of a table or of waveforms."""

from __future__ import annotations

import math
import re
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq_service.errors import UsageError
from daq_service.shared_file import read_shared

NO_LINE = re.compile(r"\s*|sep=.\s*", re.IGNORECASE)
COMMENTS = "comments must come before all other lines: move it there, or remove it"


class NoTableError(UsageError):
    """A file is not a table; other files are still assessed."""


def read_csv_lines(path: Path) -> tuple[list[str], list[str]]:
    """Read the leading comment lines of a file and its other non-empty lines.

    The file is in UTF-8, or in UTF-16 as a spreadsheet's "Unicode text". A spreadsheet's line ``sep=;`` is
    dropped.

    Raises
    ------
    NoTableError
        The file is in neither encoding.
    OSError
        The file cannot be read.
    """
    content = read_shared(path)
    wide = len(content) % 2 == 0 and content[:2] in (b"\xff\xfe", b"\xfe\xff", content[:1] + b"\0")
    try:
        text = content.decode("utf-16" if wide else "utf-8").removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        *before, line = content[: error.start + 1].splitlines()
        raise NoTableError(
            f"{path} is not a CSV file in UTF-8: byte {len(line)} of line {len(before) + 1} is "
            f"0x{line[-1]:02x}; save it as UTF-8"
        ) from error
    lines = [line for line in text.splitlines() if not NO_LINE.fullmatch(line)]
    comments = list(takewhile(is_comment, lines))
    return comments, lines[len(comments) :]


def finite_or_none(value: float) -> float | None:
    """Return a number for JSON, which has no NaN and no infinity: None replaces them."""
    return value if math.isfinite(value) else None


def is_comment(line: str) -> bool:
    """Return whether a line starts, after blanks, with ``#`` as comments of instruments and NumPy do."""
    return line.lstrip().startswith("#")


def mmap_npy(path: Path, form: str, *, one_row: bool = False) -> NDArray[Any]:
    """Map the array of a `.npy` file into memory, read-only; shape (rows, columns), or (n,) with ``one_row``.

    Parameters
    ----------
    form
        What rows and columns are, for messages.
    one_row
        Accept an array of one dimension, too.

    Raises
    ------
    NoTableError
        The file has no such array of real numbers.
    OSError
        The file cannot be read.
    """
    try:
        with np.errstate(over="ignore"):  # of a claimed shape; mapped, a claim takes no memory
            array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, EOFError, OverflowError) as error:  # numpy's words would advise to unpickle it
        raise NoTableError(f"{path} is not a .npy file of numbers, {form}") from error
    if (
        isinstance(array, np.ndarray)
        and array.ndim in ((1, 2) if one_row else (2,))
        and array.dtype.kind in "fiu"
    ):
        return array
    or_one = ", or one record" if one_row else ""
    contents = f"{array.dtype} of shape {array.shape}" if isinstance(array, np.ndarray) else "an archive"
    raise NoTableError(f"{path}: {contents}; it must be numbers, {form}{or_one}")
