"""``notifications.jsonl``: log of sent messages, with the progress of each receiver.

Lines like those of the audit log. Each line holds the progress of its receiver, so a restart needs only the
newest one. A line is written before a message is sent (`sending`) and after it: after a crash in between, the
message is sent again with the same events and the same key.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from daq_service.processes.line_file import append_line, read_newest_lines

log = logging.getLogger(__name__)

LOG_FILE = "notifications.jsonl"
TABLE = "notifications"
PAGE_LINES = 1000
DeliveryKind = Literal[
    "began",
    "passed",
    "held_back",
    "sending",
    "sent",
    "failing",
    "gave_up",
    "heartbeat",
    "tested",
    "test_failed",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """Progress of a receiver in the events of alarms.

    Attributes
    ----------
    cursor
        Every event up to this id is settled: sent, given up, or not for this receiver.
    cursor_wall_utc_ns
        Time at which that event was written; it differs in a rebuilt catalogue.
    settled
        Settled events after the cursor.
    sending
        Events of the message in progress.
    """

    cursor: int
    cursor_wall_utc_ns: int
    settled: list[int] = field(default_factory=list)
    sending: list[int] = field(default_factory=list)


@dataclass(frozen=True, slots=True, kw_only=True)
class Delivery:
    """One line of the delivery log.

    Attributes
    ----------
    result
        Result, for a person.
    place
        Progress; None on lines that do not change it: test messages, heartbeats.
    """

    receiver: str
    what: DeliveryKind
    result: str
    event_ids: list[int] = field(default_factory=list)
    key: str = ""
    attempts: int = 0
    place: Progress | None = None
    utc_ns: int = field(default_factory=time.time_ns)


class DeliveryLog:
    """Delivery log of a data folder; thread-safe."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / LOG_FILE
        self._last_error = ""

    def append(self, delivery: Delivery) -> None:
        """Append a line durably; a disk error is logged once per text and does not stop notifications."""
        try:
            append_line(self.path, TABLE, asdict(delivery))
        except OSError as error:
            if str(error) != self._last_error:
                log.warning("not in %s, so a crash would repeat messages: %s", LOG_FILE, error)
            self._last_error = str(error)
        else:
            self._last_error = ""

    def read(self, *, limit: int, end: int | None = None) -> tuple[list[tuple[int, Delivery]], int | None]:
        """Read at most ``limit`` of the newest lines before byte ``end`` with their numbers, newest first.

        The second result is the ``end`` of the earlier lines; None: there are none. Damaged lines are left
        out.

        Raises
        ------
        OSError
            The file cannot be read.
        KeyError, TypeError
            A line has other fields than a delivery.
        """
        lines, previous_end = read_newest_lines(self.path, limit=limit, end=end)
        return [(number, _parse_delivery(row)) for number, row in lines], previous_end

    def find_last_heartbeat_ns(self, receiver: str) -> int | None:
        """Find when the newest heartbeat message to a receiver was attempted, ns of UTC; None without one.

        Withheld heartbeats are ignored. Only the newest 20,000 lines are searched.

        Raises
        ------
        OSError
            The file cannot be read.
        """

        def is_sent(row: Mapping[str, object]) -> bool:
            """Return whether a line is a heartbeat message to this receiver that was not withheld."""
            is_heartbeat = (row.get("receiver"), row.get("what")) == (receiver, "heartbeat")
            return is_heartbeat and not str(row.get("result", row.get("told"))).startswith("withheld")

        lines, _ = read_newest_lines(self.path, limit=1, wanted=is_sent)
        return int(lines[0][1]["utc_ns"]) if lines else None

    def read_progress(self, receivers: Collection[str]) -> dict[str, Progress]:
        """Read the newest progress of each receiver; a receiver without a line is left out.

        Reads backwards until all are found: for a receiver without a line, the complete log.

        Raises
        ------
        OSError
            The file cannot be read.
        """
        progress: dict[str, Progress] = {}
        end: int | None = None
        while progress.keys() < set(receivers):
            lines, end = self.read(limit=PAGE_LINES, end=end)
            for _, line in lines:
                if line.place is not None and line.receiver in receivers:
                    progress.setdefault(line.receiver, line.place)
            if end is None:
                break
        return progress


def _parse_delivery(row: object) -> Delivery:
    """Convert the row of a line, also of an earlier version (then ``row`` is updated), to a delivery.

    Raises KeyError or TypeError if the row has other fields.
    """
    assert isinstance(row, dict)
    progress = row["place"]
    if "told" in row:  # line of an earlier version
        row["result"] = row.pop("told")
    return Delivery(**{**row, "place": None if progress is None else Progress(**progress)})
