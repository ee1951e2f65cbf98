"""Schedule and quality of the readings of an instrument that is logged at intervals."""

from __future__ import annotations

from daq_service.catalogue.rows import ReadingQuality
from hardware_drivers.nanoseconds import NS_PER_S

LONGEST_GAP_INTERVALS = 3.0
"""Readings further apart than this many intervals are not interpolated."""


class ReadingLog:
    """Schedule of the readings of one instrument, and quality of the newest one."""

    def __init__(self, interval_s: float, now_ns: int) -> None:
        """Schedule readings from ``now_ns`` (monotonic, ns) on, every ``interval_s`` seconds."""
        self._interval_ns = round(interval_s * NS_PER_S)
        self._longest_ns = round(LONGEST_GAP_INTERVALS * interval_s * NS_PER_S)
        self._due_ns = self._started_ns = now_ns
        self._read_ns: int | None = None
        self.error = ""

    def is_due(self, now_ns: int) -> bool:
        """Return whether the next reading is due at monotonic time ``now_ns``."""
        return now_ns >= self._due_ns

    def record_attempt(self, now_ns: int) -> None:
        """Schedule the next attempt for the first time on the interval's grid after ``now_ns``.

        Attempts that were missed are skipped.
        """
        missed = (now_ns - self._due_ns) // self._interval_ns
        self._due_ns += (missed + 1) * self._interval_ns

    def schedule_now(self, now_ns: int) -> None:
        """Schedule the next attempt for now; `is_due` is True until `record_attempt`."""
        self._due_ns = now_ns

    def schedule_within(self, now_ns: int, seconds: float) -> None:
        """Schedule the next attempt at most ``seconds`` after ``now_ns``; an earlier schedule is kept."""
        self._due_ns = min(self._due_ns, now_ns + round(seconds * NS_PER_S))

    def record_success(self, now_ns: int) -> None:
        """Record the monotonic time of a successful reading, and clear the last error."""
        self._read_ns, self.error = now_ns, ""

    def silent_s(self, now_ns: int) -> float:
        """Return the time in s since the newest successful reading; since the start if there was none."""
        return (now_ns - (self._started_ns if self._read_ns is None else self._read_ns)) / NS_PER_S

    def age_s(self, now_ns: int) -> float | None:
        """Return the age in s of the newest successful reading; None if there was none."""
        return None if self._read_ns is None else self.silent_s(now_ns)

    def is_too_old(self, now_ns: int) -> bool:
        """Return whether the newest reading is older than `LONGEST_GAP_INTERVALS` intervals.

        Without a reading the time counts from the start.
        """
        return self.silent_s(now_ns) * NS_PER_S > self._longest_ns

    def quality(self, now_ns: int) -> ReadingQuality:
        """Return the quality of the newest reading: ``good``, ``stale`` or ``no_communication``.

        ``good``: read within `LONGEST_GAP_INTERVALS` intervals, without an error since. ``no_communication``:
        the last attempt failed and the reading is older than that. ``stale``: any other case.
        """
        if self.error:
            return "no_communication" if self.is_too_old(now_ns) else "stale"
        return "stale" if self._read_ns is None or self.is_too_old(now_ns) else "good"
