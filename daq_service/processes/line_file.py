"""Append-only files of numbered lines with a checksum each, to which any process of a test may append.

The lines are those of ``history.jsonl`` (`catalogue.history`): readers skip damaged ones.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from daq_service.catalogue.history import append_durably, encode_history_line, parse_history_line
from daq_service.processes.data_folder import lock_for_change
from daq_service.shared_file import retry

BLOCK_BYTES = 64 * 1024
"""More than the longest line."""
MOST_LINES = 20_000
"""Limit of one read: some 6 MB."""
LOOK_BACK_LINES = 20
"""The last ones may be torn."""

Line = tuple[int, Mapping[str, Any]]
"""Number and row."""


def append_line(path: Path, table: str, row: Mapping[str, Any]) -> None:
    """Append a row as a numbered line with a checksum and sync the file, one process at a time.

    Waits up to `PATIENCE_S` (5 s) for the lock of the file.

    Raises
    ------
    OSError
        The line may not be durable, or another process held the lock all the time.
    """
    with lock_for_change(path):
        lines, _ = read_newest_lines(path, limit=1, most_lines=LOOK_BACK_LINES)
        append_durably(path, [encode_history_line(lines[0][0] + 1 if lines else 1, table, row)])


def read_newest_lines(
    path: Path,
    *,
    limit: int,
    end: int | None = None,
    wanted: Callable[[Mapping[str, Any]], bool] = lambda row: True,
    most_lines: int = MOST_LINES,
) -> tuple[list[Line], int | None]:
    """Read the newest lines, the newest first, without damaged ones; none without a file.

    Parameters
    ----------
    limit
        Maximum number of lines to return.
    end
        Byte at which the requested lines end; None: the end of the file.
    wanted
        Predicate that selects rows.
    most_lines
        Maximum number of lines to read, selected or not: fewer than `limit` may be found.

    Returns
    -------
    list of Line
        Number and row of each selected line.
    int or None
        `end` of the earlier lines; None: there are none.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    selected: list[Line] = []
    try:
        with retry(lambda: path.open("rb")) as file:
            for n_lines, (offset, line) in enumerate(_yield_lines_reversed(file, end), start=1):
                record = parse_history_line(line)
                if record is not None and wanted(record[2]):
                    selected.append((record[0], record[2]))
                if len(selected) == limit or n_lines == most_lines:
                    return selected, offset or None
    except FileNotFoundError:
        pass
    return selected, None


def _yield_lines_reversed(file: BinaryIO, end: int | None) -> Iterator[tuple[int, bytes]]:
    """Yield the lines before byte ``end`` without their line ends, the last one first, each with its offset.

    Reads blocks of 64 KiB; None reads from the end of the file.
    """
    size = file.seek(0, os.SEEK_END)
    offset, content = min(size, size if end is None else end), b""
    while offset:
        step = min(BLOCK_BYTES, offset)
        offset = file.seek(offset - step)
        lines = (file.read(step) + content).splitlines(keepends=True)
        content = lines.pop(0) if offset else b""  # its start is in the block before
        line_offset = offset + len(content) + sum(map(len, lines))
        for line in reversed(lines):
            line_offset -= len(line)
            yield line_offset, line.rstrip(b"\n")
