"""Print progress on standard error: a rewritten line on a terminal, else a line per tenth."""

from __future__ import annotations

import sys
from typing import TextIO

from daq_service.clock import MACHINE, MachineClock

REDRAW_INTERVAL_S = 0.2
TENTHS = 10


class Progress:
    """Prints the number of finished rows, the rate and the remaining time.

    Parameters
    ----------
    total
        Rows of the sweep.
    done
        Of those, found in the work file.
    stream
        Output stream; None is standard error.
    machine
        Times of the computer.
    what
        What is counted.
    """

    def __init__(
        self,
        total: int,
        done: int,
        *,
        stream: TextIO | None = None,
        machine: MachineClock = MACHINE,
        what: str = "rows",
    ) -> None:
        """Start the timing, and print how many rows were finished before, if any."""
        self._total = total
        self._done = self._found = done
        self._stream = sys.stderr if stream is None else stream
        self._machine = machine
        self._what = what
        self._started = self._printed = machine.mono_s()
        self._terminal = self._stream.isatty()
        self._tenth = TENTHS * done // total
        if done:
            self._stream.write(f"{done} of {total} rows were finished before\n")
            self._stream.flush()

    def advance(self, rows: int) -> None:
        """Count finished rows, and print the progress if it is due or all rows are finished.

        It is due every `REDRAW_INTERVAL_S` (s) on a terminal, elsewhere at each tenth.
        """
        self._done += rows
        now = self._machine.mono_s()
        finished = self._done == self._total
        tenth = TENTHS * self._done // self._total
        due = now - self._printed >= REDRAW_INTERVAL_S if self._terminal else tenth > self._tenth
        if not (due or finished):
            return
        self._tenth, self._printed = tenth, now
        text = self._format_progress(now)
        if self._terminal:
            self._stream.write(f"\r{text:<70s}" + ("\n" if finished else ""))
        else:
            self._stream.write(f"{text}\n")
        self._stream.flush()

    def _format_progress(self, now: float) -> str:
        """Format done rows, percent, rate and remaining time; the last two only after a first row."""
        percent = 100.0 * self._done / self._total
        text = f"{self._done} of {self._total} {self._what} ({percent:.0f} %)"
        elapsed = now - self._started
        computed = self._done - self._found
        if computed == 0 or elapsed <= 0.0:
            return text
        rate = computed / elapsed
        remaining_s = (self._total - self._done) / rate
        return f"{text}, {rate:.3g} a second, {_format_duration(remaining_s)} left"


def _format_duration(seconds: float) -> str:
    """Format a duration in s as hours and minutes, minutes and seconds, or seconds."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return (
        f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"
    )
