"""``audit.jsonl``: who asked for what, from where, and what came of it.

Append-only lines like those of ``history.jsonl``, in a file of their own: what is refused before there is a
catalogue, or while it is damaged, is told all the same, and a lost catalogue loses none of it. Every process
may add lines, one after the other. Trouble with the file is a warning: nobody is kept from a hold by a full
disk. A flood of refusals leaves a bounded number of lines, and the count of what was left out.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Literal

from daq_service.catalogue.history import append_durably, line_of, told_by
from daq_service.processes.data_folder import one_at_a_time
from daq_service.shared_file import patiently

log = logging.getLogger(__name__)

AUDIT_FILE = "audit.jsonl"
TABLE = "audit"
BLOCK_BYTES = 64 * 1024
"""More than the longest line."""
MOST_LINES = 20_000
"""That one reading looks at: some 6 MB."""
LOOK_BACK_LINES = 20
"""The last ones may be torn."""
MOST_REFUSALS, REFUSAL_EVERY_S = 100, 120.0
"""Lines of refusals of one name, or of all strangers: so many at once, then one each two minutes. A flood
for a year comes to 80 MB."""
TERMINAL = "terminal"
"""Where who asks sits at the computer itself."""
Result = Literal["accepted", "done", "refused", "failed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Deed:
    """What somebody asked for.

    Attributes
    ----------
    who
        Name of the token, or the one that was claimed; empty: nobody knows.
    role
        Of the token, ``claimed``, or empty for a stranger.
    source
        Network address, or ``terminal``.
    what
        Kind of an order, or what it was about: ``log_in``, ``create_token``, ``enter``.
    result, why
        What came of it; ``accepted`` is an order that a recorder has yet to carry out.
    command_id
        Row of ``commands`` that tells what became of it.
    left_out
        Refusals before this one that are not told.
    """

    who: str
    role: str
    source: str
    what: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    result: Result
    why: str = ""
    command_id: int | None = None
    left_out: int = 0
    utc_ns: int = field(default_factory=time.time_ns)


class Allowance:
    """So many at once, then one in a while."""

    def __init__(self, most: int, every_s: float, *, mono_s: Callable[[], float] = time.monotonic) -> None:
        self._most, self._every_s, self._mono_s = most, every_s, mono_s
        self._left, self._at_s = float(most), mono_s()

    def take(self) -> bool:
        """Take one if there is one."""
        now_s = self._mono_s()
        self._left = min(self._most, self._left + (now_s - self._at_s) / self._every_s)
        self._at_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Audit:
    """Adds to the audit of a data folder; for any thread."""

    def __init__(self, folder: Path, *, mono_s: Callable[[], float] = time.monotonic) -> None:
        self._path, self._mono_s = folder / AUDIT_FILE, mono_s
        self._allowances: dict[str, Allowance] = {}
        self._left_out = 0
        self._lock = threading.Lock()

    def leave_out(self) -> None:
        """Count a refusal that is not told."""
        with self._lock:
            self._left_out += 1

    def tell(self, **deed: Any) -> None:
        """Add a deed, unless it is one refusal too many."""
        told = Deed(**deed)
        with self._lock:
            if told.result == "refused" and not self._allowance(told).take():
                self._left_out += 1
                return
            left_out, self._left_out = self._left_out, 0
        try:
            _append(self._path, asdict(told) | {"left_out": left_out})
        except OSError as error:
            log.warning("not in %s: %s %s %s: %s", AUDIT_FILE, told.what, told.result, told.who, error)

    def _allowance(self, deed: Deed) -> Allowance:
        whose = deed.who if deed.role not in ("", "claimed") else deed.role
        if whose not in self._allowances:
            self._allowances[whose] = Allowance(MOST_REFUSALS, REFUSAL_EVERY_S, mono_s=self._mono_s)
        return self._allowances[whose]


def _append(path: Path, deed: Mapping[str, Any]) -> None:
    with one_at_a_time(path):
        found, _ = read_audit(path.parent, limit=1, most_lines=LOOK_BACK_LINES)
        number = found[0][0] + 1 if found else 1
        append_durably(path, [line_of(number, TABLE, deed)])


def read_audit(
    folder: Path,
    *,
    limit: int,
    end: int | None = None,
    wanted: Callable[[Deed], bool] = lambda deed: True,
    most_lines: int = MOST_LINES,
) -> tuple[list[tuple[int, Deed]], int | None]:
    """Read the newest lines, the newest first; damaged ones are left out (`solimon verify` tells them).

    Parameters
    ----------
    limit
        Most deeds.
    end
        Byte at which the lines end that are asked for; None: all.
    wanted
        Tells which deeds are asked for.
    most_lines
        No more are looked at, wanted or not: what is found may be fewer than `limit`, or nothing.

    Returns
    -------
    list of tuple
        Number and deed.
    int or None
        `end` of the lines before; None: there are none.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    found: list[tuple[int, Deed]] = []
    try:
        with patiently(lambda: (folder / AUDIT_FILE).open("rb")) as file:
            for n_lines, (begin, line) in enumerate(_lines_back(file, end), start=1):
                told = told_by(line)
                if told is not None and wanted(deed := Deed(**told[2])):
                    found.append((told[0], deed))
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
