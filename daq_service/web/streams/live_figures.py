"""Live figures: follows the files `live/<position>.bin` and keeps the newest figure of each position.

Only the newest is kept: slow or hidden clients miss figures, but never events.
"""

from __future__ import annotations

import json
import logging
import struct
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq_service.web.answers.problem import Problem
from daq_service.web.streams.followed import Followed

log = logging.getLogger(__name__)
POLL_INTERVAL_S = 0.05


@dataclass(frozen=True, slots=True)
class Picture:
    """Content of a live file; `version` increases with every change."""

    version: int
    content: bytes


class LiveFigures(Followed):
    """Newest figure of each position, with a wake-up for the next one."""

    def __init__(
        self, folder: Path, positions: Collection[str], *, poll_interval_s: float = POLL_INTERVAL_S
    ) -> None:
        super().__init__("live-pictures")
        self._paths = {position: folder / f"{position}.bin" for position in positions}
        self._poll_interval_s = poll_interval_s
        self._pictures: dict[str, Picture] = {}

    def find_newer_figures(self, seen: Mapping[str, int]) -> dict[str, Picture]:
        """Return the figures that are newer than the versions in ``seen`` (by position), by position.

        Empty if there are none; positions that are not in ``seen`` are left out.
        """
        return {
            position: picture
            for position, version in seen.items()
            if (picture := self._pictures.get(position)) is not None and picture.version > version
        }

    def _update_figure(self, position: str, picture: Picture) -> None:
        """Store the newest figure of a position and wake the clients."""
        self._pictures[position] = picture
        self._wake_clients()

    def _follow(self) -> None:
        """Check time, inode and size of the files and pass on changed ones, until `close` (thread body).

        Files that are missing or unreadable are tried again.
        """
        seen: dict[str, tuple[int, int, int]] = {}
        version = 0
        while not self._stop.is_set():
            for position, path in self._paths.items():
                try:
                    state = path.stat()
                    mark = (state.st_mtime_ns, state.st_ino, state.st_size)
                    if seen.get(position) == mark:
                        continue
                    content = path.read_bytes()
                except FileNotFoundError:
                    continue
                except OSError as error:
                    # Windows refuses to open a file at the moment it is replaced: next time.
                    log.debug("cannot read %s: %s", path, error)
                    continue
                seen[position] = mark
                version += 1
                self._call_on_event_loop(self._update_figure, position, Picture(version, content))
            self._stop.wait(self._poll_interval_s)


def decode_figure_header(content: bytes) -> dict[str, Any]:
    """Decode the JSON header of a live figure (u32 length, header, samples).

    Raises
    ------
    Problem
        503: the bytes are not a live figure, or cut off.
    """
    try:
        (length,) = struct.unpack_from("<I", content)
        header = json.loads(content[4 : 4 + length])
        if not isinstance(header, dict) or len(content) < 4 + length:
            raise ValueError("the header is cut off")
    except (struct.error, ValueError) as error:
        raise create_unreadable_figure(f"it is damaged, {error}") from None
    return header


def create_unreadable_figure(why: str) -> Problem:
    """Create, without raising it, the error that a live figure is unreadable (503)."""
    return Problem(
        "storage-unavailable",
        f"The newest live waveform cannot be read: {why}.",
        "The recorder replaces it with its next record; stored records are not concerned.",
        title="The live waveform cannot be read",
    )
