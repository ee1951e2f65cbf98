"""``notifications.jsonl``: what was sent to whom, and how far each receiver has been told.

Lines like those of the audit. Each line of a receiver says how far it has got, so that the newest one is all
that a restart needs. It is written before a message goes out (`sending`) and after: what a crash cuts in
between goes out once more, with the same events and so with the same key.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from daq_service.processes.line_file import append_line, newest_lines

log = logging.getLogger(__name__)

LOG_FILE = "notifications.jsonl"
TABLE = "notifications"
PAGE_LINES = 1000
What = Literal[
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
class Place:
    """How far a receiver has been told.

    Attributes
    ----------
    cursor
        Every event up to this id is settled: told, given up, or not for this receiver.
    cursor_wall_utc_ns
        When that event was written: an event of another catalogue was written at another time.
    settled
        Events behind the cursor that are settled, too.
    sending
        Events of the message that is under way.
    """

    cursor: int
    cursor_wall_utc_ns: int
    settled: list[int] = field(default_factory=list)
    sending: list[int] = field(default_factory=list)


@dataclass(frozen=True, slots=True, kw_only=True)
class Delivery:
    """One line.

    Attributes
    ----------
    told
        What happened, for a person.
    place
        None on lines that change nothing in it: trials, signs of life.
    """

    receiver: str
    what: What
    told: str
    event_ids: list[int] = field(default_factory=list)
    key: str = ""
    attempts: int = 0
    place: Place | None = None
    utc_ns: int = field(default_factory=time.time_ns)


class DeliveryLog:
    """Adds to the log of a data folder; for any thread."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / LOG_FILE
        self._trouble = ""

    def tell(self, delivery: Delivery) -> None:
        """Add a line; a disk that refuses it keeps nobody from being told that the disk is full."""
        try:
            append_line(self.path, TABLE, asdict(delivery))
        except OSError as error:
            if str(error) != self._trouble:
                log.warning("not in %s, so a crash would repeat messages: %s", LOG_FILE, error)
            self._trouble = str(error)
        else:
            self._trouble = ""

    def read(self, *, limit: int, end: int | None = None) -> tuple[list[tuple[int, Delivery]], int | None]:
        """Read the newest lines with their numbers, as `line_file.newest_lines`.

        Raises
        ------
        OSError
            The file cannot be read.
        """
        found, before = newest_lines(self.path, limit=limit, end=end)
        return [(number, _delivery(row)) for number, row in found], before

    def last_heartbeat_ns(self, receiver: str) -> int | None:
        """Return when the newest noted heartbeat message was sent, ns of UTC; None: none is noted.

        Raises
        ------
        OSError
            The file cannot be read.
        """

        def is_sent(row: Mapping[str, Any]) -> bool:
            its = (row.get("receiver"), row.get("what")) == (receiver, "heartbeat")
            return its and not str(row.get("told")).startswith("withheld")

        found, _ = newest_lines(self.path, limit=1, wanted=is_sent)
        return int(found[0][1]["utc_ns"]) if found else None

    def places(self, receivers: Collection[str]) -> dict[str, Place]:
        """Tell how far each receiver has got; one that was never told is missing.

        Raises
        ------
        OSError
            The file cannot be read.
        """
        places: dict[str, Place] = {}
        end: int | None = None
        while places.keys() < set(receivers):
            found, end = self.read(limit=PAGE_LINES, end=end)
            for _, line in found:
                if line.place is not None and line.receiver in receivers:
                    places.setdefault(line.receiver, line.place)
            if end is None:
                break
        return places


def _delivery(row: object) -> Delivery:
    assert isinstance(row, dict)
    place = row["place"]
    return Delivery(**{**row, "place": None if place is None else Place(**place)})
