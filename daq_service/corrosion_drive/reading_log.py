"""When an instrument that is logged at intervals is read, and how good its newest reading is."""

from __future__ import annotations

from daq_service.catalogue.rows import ReadingQuality
from hardware_drivers.nanoseconds import NS_PER_S

LONGEST_GAP_INTERVALS = 3.0
"""Readings further apart than this many intervals are not joined by a straight line."""


class ReadingLog:
    """When one instrument is read, and how good the newest reading is."""

    def __init__(self, interval_s: float, now_ns: int) -> None:
        self._interval_ns = round(interval_s * NS_PER_S)
        self._longest_ns = round(LONGEST_GAP_INTERVALS * interval_s * NS_PER_S)
        self._due_ns = self._started_ns = now_ns
        self._read_ns: int | None = None
        self.trouble = ""

    def due(self, now_ns: int) -> bool:
        """Whether it is time for the next reading."""
        return now_ns >= self._due_ns

    def attempted(self, now_ns: int) -> None:
        """Plan the next attempt an interval after this one was due; what was missed is not made up for."""
        missed = (now_ns - self._due_ns) // self._interval_ns
        self._due_ns += (missed + 1) * self._interval_ns

    def look_again_at_once(self, now_ns: int) -> None:
        """Plan the next attempt for the next call."""
        self._due_ns = now_ns

    def look_again_within(self, now_ns: int, seconds: float) -> None:
        """Plan the next attempt at the latest so many seconds from now."""
        self._due_ns = min(self._due_ns, now_ns + round(seconds * NS_PER_S))

    def succeeded(self, now_ns: int) -> None:
        """Note a reading."""
        self._read_ns, self.trouble = now_ns, ""

    def silent_s(self, now_ns: int) -> float:
        """Time since the newest reading, or since the start."""
        return (now_ns - (self._started_ns if self._read_ns is None else self._read_ns)) / NS_PER_S

    def age_s(self, now_ns: int) -> float | None:
        """Age of the newest reading, None where there is none."""
        return None if self._read_ns is None else self.silent_s(now_ns)

    def too_old(self, now_ns: int) -> bool:
        """Whether the newest reading lies further back than an interval may last."""
        return self.silent_s(now_ns) * NS_PER_S > self._longest_ns

    def quality(self, now_ns: int) -> ReadingQuality:
        """Rate the newest reading.

        good: recent; stale: nobody asked for long, or the last answer is missing; lost: no answer for long.
        """
        if self.trouble:
            return "lost" if self.too_old(now_ns) else "stale"
        return "stale" if self._read_ns is None or self.too_old(now_ns) else "good"
