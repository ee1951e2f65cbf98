"""Read and write ``history.jsonl``: data that cannot be recomputed, in case the catalogue is lost.

Append-only lines of JSON, each with an index and a CRC-32 of the rest: the experiment, every event (gaps,
alarms, acknowledgements, retirements, holds and supply states are events with their complete rows), every
command in each of its states, the SHA-256 of every set's file.

The recorder alone writes. The history follows the catalogue: missing lines are appended while the recorder
waits and at each start, so a crash, a full disk or a truncated line loses nothing that the catalogue has.
"""

from __future__ import annotations

import logging
import os
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import orjson

from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.earlier_names import to_current_row
from daq_service.catalogue.errors import CatalogueDamagedError
from daq_service.catalogue.experiment_file import HISTORY_FILE, raise_if_other_record
from daq_service.catalogue.reader import Catalogue
from daq_service.catalogue.rows import CommandRow, EventRow, ExperimentRow, SetRow, as_dict
from daq_service.catalogue.writer import ANSWERS
from daq_service.clock import MACHINE, MachineClock
from daq_service.errors import StorageError
from daq_service.shared_file import O_BINARY, retry, sync_folder, write_all
from hardware_drivers.measurement import SetKey

log = logging.getLogger(__name__)

FOLLOW_EVERY_S = 1.0
"""Maximum delay of the history behind the catalogue."""
TAIL_BYTES = 4_000_000
"""Maximum size that a start reads from the end of a history."""
EVENTS_AT_ONCE = 5_000
"""Maximum number of events per step; a folder older than its history may have a million."""
_HOLE = b"\0\0"
"""No flipped bit makes two of them, and JSON has none."""
_HEAD = b'{"crc32":"'
_BODY = len(_HEAD) + 10


@dataclass(slots=True, kw_only=True, eq=False)
class History:
    """Contents of a history; the last line of an id is valid.

    Attributes
    ----------
    digests
        SHA-256 by the name of a set's file.
    last_number
         Index of its newest line, 0 before the first.
    damage
        Unreadable and missing lines. A line that was truncated while it was written, and written again, is
        not listed.
    """

    experiment: ExperimentRow | None = None
    events: dict[int, EventRow] = field(default_factory=dict)
    commands: dict[int, CommandRow] = field(default_factory=dict)
    digests: dict[str, str] = field(default_factory=dict)
    last_number: int = 0
    damage: list[str] = field(default_factory=list)

    def take(self, number: int, table: str, row: Mapping[str, Any]) -> None:
        """Add the row of line ``number`` with current names; a later line of an id replaces an earlier one.

        Rows of an unknown table are ignored. Raises TypeError or LookupError if the row lacks columns of its
        table; the number counts as read even then.
        """
        self.last_number = number
        row = to_current_row(table, row)
        match table:
            case "experiment":
                self.experiment = ExperimentRow(**row)
            case "events":
                self.events[row["id"]] = EventRow(**row)
            case "commands":
                self.commands[row["id"]] = CommandRow(**row)
            case "files":
                self.digests[row["file"]] = row["file_sha256"]


def encode_history_line(number: int, table: str, row: Mapping[str, object]) -> bytes:
    """Encode a row as one line of the history: JSON with index, table, CRC-32 and a final newline.

    Raises TypeError if a value of the row cannot be serialized as JSON.
    """
    body = orjson.dumps({"n": number, "table": table, "row": row})[1:]
    return b'%s%08x",%s\n' % (_HEAD, zlib.crc32(body), body)


def read_history(folder: Path, *, tail_bytes: int | None = None) -> History:
    """Read the history of a data folder; without a file the result is an empty `History`.

    Corrupt and missing lines are listed in ``damage``, not raised.

    Parameters
    ----------
    tail_bytes
         Read only this much of its end, without the first, incomplete line; None: all.

    Raises
    ------
    OSError
        It cannot be read.
    """
    try:
        with retry(lambda: (folder / HISTORY_FILE).open("rb")) as file:
            size = file.seek(0, os.SEEK_END)
            start = 0 if tail_bytes is None else max(0, size - tail_bytes)
            file.seek(start)
            content = file.read()
    except FileNotFoundError:
        return History()
    return parse_history_lines(content if start == 0 else content.partition(b"\n")[2], whole=start == 0)


def parse_history_lines(content: bytes, *, whole: bool = True, name: str = HISTORY_FILE) -> History:
    """Parse the lines of a history; list corrupt and missing lines in `History.damage` and go on.

    ``whole`` False: the first lines are absent, which is no damage. ``name`` is the file's name in messages.
    A last line that was truncated by a power cut is not listed.
    """
    history = History()
    lines = content.split(b"\n")
    unreadable: list[int] = []
    for line_number, line in enumerate(lines, start=1):
        parsed = parse_history_line(line)
        if parsed is None:
            # An empty line marks the start of a new line after a truncated one.
            unreadable += [line_number] if line else []
            continue
        number, table, row = parsed
        expected = history.last_number + 1
        if number != expected and (whole or history.last_number):
            at = f", damaged at line {unreadable[0]}" if unreadable else ""
            history.damage.append(f"{name} lacks its lines {expected} to {number - 1}{at}")
        unreadable.clear()
        try:
            history.take(number, table, row)
        except (TypeError, LookupError) as error:
            history.damage.append(f"{name}, line {number}: {error}")
    # A last line without end, or with a page of zeros, was interrupted by a power cut before its row was
    # acknowledged.
    torn = lines[-1] or (lines[-2] if len(lines) > 1 and _HOLE in lines[-2] else b"")
    if unreadable and (len(unreadable) > 1 or lines[unreadable[0] - 1] is not torn):
        history.damage.append(f"{name} is damaged at line {unreadable[0]}, near its end")
    return history


def parse_history_line(line: bytes) -> tuple[int, str, Mapping[str, object]] | None:
    """Parse a line to its index, table and row; None if it is empty, corrupt or does not match its CRC-32."""
    try:
        if line.startswith(_HEAD) and int(line[len(_HEAD) : _BODY - 2], 16) == zlib.crc32(line[_BODY:]):
            fields = orjson.loads(line)
            return fields["n"], fields["table"], fields["row"]
    except (ValueError, TypeError, LookupError):
        return None
    return None


class HistoryFollower:
    """Appends catalogue rows that the history lacks; its errors do not affect the test."""

    def __init__(self, folder: Path, catalogue: Catalogue, *, machine: MachineClock = MACHINE) -> None:
        """Prepare to follow a catalogue with the history of ``folder``; nothing is read or written yet."""
        self._folder, self._catalogue = folder, catalogue
        self._machine = machine
        self._next_s = 0.0
        self._known: History | None = None
        self._last_answered = 0
        self._new_digests: dict[str, str] = {}
        self._refusal = ""

    def add_digest(self, file: str, sha256: str) -> None:
        """Add the SHA-256 of a set's file to those that the next `follow` appends.

        The catalogue must have it already.
        """
        self._new_digests[file] = sha256

    def run_for(self, seconds: float) -> None:
        """Append new rows as `follow` does, at most once per second; ``seconds`` is unused."""
        self.follow()

    def after_set(self, set_key: SetKey) -> None:
        """Do nothing: `run_for` appends the rows of a set (a `BackgroundTask`)."""

    def close(self) -> None:
        """Append the last rows at once; a failure is logged, not raised."""
        self.follow(now=True)

    def begin(self) -> None:
        """Compare the end of the history with the catalogue and append the missing rows.

        An unreadable history and a failing disk are logged as warnings, not raised.

        Raises
        ------
        OtherExperimentError
             The history belongs to another experiment.
        CatalogueDamagedError
            The catalogue lacks the newest event of the history.
        """
        try:
            history = read_history(self._folder, tail_bytes=TAIL_BYTES)
        except OSError as error:
            log.warning("the history cannot be read: %s", error)
            return
        if history.experiment is not None:
            raise_if_other_record(
                self._catalogue.read_experiment(),
                history.experiment,
                "its catalogue",
                HISTORY_FILE,
                self._folder,
            )
        if missing := describe_lost_newest_event(history, self._catalogue):
            raise CatalogueDamagedError(f"{self._folder / FILE_NAME} {missing}")
        self.follow(now=True)

    def follow(self, *, now: bool = False) -> None:
        """Append new rows, at most once per second unless ``now``; log a failure and retry later."""
        if not now and self._machine.mono_s() < self._next_s:
            return
        self._next_s = self._machine.mono_s() + FOLLOW_EVERY_S
        try:
            self._append_missing_lines()
        except (OSError, StorageError) as error:
            # Its contents are unknown now, so it is read again.
            self._known = None
            if str(error) != self._refusal:
                log.warning("%s is behind the catalogue and follows later: %s", HISTORY_FILE, error)
            self._refusal = str(error)
        else:
            self._refusal = ""

    def _append_missing_lines(self) -> None:
        """Append and sync lines, in steps, until the history has all rows of the catalogue.

        Raises OSError or StorageError; lines of earlier steps remain. After an error the end of the history
        is read again.
        """
        if self._known is None:
            self._known = read_history(self._folder, tail_bytes=TAIL_BYTES)
            self._last_answered = 0
            # A crash may have occurred between a digest and its line, for one of the sets at its end.
            set_indices = _list_set_indices(self._known.events.values())
            self._new_digests |= self._read_digests(min(set_indices), None) if set_indices else {}
        while lines := self._collect_missing_lines(self._known):
            append_durably(self._folder / HISTORY_FILE, lines)
            self._new_digests.clear()

    def _collect_missing_lines(self, known: History) -> list[bytes]:
        """Encode the next lines that the history lacks, of at most 5000 events; empty if it lacks none.

        Updates ``known`` as if the lines were written. Raises StorageError if the catalogue cannot be read.
        """
        last_id = max(known.events, default=0)
        events = self._catalogue.rows(EventRow, after_id=last_id, limit=EVENTS_AT_ONCE)
        commands = self._list_changed_commands()
        # Where sets have no journal, their rows come with the digest.
        set_indices = _list_set_indices(events)
        files = self._new_digests | (
            self._read_digests(min(set_indices), max(set_indices)) if set_indices else {}
        )
        new_rows: list[tuple[str, Mapping[str, object]]] = []
        if not known.last_number:
            new_rows.append(("experiment", as_dict(self._catalogue.read_experiment())))
        new_rows += [("events", as_dict(row)) for row in events]
        new_rows += [("commands", as_dict(row)) for row in commands if known.commands.get(row.id) != row]
        new_rows += [
            ("files", {"file": file, "file_sha256": sha256})
            for file, sha256 in files.items()
            if known.digests.get(file) != sha256
        ]
        lines = [encode_history_line(known.last_number + n, *row) for n, row in enumerate(new_rows, start=1)]
        # Keep only what is needed again, so that memory does not grow with the test.
        known.last_number += len(lines)
        known.events = {row.id: row for row in [*known.events.values(), *events][-1:] if row.id}
        known.commands = {row.id: row for row in commands}
        known.digests = files if files else known.digests
        return lines

    def _read_digests(self, first: int, last: int | None) -> dict[str, str]:
        """Read the stored SHA-256 by file name of sets ``first`` to ``last``, included (None: the newest)."""
        rows = self._catalogue.rows(SetRow, first_set=first, last_set=last, purpose="any")
        return {row.file: row.file_sha256 for row in rows if row.file and row.file_sha256}

    def _list_changed_commands(self) -> list[CommandRow]:
        """List the commands that may have changed since the last call, by id.

        Commands before the first unanswered one are skipped from the next call on. Raises StorageError.
        """
        commands = self._catalogue.rows(CommandRow, after_id=self._last_answered)
        for command in commands:
            if command.state not in ANSWERS:
                break
            self._last_answered = command.id
        return commands


def describe_lost_newest_event(history: History, catalogue: Catalogue) -> str:
    """Return a message with the remedy if the catalogue lacks the newest event of the history, else "".

    Compares id, time, topic and kind of the event, not its payload.
    """
    last_id = max(history.events, default=0)
    if not last_id:
        return ""
    # Not its payload: the row that it reports may have changed since, or a column was added.
    identity = ("id", "wall_utc_ns", "topic", "kind")
    stored = catalogue.columns(EventRow, identity, after_id=last_id - 1, limit=1)
    same = stored == {name: [getattr(history.events[last_id], name)] for name in identity}
    return "" if same else describe_lost_event(last_id)


def describe_lost_event(last_id: int) -> str:
    """Format the message that the catalogue lacks an event of the history, with the remedy."""
    return (
        f"has lost rows: {HISTORY_FILE} knows event {last_id}; `solimon rebuild` makes the catalogue again "
        "from sets, journal and history"
    )


def _list_set_indices(events: Iterable[EventRow]) -> list[int]:
    """List the set indices of the events of topic ``sets``, in order and with repetitions."""
    return [row.set_index for row in events if row.topic == "sets" and row.set_index is not None]


def append_durably(path: Path, lines: Iterable[bytes]) -> None:
    """Append lines to a file (created if missing) and sync it; first end a truncated last line.

    Raises
    ------
    OSError
        The lines may not be durable; some of them may be in the file.
    """
    existed = path.exists()
    descriptor = retry(lambda: os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | O_BINARY, 0o644))
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
