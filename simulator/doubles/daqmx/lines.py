"""Levels of the physical lines: planned as pulse trains, recorded to the nanosecond.

A counter's pulse is made by hardware, so its edges are known when it starts; they enter the record once
their time has come (`settle`), or never, if the train is cut before.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

EDGES_KEPT = 200_000
"""The record is a ring of the newest edges."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LineEvent:
    """A line changed its level.

    Attributes
    ----------
    line
        ``<serial number>/<terminal>``.
    ns
        Monotonic time.
    cause
        ``pulse``, ``idle``, ``stop``, ``watchdog``, ``reset``, ``unplug``.
    """

    line: str
    level: int
    ns: int
    cause: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PulseTrain:
    """Pulses of one counter output.

    Attributes
    ----------
    pulses
        How many; None goes on for ever.
    idle
        Level between the pulses.
    """

    line: str
    begin_ns: int
    delay_ns: int
    high_ns: int
    low_ns: int
    pulses: int | None
    idle: int

    @property
    def active_ns(self) -> int:
        """Length of one departure from the idle level."""
        return self.low_ns if self.idle else self.high_ns

    def start_ns(self, index: int) -> int:
        """When a pulse begins."""
        return self.begin_ns + self.delay_ns + index * (self.high_ns + self.low_ns)

    @property
    def end_ns(self) -> int | None:
        """When the last pulse is over, None if never."""
        return None if self.pulses is None else self.start_ns(self.pulses - 1) + self.active_ns

    def edges(self) -> Iterator[tuple[int, int]]:
        """Time and new level of every edge, in order."""
        for index in count() if self.pulses is None else range(self.pulses):
            start_ns = self.start_ns(index)
            yield start_ns, 1 - self.idle
            yield start_ns + self.active_ns, self.idle


class LineRecord:
    """Levels now, trains under way, and everything that happened."""

    def __init__(self) -> None:
        self._levels: dict[str, int] = {}
        self._since_ns: dict[str, int] = {}
        self._trains: dict[str, tuple[PulseTrain, Iterator[tuple[int, int]]]] = {}
        self._next: dict[str, tuple[int, int]] = {}
        self._events: deque[LineEvent] = deque(maxlen=EDGES_KEPT)

    @property
    def events(self) -> tuple[LineEvent, ...]:
        """What happened, in order of recording."""
        return tuple(self._events)

    def clear_events(self) -> None:
        """Forget what happened; levels and trains stay."""
        self._events.clear()

    def level(self, line: str) -> int:
        """Level now; a line nobody drove is low."""
        return self._levels.get(line, 0)

    def since_ns(self, line: str) -> int:
        """When the line took its present level."""
        return self._since_ns.get(line, 0)

    def drive(self, line: str, level: int, ns: int, cause: str) -> None:
        """Set a level and record it if it is a change."""
        if self.level(line) != level:
            self._levels[line] = level
            self._since_ns[line] = ns
            self._events.append(LineEvent(line=line, level=level, ns=ns, cause=cause))

    def start(self, train: PulseTrain) -> None:
        """Begin a train; a line carries one at a time."""
        edges = train.edges()
        self._trains[train.line] = (train, edges)
        self._next[train.line] = next(edges)

    def settle(self, now_ns: int) -> None:
        """Record every edge whose time has come, the lines together in order of time."""
        while self._next:
            line = min(self._next, key=lambda name: self._next[name][0])
            ns, level = self._next[line]
            if ns > now_ns:
                return
            self.drive(line, level, ns, "pulse")
            following = next(self._trains[line][1], None)
            if following is None:
                del self._next[line], self._trains[line]
            else:
                self._next[line] = following

    def cut(self, line: str, level: int, ns: int, cause: str) -> None:
        """End a train at a time already settled and leave the line at a level."""
        self._trains.pop(line, None)
        self._next.pop(line, None)
        self.drive(line, level, ns, cause)
