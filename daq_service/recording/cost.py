"""Wall time of a run by stage, printed at its end and stored with its last event."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

STAGES = (
    "strike_and_read_s",
    "extract_s",
    "image_s",
    "write_s",
    "fsync_s",
    "directory_fsync_s",
    "judge_s",
    "commit_s",
)


class Cost:
    """Seconds of wall time by stage."""

    def __init__(self, clock_s: Callable[[], float] = time.perf_counter) -> None:
        self.sets = 0
        self._clock_s, self._started_s = clock_s, clock_s()
        self.seconds = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        """Add the time spent inside to a stage."""
        start = self._clock_s()
        try:
            yield
        finally:
            self.seconds[stage] += self._clock_s() - start

    def add_set(self, seconds: Mapping[str, float]) -> None:
        """Count a set that was stored, and add the seconds of its stages."""
        self.sets += 1
        for stage, value in seconds.items():
            self.seconds[stage] += value

    def as_row(self) -> dict[str, float]:
        """Return the sets, and seconds by stage; ``other_s`` makes them add up to the elapsed time."""
        other_s = self._clock_s() - self._started_s - sum(self.seconds.values())
        seconds = {**self.seconds, "other_s": other_s}
        return {"sets": self.sets, **{stage: round(value, 3) for stage, value in seconds.items()}}
