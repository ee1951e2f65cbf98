"""The recorder's sign of life, advanced by the recording line itself and read by its supervisor.

One small file, replaced by rename at most twice a second and where something else begins. Its age is
measured on the machine's monotonic clock, so a step of UTC neither kills nor hides a recorder; that clock
begins anew with each boot, so the file names the boot.
"""

from __future__ import annotations

import json
import logging
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

from daq_service.clock import boot_name
from hardware_drivers.nanoseconds import NS_PER_S

log = logging.getLogger(__name__)

FILE_NAME = "heartbeat.json"
SHORTEST_INTERVAL_NS = 500_000_000

NEWS_AFTER_COSTS = 100
"""What is begun is told at once, unless the last news is younger than so many times what a beat cost: also in
a simulated test of many stages a second beats take a hundredth of the time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Beat:
    """What the file says.

    Attributes
    ----------
    boot
        Name of the boot that ``mono_ns`` counts in; None where it has none (`clock.boot_name`).
    """

    process: int
    mono_ns: int
    deadline_s: float
    doing: str
    boot: str | None = None


class Heartbeat:
    """Writes the file.

    Parameters
    ----------
    deadline_s
        Longest time between two beats of a healthy recorder: its longest bounded call and a margin.
    """

    def __init__(
        self,
        folder: Path,
        *,
        deadline_s: float,
        mono_ns: Callable[[], int] = time.monotonic_ns,
        boot: Callable[[], str | None] = boot_name,
    ) -> None:
        self._path = folder / FILE_NAME
        self._deadline_s = deadline_s
        self._mono_ns = mono_ns
        self._boot = boot()
        self._last_ns: int | None = None
        self._last_news_ns: int | None = None
        self._last_cost_ns = 0
        self._last_doing = ""

    def beat(self, doing: str) -> None:
        """Say that the line moves, and what it is doing."""
        now = self._mono_ns()
        news = doing != self._last_doing
        last_ns = self._last_news_ns if news else self._last_ns
        pause_ns = NEWS_AFTER_COSTS * self._last_cost_ns if news else SHORTEST_INTERVAL_NS
        if last_ns is not None and now - last_ns < min(pause_ns, SHORTEST_INTERVAL_NS):
            return
        beat = Beat(
            process=os.getpid(), mono_ns=now, deadline_s=self._deadline_s, doing=doing, boot=self._boot
        )
        partial = self._path.with_suffix(".tmp")
        partial.write_text(json.dumps(asdict(beat)), encoding="utf-8")
        try:
            partial.replace(self._path)
        except PermissionError:
            return  # Windows replaces no file that somebody reads; the next beat is near
        self._last_ns, self._last_doing = now, doing
        self._last_news_ns = now if news else self._last_news_ns
        self._last_cost_ns = self._mono_ns() - now


def read_heartbeat(folder: Path) -> Beat | None:
    """Latest beat; None where no recorder ever ran, or where the file is no heartbeat (with a warning)."""
    path = folder / FILE_NAME
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        return Beat(
            process=int(values["process"]),
            mono_ns=int(values["mono_ns"]),
            deadline_s=float(values["deadline_s"]),
            doing=str(values["doing"]),
            boot=values.get("boot"),
        )
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, LookupError, AttributeError, OverflowError) as error:
        # A power cut may leave it empty or torn; whoever looks goes on as if there were none.
        _warn_once(path, f"{type(error).__name__}: {error}")
        return None


@lru_cache(maxsize=8)
def _warn_once(path: Path, why: str) -> None:
    """Once for each reason: the file is looked at many times a second."""
    log.warning("%s is no heartbeat and counts as none: %s", path, why)


def age_s(beat: Beat, *, boot: str | None, mono_ns: int) -> float | None:
    """Age of a beat at a monotonic time of a boot; None where it was written in another boot.

    Where a name is missing (`clock.boot_name`, or a file of an older version) only a time ahead tells.
    """
    other_boot = None not in (beat.boot, boot) and beat.boot != boot
    return None if other_boot or beat.mono_ns > mono_ns else (mono_ns - beat.mono_ns) / NS_PER_S
