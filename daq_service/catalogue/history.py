"""``history.jsonl``: what nobody can compute again, beside the catalogue that may be lost.

Append-only lines of JSON, each with a running number and a CRC-32 of what stands behind it: the experiment,
every event (gaps, alarms and their acknowledgements, retirements, holds and what the supply said are events
with their whole rows), every order in each state that it went through, the SHA-256 of every set's file.

The recorder alone writes. The history follows the catalogue: what it lacks is appended while the recorder
waits and at each start, so a crash, a full disk or a torn line costs nothing that the catalogue still has.
"""

from __future__ import annotations

import logging
import os
import time
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import orjson

from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.errors import CatalogueDamagedError
from daq_service.catalogue.experiment_file import HISTORY_FILE, refuse_another
from daq_service.catalogue.reader import Catalogue
from daq_service.catalogue.rows import CommandRow, EventRow, ExperimentRow, SetRow, values
from daq_service.catalogue.writer import ANSWERS
from daq_service.errors import StorageError
from daq_service.shared_file import O_BINARY, patiently, sync_folder, write_all

log = logging.getLogger(__name__)

FOLLOW_EVERY_S = 1.0
"""How far the history may be behind: whoever loses the catalogue within a second has lost the disk."""
TAIL_BYTES = 4_000_000
"""What a start reads of a long one."""
EVENTS_AT_ONCE = 5_000
"""A folder older than its history may have a million."""
_HOLE = b"\0\0"
"""No flipped bit makes two of them, and JSON has none."""
_HEAD = b'{"crc32":"'
_BODY = len(_HEAD) + 10


@dataclass(slots=True, kw_only=True, eq=False)
class History:
    """What a history tells; the last line of an id counts.

    Attributes
    ----------
    digests
        SHA-256 by the name of a set's file.
    last_number
        Of its newest line, 0 before the first.
    damage
        Lines that cannot be read, and numbers that are missing. A line that was torn while it was written,
        and written again, is none.
    """

    experiment: ExperimentRow | None = None
    events: dict[int, EventRow] = field(default_factory=dict)
    commands: dict[int, CommandRow] = field(default_factory=dict)
    digests: dict[str, str] = field(default_factory=dict)
    last_number: int = 0
    damage: list[str] = field(default_factory=list)

    def take(self, number: int, table: str, row: Mapping[str, Any]) -> None:
        """Add what a line says."""
        self.last_number = number
        match table:
            case "experiment":
                self.experiment = ExperimentRow(**row)
            case "events":
                self.events[row["id"]] = EventRow(**row)
            case "commands":
                self.commands[row["id"]] = CommandRow(**row)
            case "files":
                self.digests[row["file"]] = row["file_sha256"]


def line_of(number: int, table: str, row: Mapping[str, Any]) -> bytes:
    """Line of a row."""
    body = orjson.dumps({"n": number, "table": table, "row": row})[1:]
    return b'%s%08x",%s\n' % (_HEAD, zlib.crc32(body), body)


def read_history(folder: Path, *, tail_bytes: int | None = None) -> History:
    """Read the history of a data folder; empty where there is none.

    Parameters
    ----------
    tail_bytes
        Read no more than this of its end.

    Raises
    ------
    OSError
        It cannot be read.
    """
    try:
        with patiently(lambda: (folder / HISTORY_FILE).open("rb")) as file:
            size = file.seek(0, os.SEEK_END)
            begin = 0 if tail_bytes is None else max(0, size - tail_bytes)
            file.seek(begin)
            content = file.read()
    except FileNotFoundError:
        return History()
    return parsed(content if begin == 0 else content.partition(b"\n")[2], whole=begin == 0)


def parsed(content: bytes, *, whole: bool = True, name: str = HISTORY_FILE) -> History:
    """Take the lines in; ``whole`` False: the first ones are missing; damage is told by the file's name."""
    history = History()
    lines = content.split(b"\n")
    unreadable: list[int] = []
    for place, line in enumerate(lines, start=1):
        told = parsed_line(line)
        if told is None:
            # An empty line is where a new one was begun after a torn one.
            unreadable += [place] if line else []
            continue
        number, table, row = told
        expected = history.last_number + 1
        if number != expected and (whole or history.last_number):
            at = f", damaged at line {unreadable[0]}" if unreadable else ""
            history.damage.append(f"{name} lacks its lines {expected} to {number - 1}{at}")
        unreadable.clear()
        try:
            history.take(number, table, row)
        except (TypeError, LookupError) as error:
            history.damage.append(f"{name}, line {number}: {error}")
    # One line without an end, or with a hole where a page was, was being written when the power went: nobody
    # was told of its row yet.
    torn = lines[-1] or (lines[-2] if len(lines) > 1 and _HOLE in lines[-2] else b"")
    if unreadable and (len(unreadable) > 1 or lines[unreadable[0] - 1] is not torn):
        history.damage.append(f"{name} is damaged at line {unreadable[0]}, near its end")
    return history


def parsed_line(line: bytes) -> tuple[int, str, Mapping[str, Any]] | None:
    """Read number, table and row of a line; None where it is damaged."""
    try:
        if line.startswith(_HEAD) and int(line[len(_HEAD) : _BODY - 2], 16) == zlib.crc32(line[_BODY:]):
            told = orjson.loads(line)
            return told["n"], told["table"], told["row"]
    except (ValueError, TypeError, LookupError):
        return None
    return None


class HistoryFollower:
    """Appends what the catalogue has and the history has not; trouble with it costs the test nothing."""

    def __init__(
        self, folder: Path, catalogue: Catalogue, *, mono_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._folder, self._catalogue = folder, catalogue
        self._mono_s = mono_s
        self._next_s = 0.0
        self._known: History | None = None
        self._answered = 0
        self._filed: dict[str, str] = {}
        self._refusal = ""

    def filed(self, file: str, sha256: str) -> None:
        """Take in that the catalogue knows the SHA-256 of a set's file now."""
        self._filed[file] = sha256

    def begin(self) -> None:
        """Compare the history with the catalogue, and bring it up to date.

        Raises
        ------
        OtherExperimentError
            It tells of another experiment.
        CatalogueDamagedError
            It knows more than the catalogue, which has lost rows.
        """
        try:
            history = read_history(self._folder, tail_bytes=TAIL_BYTES)
        except OSError as error:
            log.warning("the history cannot be read: %s", error)
            return
        if history.experiment is not None:
            refuse_another(
                self._catalogue.experiment_row(),
                history.experiment,
                "its catalogue",
                HISTORY_FILE,
                self._folder,
            )
        if lacking := lacks_rows_of(history, self._catalogue):
            raise CatalogueDamagedError(f"{self._folder / FILE_NAME} {lacking}")
        self.follow(now=True)

    def follow(self, *, now: bool = False) -> None:
        """Append what is new, at most once a second."""
        if not now and self._mono_s() < self._next_s:
            return
        self._next_s = self._mono_s() + FOLLOW_EVERY_S
        try:
            self._append()
        except (OSError, StorageError) as error:
            # What it holds is unsure now: it is looked at again.
            self._known = None
            if str(error) != self._refusal:
                log.warning("%s is behind the catalogue and follows later: %s", HISTORY_FILE, error)
            self._refusal = str(error)
        else:
            self._refusal = ""

    def _append(self) -> None:
        if self._known is None:
            self._known = read_history(self._folder, tail_bytes=TAIL_BYTES)
            self._answered = 0
            # A crash may have come between a digest and its line, of one of the sets that the end tells of.
            told = _sets_of(self._known.events.values())
            self._filed |= self._digests(min(told), None) if told else {}
        while lines := self._lines(self._known):
            append_durably(self._folder / HISTORY_FILE, lines)
            self._filed.clear()

    def _lines(self, known: History) -> list[bytes]:
        """Lines that the history lacks, of a long test some."""
        last_id = max(known.events, default=0)
        events = self._catalogue.rows(EventRow, after_id=last_id, limit=EVENTS_AT_ONCE)
        orders = self._orders()
        # Where sets have no journal, their rows come with the digest.
        told = _sets_of(events)
        files = self._filed | (self._digests(min(told), max(told)) if told else {})
        news: list[tuple[str, Mapping[str, Any]]] = []
        if not known.last_number:
            news.append(("experiment", values(self._catalogue.experiment_row())))
        news += [("events", values(row)) for row in events]
        news += [("commands", values(row)) for row in orders if known.commands.get(row.id) != row]
        news += [
            ("files", {"file": file, "file_sha256": sha256})
            for file, sha256 in files.items()
            if known.digests.get(file) != sha256
        ]
        lines = [line_of(known.last_number + n, *row) for n, row in enumerate(news, start=1)]
        # Nothing is remembered but what is asked for again, however long the test.
        known.last_number += len(lines)
        known.events = {row.id: row for row in [*known.events.values(), *events][-1:] if row.id}
        known.commands = {row.id: row for row in orders}
        known.digests = files if files else known.digests
        return lines

    def _digests(self, first: int, last: int | None) -> dict[str, str]:
        rows = self._catalogue.rows(SetRow, first_set=first, last_set=last)
        return {row.file: row.file_sha256 for row in rows if row.file and row.file_sha256}

    def _orders(self) -> list[CommandRow]:
        """Orders that may have changed: those behind the first ones that never will again."""
        orders = self._catalogue.rows(CommandRow, after_id=self._answered)
        for order in orders:
            if order.state not in ANSWERS:
                break
            self._answered = order.id
        return orders


def lacks_rows_of(history: History, catalogue: Catalogue) -> str:
    """State that a catalogue lacks the history's newest event, as an older copy does; empty: it has it."""
    last_id = max(history.events, default=0)
    if not last_id or catalogue.rows(EventRow, after_id=last_id - 1, limit=1) == [history.events[last_id]]:
        return ""
    return lost_rows(last_id)


def lost_rows(last_id: int) -> str:
    """State that a catalogue lacks an event of the history."""
    return (
        f"has lost rows: {HISTORY_FILE} knows event {last_id}; `solimon rebuild` makes the catalogue again "
        "from sets, journal and history"
    )


def _sets_of(events: Iterable[EventRow]) -> list[int]:
    """Return the indices of the sets that were stored."""
    return [row.set_index for row in events if row.topic == "sets" and row.set_index is not None]


def append_durably(path: Path, lines: Iterable[bytes]) -> None:
    """Add whole lines to a file, behind an end that was torn, and sync it.

    Raises
    ------
    OSError
        They may not be durable.
    """
    existed = path.exists()
    descriptor = patiently(lambda: os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | O_BINARY, 0o644))
    try:
        size = os.lseek(descriptor, 0, os.SEEK_END)
        torn = b""
        if size:
            os.lseek(descriptor, size - 1, os.SEEK_SET)
            torn = b"" if os.read(descriptor, 1) == b"\n" else b"\n"
        write_all(descriptor, [torn + b"".join(lines)])
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    if not existed:
        sync_folder(path.parent)
