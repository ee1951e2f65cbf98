"""Levels of the physical lines: planned as pulses, recorded to the nanosecond.

A counter's pulse is made by hardware, so its edges are known when it starts; they enter the record once
their time has come (`settle`), or never, if the pulse is cut before.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

EDGES_KEPT = 200_000
"""The record is a ring of the newest edges."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LineEvent:
    """Change of a line's level.

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
class Pulse:
    """Pulse of a counter output: high from `start_ns` to `end_ns`."""

    line: str
    start_ns: int
    end_ns: int


class LineRecord:
    """Present levels, active pulses, and all level changes."""

    def __init__(self) -> None:
        self._levels: dict[str, int] = {}
        self._edges: dict[str, list[tuple[int, int]]] = {}
        self._events: deque[LineEvent] = deque(maxlen=EDGES_KEPT)

    @property
    def events(self) -> tuple[LineEvent, ...]:
        """Return the newest `EDGES_KEPT` level changes, in the order of recording."""
        return tuple(self._events)

    def clear_events(self) -> None:
        """Discard the recorded level changes; levels and scheduled pulses stay."""
        self._events.clear()

    def level(self, line: str) -> int:
        """Return the present level of a line, 0 or 1; one that was never driven is low."""
        return self._levels.get(line, 0)

    def drive(self, line: str, level: int, ns: int, cause: str) -> None:
        """Drive a line to a level (0 or 1) at a monotonic time in ns; scheduled edges stay.

        A change of the level is recorded with its cause.
        """
        if self.level(line) != level:
            self._levels[line] = level
            self._events.append(LineEvent(line=line, level=level, ns=ns, cause=cause))

    def start(self, pulse: Pulse) -> None:
        """Schedule both edges of a pulse in place of those that are still due on its line."""
        self._edges[pulse.line] = [(pulse.start_ns, 1), (pulse.end_ns, 0)]

    def settle(self, now_ns: int) -> None:
        """Drive and record every scheduled edge that is due by ``now_ns``, of all lines in order of time."""
        while self._edges:
            line = min(self._edges, key=lambda name: self._edges[name][0])
            ns, level = self._edges[line][0]
            if ns > now_ns:
                return
            self.drive(line, level, ns, "pulse")
            del self._edges[line][0]
            if not self._edges[line]:
                del self._edges[line]

    def cut(self, line: str, level: int, ns: int, cause: str) -> None:
        """Cancel the scheduled edges of a line and drive it to a level (0 or 1) at a monotonic time in ns."""
        self._edges.pop(line, None)
        self.drive(line, level, ns, cause)
