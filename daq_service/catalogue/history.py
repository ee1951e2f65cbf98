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


def parsed(content: bytes, *, whole: bool = True) -> History:
    """Take the lines in; ``whole`` False: the first ones are missing."""
    history = History()
    lines = content.split(b"\n")
    unreadable: list[int] = []
    for place, line in enumerate(lines, start=1):
        told = _told(line)
        if told is None:
            # An empty line is where a new one was begun after a torn one.
            unreadable += [place] if line else []
            continue
        number, table, row = told
        expected = history.last_number + 1
        if number != expected and (whole or history.last_number):
            at = f", damaged at line {unreadable[0]}" if unreadable else ""
            history.damage.append(f"{HISTORY_FILE} lacks its lines {expected} to {number - 1}{at}")
        unreadable.clear()
        try:
            history.take(number, table, row)
        except (TypeError, LookupError) as error:
            history.damage.append(f"{HISTORY_FILE}, line {number}: {error}")
    if unreadable and (len(unreadable) > 1 or unreadable[0] != len(lines)):
        # One line without an end was being written when the power went: its row is in the catalogue.
        history.damage.append(f"{HISTORY_FILE} is damaged at line {unreadable[0]}, near its end")
    return history


def _told(line: bytes) -> tuple[int, str, Mapping[str, Any]] | None:
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
        self._open: dict[type[CommandRow] | type[SetRow], int] = {}
        self._refusal = ""

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
        if history.events:
            last_id = max(history.events)
            found = self._catalogue.rows(EventRow, after_id=last_id - 1, limit=1)
            if found != [history.events[last_id]]:
                raise CatalogueDamagedError(
                    f"{self._folder / FILE_NAME} has lost rows: {HISTORY_FILE} knows event {last_id}; "
                    "`solimon rebuild` makes the catalogue again from sets, journal and history"
                )
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
            self._open = {CommandRow: 0, SetRow: 0}
        known, lines = self._known, list[bytes]()
        for table, row in self._news(known):
            number = known.last_number + 1
            lines.append(line_of(number, table, row))
            known.take(number, table, row)
        if lines:
            _append_durably(self._folder / HISTORY_FILE, lines)

    def _news(self, known: History) -> list[tuple[str, Mapping[str, Any]]]:
        news: list[tuple[str, Mapping[str, Any]]] = []
        if not known.last_number:
            news.append(("experiment", values(self._catalogue.experiment_row())))
        last_id = max(known.events, default=0)
        known.events = {key: row for key, row in known.events.items() if key == last_id}
        news += [("events", values(row)) for row in self._catalogue.rows(EventRow, after_id=last_id)]
        for order in self._from(CommandRow, final=lambda order: order.state in ANSWERS):
            if known.commands.get(order.id) != order:
                news.append(("commands", values(order)))
        its_sets = self._from(SetRow, final=lambda row: row.file is None or bool(row.file_sha256))
        digests = {row.file: row.file_sha256 for row in its_sets if row.file_sha256}
        for file, sha256 in digests.items():
            if known.digests.get(file) != sha256:
                news.append(("files", {"file": file, "file_sha256": sha256}))
        return news

    def _from(self, kind: Any, final: Callable[[Any], bool]) -> Iterable[Any]:
        """Rows that may have changed: those behind the first ones that never will again."""
        rows = self._catalogue.rows(kind, after_id=self._open[kind])
        for row in rows:
            if not final(row):
                break
            self._open[kind] = row.id
        return rows


def _append_durably(path: Path, lines: Iterable[bytes]) -> None:
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
