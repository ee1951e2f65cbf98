"""Lines of a CSV file, whether of a table or of records."""

from __future__ import annotations

from pathlib import Path

from daq_service.errors import UsageError
from daq_service.shared_file import read_shared


class NoTableError(UsageError):
    """A file is there, but what it holds is no table: an answer of its own beside those of other files."""


def csv_lines(path: Path) -> list[str]:
    """Read the lines of a file in UTF-8; empty ones are none.

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
    return [line for line in text.splitlines() if line.strip()]
