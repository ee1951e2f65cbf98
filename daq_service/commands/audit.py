"""``audit.jsonl``: author, operation, source and result of each request.

Append-only lines like those of ``history.jsonl``, in a separate file: it also has requests that are rejected
before there is a catalogue, or while that is corrupt, and survives a lost catalogue. Every process may add
lines, one after the other. An error of the file is only a warning, so a full disk prevents no pause. A flood
of rejections leaves a limited number of lines and the count of those left out.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from daq_service.catalogue.earlier_names import to_current_row
from daq_service.clock import MACHINE, MachineClock
from daq_service.processes.line_file import append_line, read_newest_lines

log = logging.getLogger(__name__)

AUDIT_FILE = "audit.jsonl"
TABLE = "audit"
MOST_REJECTIONS, REJECTION_EVERY_S = 100, 120.0
"""Maximum number of rejections written at once for one name, or for all unknown persons, and the interval of
the following ones: 80 MB in a year of a flood."""
TERMINAL = "terminal"
"""Source of a request that is made at the computer itself."""
Result = Literal["accepted", "done", "rejected", "failed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class AuditEntry:
    """Request of a person or program, and its result.

    Attributes
    ----------
    author
        Name of the token, or the claimed one; empty: unknown.
    role
        Role of the token, ``claimed``, or empty if not logged in.
    source
        Network address, or ``terminal``.
    what
        Kind of a command, or another operation: ``log_in``, ``create_token``, ``enter``.
    result, reason
        Result, with the reason of a rejection or failure; ``accepted``: the recorder has yet to execute it.
    command_id
        Row of ``commands`` that has its outcome.
    left_out
        Number of rejections before this one that were not written.
    """

    author: str
    role: str
    source: str
    what: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    result: Result
    reason: str = ""
    command_id: int | None = None
    left_out: int = 0
    utc_ns: int = field(default_factory=time.time_ns)


class Allowance:
    """Rate limit: a burst of a maximum size, then one in each interval."""

    def __init__(self, most: int, every_s: float, *, machine: MachineClock = MACHINE) -> None:
        """Start with ``most`` uses left; one use is refilled every ``every_s`` seconds."""
        self._most, self._every_s, self._machine = most, every_s, machine
        self._left, self._at_s = float(most), machine.mono_s()

    def try_take(self) -> bool:
        """Take one use from the allowance and return True; return False, and take none, if none is left.

        Uses are refilled with time: one per interval, up to the maximum.
        """
        now_s = self._machine.mono_s()
        self._left = min(self._most, self._left + (now_s - self._at_s) / self._every_s)
        self._at_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Audit:
    """Writer of the audit log of a data folder; thread-safe."""

    def __init__(self, folder: Path, *, machine: MachineClock = MACHINE) -> None:
        """Prepare writing to ``audit.jsonl`` in the folder; no file is opened here."""
        self._path, self._machine = folder / AUDIT_FILE, machine
        self._allowances: dict[str, Allowance] = {}
        self._left_out = 0
        self._lock = threading.Lock()

    def count_omitted_rejection(self) -> None:
        """Count a rejection that is not written to the audit log.

        The next written entry has the number of rejections before it as ``left_out``. Thread-safe.
        """
        with self._lock:
            self._left_out += 1

    def add(self, **fields: Any) -> None:
        """Append an audit entry with these fields of `AuditEntry` to the file, and sync it to disk.

        A rejection above its rate limit is only counted; the next written entry has the count as
        ``left_out``. An OSError is logged as a warning, not raised, and the entry is lost.
        """
        entry = AuditEntry(**fields)
        with self._lock:
            if entry.result == "rejected" and not self._find_rate_limit(entry).try_take():
                self._left_out += 1
                return
            left_out, self._left_out = self._left_out, 0
        try:
            append_line(self._path, TABLE, asdict(entry) | {"left_out": left_out})
        except OSError as error:
            log.warning("not in %s: %s %s %s: %s", AUDIT_FILE, entry.what, entry.result, entry.author, error)

    def _find_rate_limit(self, entry: AuditEntry) -> Allowance:
        """Return the rate limit of rejections for an entry's author, created on first use.

        All claimed authors share one limit, and all requests without a role another.
        """
        name = entry.author if entry.role not in ("", "claimed") else entry.role
        if name not in self._allowances:
            self._allowances[name] = Allowance(MOST_REJECTIONS, REJECTION_EVERY_S, machine=self._machine)
        return self._allowances[name]


def read_audit_log(
    folder: Path,
    *,
    limit: int,
    end: int | None = None,
    wanted: Callable[[AuditEntry], bool] = lambda entry: True,
) -> tuple[list[tuple[int, AuditEntry]], int | None]:
    """Read the newest audit entries that ``wanted`` accepts, newest first; damaged lines are left out.

    Parameters
    ----------
    limit
        Maximum number of entries; at most `MOST_LINES` lines are searched for them.
    end
        Byte at which the requested lines end; None: the end of the file.

    Returns
    -------
    tuple
        Entries with their line numbers, and the ``end`` of the earlier ones; None: there are none.

    Raises
    ------
    OSError
        The file cannot be read; a missing file has no entries.
    """
    lines, before = read_newest_lines(
        folder / AUDIT_FILE, limit=limit, end=end, wanted=lambda row: wanted(_parse_entry(row))
    )
    return [(number, _parse_entry(row)) for number, row in lines], before


def _parse_entry(row: Mapping[str, object]) -> AuditEntry:
    """Build the audit entry of a stored row; keys and values of an earlier version get their current names.

    Raise TypeError for a missing or an unknown field.
    """
    return AuditEntry(**to_current_row(TABLE, row))
