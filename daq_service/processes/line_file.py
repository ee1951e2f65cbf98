"""Append-only files of numbered lines with a checksum each, to which any process of a test may add.

The lines are those of ``history.jsonl`` (`catalogue.history`): damaged ones are left out by who reads.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from daq_service.catalogue.history import append_durably, line_of, told_by
from daq_service.processes.data_folder import one_at_a_time
from daq_service.shared_file import patiently

BLOCK_BYTES = 64 * 1024
"""More than the longest line."""
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
        found, _ = newest_lines(path, limit=LOOK_BACK_LINES)
        append_durably(path, [line_of(found[0][0] + 1 if found else 1, table, row)])


def newest_lines(path: Path, *, limit: int, end: int | None = None) -> tuple[list[Line], int | None]:
    """Read the newest lines, the newest first; damaged ones are left out.

    Parameters
    ----------
    end
        Byte at which the lines end that are asked for; None: all.

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
    try:
        with patiently(lambda: path.open("rb")) as file:
            size = file.seek(0, os.SEEK_END)
            begin, content = min(size, size if end is None else end), b""
            while begin and content.count(b"\n") <= limit:
                step = min(BLOCK_BYTES, begin)
                begin = file.seek(begin - step)
                content = file.read(step) + content
    except FileNotFoundError:
        return [], None
    lines = content.splitlines(keepends=True)
    if begin:
        begin += len(lines.pop(0))
    for line in lines[:-limit]:
        begin += len(line)
    told = [told_by(line.rstrip(b"\n")) for line in reversed(lines[-limit:])]
    return [(one[0], one[2]) for one in told if one is not None], begin or None
