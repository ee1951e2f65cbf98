"""The recorder's sign of life, advanced by the recording line itself and read by its supervisor.

One small file, replaced by rename at most twice a second and where something else begins. Its age is
measured on the machine's monotonic clock, so a step of UTC neither kills nor hides a recorder.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

FILE_NAME = "heartbeat.json"
SHORTEST_INTERVAL_NS = 500_000_000

NEWS_AFTER_COSTS = 100
"""What is begun is told at once, unless the last beat is younger than so many times what it cost: also in a
simulated test of many stages a second beats take a hundredth of the time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Beat:
    """What the file says."""

    process: int
    mono_ns: int
    deadline_s: float
    doing: str


class Heartbeat:
    """Writes the file.

    Parameters
    ----------
    deadline_s
        Longest time between two beats of a healthy recorder: its longest bounded call and a margin.
    """

    def __init__(
        self, folder: Path, *, deadline_s: float, mono_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._path = folder / FILE_NAME
        self._deadline_s = deadline_s
        self._mono_ns = mono_ns
        self._last_ns: int | None = None
        self._last_cost_ns = 0
        self._last_doing = ""

    def beat(self, doing: str) -> None:
        """Say that the line moves, and what it is doing."""
        now = self._mono_ns()
        news = doing != self._last_doing
        pause_ns = NEWS_AFTER_COSTS * self._last_cost_ns if news else SHORTEST_INTERVAL_NS
        if self._last_ns is not None and now - self._last_ns < min(pause_ns, SHORTEST_INTERVAL_NS):
            return
        text = json.dumps(
            {"process": os.getpid(), "mono_ns": now, "deadline_s": self._deadline_s, "doing": doing}
        )
        partial = self._path.with_suffix(".tmp")
        partial.write_text(text, encoding="utf-8")
        partial.replace(self._path)
        self._last_ns, self._last_doing = now, doing
        self._last_cost_ns = self._mono_ns() - now


def read_heartbeat(folder: Path) -> Beat | None:
    """Latest beat; None where no recorder ever ran."""
    try:
        values = json.loads((folder / FILE_NAME).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    return Beat(
        process=int(values["process"]),
        mono_ns=int(values["mono_ns"]),
        deadline_s=float(values["deadline_s"]),
        doing=str(values["doing"]),
    )


def overdue_s(beat: Beat, *, mono_ns: int) -> float:
    """Seconds past the deadline; negative while the recorder is in time."""
    return (mono_ns - beat.mono_ns) / 1e9 - beat.deadline_s
