"""Append-only files of numbered lines with a checksum each, to which any process of a test may add.

The lines are those of ``history.jsonl`` (`catalogue.history`): damaged ones are left out by who reads.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from daq_service.catalogue.history import append_durably, line_of, parse_line
from daq_service.processes.data_folder import one_at_a_time
from daq_service.shared_file import patiently

BLOCK_BYTES = 64 * 1024
"""More than the longest line."""
MOST_LINES = 20_000
"""That one reading looks at: some 6 MB."""
LOOK_BACK_LINES = 20
"""The last ones may be torn."""

Line = tuple[int, Mapping[str, Any]]
"""Number and row."""


def append_line(path: Path, table: str, row: Mapping[str, Any]) -> None:
    """Add a line durably, behind those of others.

    Raises
    ------
    OSError
        It may not be durable.
    """
    with one_at_a_time(path):
        found, _ = newest_lines(path, limit=1, most_lines=LOOK_BACK_LINES)
        append_durably(path, [line_of(found[0][0] + 1 if found else 1, table, row)])


def newest_lines(
    path: Path,
    *,
    limit: int,
    end: int | None = None,
    wanted: Callable[[Mapping[str, Any]], bool] = lambda row: True,
    most_lines: int = MOST_LINES,
) -> tuple[list[Line], int | None]:
    """Read the newest lines, the newest first; damaged ones are left out.

    Parameters
    ----------
    limit
        Most lines that are given.
    end
        Byte at which the lines end that are asked for; None: all.
    wanted
        Tells which rows are asked for.
    most_lines
        No more are looked at, wanted or not: what is found may be fewer than `limit`, or nothing.

    Returns
    -------
    list of Line
    int or None
        `end` of the lines before; None: there are none.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    found: list[Line] = []
    try:
        with patiently(lambda: path.open("rb")) as file:
            for n_lines, (begin, line) in enumerate(_lines_back(file, end), start=1):
                told = parse_line(line)
                if told is not None and wanted(told[2]):
                    found.append((told[0], told[2]))
                if len(found) == limit or n_lines == most_lines:
                    return found, begin or None
    except FileNotFoundError:
        pass
    return found, None


def _lines_back(file: BinaryIO, end: int | None) -> Iterator[tuple[int, bytes]]:
    """Yield the lines before a byte, the last one first, each with the byte at which it begins."""
    size = file.seek(0, os.SEEK_END)
    begin, content = min(size, size if end is None else end), b""
    while begin:
        step = min(BLOCK_BYTES, begin)
        begin = file.seek(begin - step)
        lines = (file.read(step) + content).splitlines(keepends=True)
        content = lines.pop(0) if begin else b""  # its begin is in the block before
        at = begin + len(content) + sum(map(len, lines))
        for line in reversed(lines):
            at -= len(line)
            yield at, line.rstrip(b"\n")
