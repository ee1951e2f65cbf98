"""Lines of a CSV file, whether of a table or of records."""

from __future__ import annotations

from itertools import takewhile
from pathlib import Path

from daq_service.errors import UsageError
from daq_service.shared_file import read_shared

COMMENTS = "comments stand before all other lines: move it there, or take it out"


class NoTableError(UsageError):
    """A file is there, but what it holds is no table: an answer of its own beside those of other files."""


def csv_lines(path: Path) -> tuple[list[str], list[str]]:
    """Read the comments that a file in UTF-8 begins with, and its other lines; empty ones are none.

    Raises
    ------
    NoTableError
        It is not in UTF-8.
    OSError
        It cannot be read.
    """
    content = read_shared(path)
    try:
        text = content.decode("utf-8").removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        *before, line = content[: error.start + 1].splitlines()
        raise NoTableError(
            f"{path} is no CSV file in UTF-8: byte {len(line)} of line {len(before) + 1} is "
            f"0x{line[-1]:02x}; save it as UTF-8"
        ) from error
    lines = [line for line in text.splitlines() if line.strip()]
    comments = list(takewhile(is_comment, lines))
    return comments, lines[len(comments) :]


def is_comment(line: str) -> bool:
    """Tell whether a line begins as instruments and `numpy.savetxt` begin a comment."""
    return line.lstrip().startswith("#")
