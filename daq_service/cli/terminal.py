"""Output of a command: a console with colour, progress of a running test, opening the page in a browser."""

from __future__ import annotations

import logging
import os
import queue
import sys
import threading
import webbrowser
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal, Self

import click

from daq_service.clock import MACHINE, MachineClock
from daq_service.processes.printing import HELD_AFTER_S, PRINTING, discard_unwritten_output
from daq_service.settings.foreign_text import PlainStream, escape_to_one_line
from hardware_drivers.nanoseconds import NS_PER_S

if TYPE_CHECKING:
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

log = logging.getLogger(__name__)

SHOWN_AFTER_S = 2.0
"""Minimum duration of an activity that is shown, to avoid flicker."""
LOGGED_EVERY_S = 60.0
"""A log gets a line a set, of a test in simulated time one of many."""
DRAWN_PER_S = 2.0
MOST_HELD_LINES = 10_000
"""Maximum number of waiting lines; later ones are dropped while a terminal is blocked."""


def print_set_progress(done: int, total: int) -> None:
    """Rewrite one line of standard error with the progress of a reassessment; end it at the last set."""
    click.echo(f"\rset {done} of {total} ", nl=done == total, err=True)


def create_console(stream: Literal["stdout", "stderr"]) -> Console:
    """Create rich's console of a standard stream, without markup and highlights.

    Color only on a terminal and without ``NO_COLOR``.
    """
    from rich.console import Console

    file = getattr(sys, stream)
    # Its own colours and moves of the cursor go past what escapes those of others.
    file = file.stream if isinstance(file, PlainStream) else file
    return Console(file=file, highlight=False, markup=False, emoji=False)


def format_duration(seconds: float) -> str:
    """Format a duration in s in the largest unit (d, h, min, s) of which it has at least two."""
    for unit, length_s, digits in (("d", 86_400.0, 1), ("h", 3600.0, 1), ("min", 60.0, 0)):
        if seconds >= 2.0 * length_s:
            return f"{seconds / length_s:.{digits}f} {unit}"
    return f"{seconds:.0f} s"


class ProgressReport:
    """Prints the progress of a running test on standard error: hour, alarms, gaps, restarts.

    On a terminal the last line is rewritten below the others; elsewhere (a log, a journal, which date each
    line themselves) there are only lines. A closed terminal does not end the test. A blocked one (Ctrl-S, a
    selection on Windows) does not delay it: a thread writes the lines.

    Parameters
    ----------
    news_to_stderr
        `line` writes to standard error, since standard output is used for data.
    """

    def __init__(self, *, news_to_stderr: bool = False, machine: MachineClock = MACHINE) -> None:
        """Create the report; nothing is printed before the context is entered."""
        self._news_to_stderr = news_to_stderr
        self._machine = machine
        self._live: Live | None = None
        self._lock = threading.RLock()
        self._doing, self._doing_since_s = "starting", machine.mono_s()
        self._preparing_since_s: float | None = None
        self._pace = ""
        self._progress, self._logged_s = "", -float("inf")
        self._gap: tuple[str, int, int] | None = None
        self._lines: queue.SimpleQueue[tuple[str, bool, str] | None] = queue.SimpleQueue()
        self._writer = threading.Thread(target=self._write_queued_lines, name=PRINTING, daemon=True)

    def __enter__(self) -> Self:
        """Prepare the live line if standard error is a terminal, and start the writing thread."""
        if sys.stderr.isatty():
            from rich.live import Live

            self._live = Live(
                console=create_console("stderr"),
                get_renderable=self._compose_progress_line,
                refresh_per_second=DRAWN_PER_S,
                transient=True,
                redirect_stdout=False,
                redirect_stderr=False,
            )
        self._writer.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Queue the last lines and end the writing thread; wait for it at most `HELD_AFTER_S`."""
        self._print_gap_end()
        self._lines.put(None)
        self._writer.join(HELD_AFTER_S)

    def line(self, text: str) -> None:
        """Queue a line for standard output, or for standard error with ``news_to_stderr``; never blocks."""
        self._queue_line(text, err=self._news_to_stderr)

    def _queue_line(self, text: str, *, err: bool = True, style: str = "") -> None:
        """Add a line to the queue of the writing thread; drop it if `MOST_HELD_LINES` are waiting.

        ``err`` chooses standard error. Never blocks. Control characters are escaped.
        """
        if self._lines.qsize() < MOST_HELD_LINES:
            self._lines.put((escape_to_one_line(text), err, style))

    def _write_queued_lines(self) -> None:
        """Print the queued lines until None is queued (body of the writing thread).

        Starts and stops the live display, and discards what a blocked terminal has not taken.
        """
        live = self._live
        if live is not None:
            with suppress(OSError):  # the terminal is gone
                live.start()
                # It is hidden for a picture that flickers; a process that is killed would leave it so.
                live.console.show_cursor(True)
        for text, err, style in iter(self._lines.get, None):
            self._print(text, err=err, style=style)
        if live is not None:
            with suppress(OSError):
                live.stop()
            self._live = None
            if self._progress:
                self._print(self._progress, err=True, style="")
        discard_unwritten_output()

    def _print(self, text: str, *, err: bool, style: str) -> None:
        """Print a line, above the live display if there is one; ignore a closed terminal."""
        try:
            if self._live is not None and (err or sys.stdout.isatty()):
                self._live.console.print(text, style=style, soft_wrap=True)
            else:
                click.echo(text, err=err)
        except (OSError, ValueError) as gone:  # ValueError: closed, or letters that its encoding lacks
            log.debug("no reader for %r: %s", text, gone)

    def _compose_progress_line(self) -> Text:
        """Compose the line rewritten on a terminal: progress, and an activity longer than `SHOWN_AFTER_S`."""
        from rich.text import Text

        with self._lock:
            doing, since_s = self._doing, self._doing_since_s
        took_s = self._machine.mono_s() - since_s
        long = f"{doing}; {format_duration(took_s)} so far" if took_s >= SHOWN_AFTER_S else ""
        text = "; ".join(filter(None, (self._progress, self._pace, long))) or doing
        return Text(escape_to_one_line(text), no_wrap=True, overflow="ellipsis")

    # Events of a recorder, direct or through its supervisor -----------------------------------------------

    def __call__(self, event: str, **values: Any) -> None:
        """Print or store an event of the recorder; events without a method ``_report_EVENT`` are ignored."""
        hear = getattr(self, f"_report_{event}", None)
        if hear is not None:
            with self._lock:
                hear(**values)

    def report_message(self, child: str, message: Mapping[str, Any]) -> None:
        """Print a message that a supervisor received from a child process.

        Of children other than the recorder only restarts and printed lines are shown.
        """
        values = {name: value for name, value in message.items() if name != "event"}
        if message["event"] == "restarts":
            self._queue_line(
                f"{child} {values['cause']}; started again in {values['in_s']:g} s", style="yellow"
            )
        elif message["event"] == "printed":
            self._queue_line(values["text"])
        elif child == "recorder":
            self(message["event"], **values)

    def _report_beat(self, *, doing: str, pace_h_per_s: float | None = None, **_: object) -> None:
        """Store the recorder's activity ``doing``, when it changed, and a pace slower than the set one."""
        self._pace = "" if pace_h_per_s is None else f"slower than set: {pace_h_per_s:.2g} h per s"
        if doing != self._doing:
            self._doing, self._doing_since_s = doing, self._machine.mono_s()

    def _report_preparing(self, *, what: str) -> None:
        """Store the progress of a preparation, such as a compilation, and when it started."""
        self._preparing_since_s = self._preparing_since_s or self._machine.mono_s()
        self._report_beat(doing=what)

    def _report_prepared(self, *, what: str) -> None:
        """Print the duration of a finished preparation if it took `SHOWN_AFTER_S` or longer."""
        now_s = self._machine.mono_s()
        took_s = now_s - (self._preparing_since_s or now_s)
        self._preparing_since_s = None
        if took_s >= SHOWN_AFTER_S:
            self._queue_line(f"{what}: took {format_duration(took_s)}")

    def _report_progress(self, *, done: int, planned: int, due_h: float) -> None:
        """Store the hour and number of the last set; without a terminal print it every `LOGGED_EVERY_S`.

        The last planned set is always printed.
        """
        self._progress = f"hour {due_h:.1f}, set {done} of {planned}"
        if self._gap is not None and done - 1 > self._gap[2]:
            self._print_gap_end()
        now_s = self._machine.mono_s()
        if self._live is None and (done == planned or now_s - self._logged_s >= LOGGED_EVERY_S):
            self._logged_s = now_s
            self._queue_line(self._progress)

    def _report_alarm(self, *, change: str, hour: float, priority: str, message: str, **_: object) -> None:
        """Print a change of an alarm with its hour; an alarm that becomes active in bold red."""
        is_active = change in ("alarm_raised", "alarm_priority_raised", "alarm_reactivated")
        text = f"ALARM, {priority}" if is_active else change.replace("_", " ")
        self._queue_line(f"hour {hour:.1f}, {text}: {message}", style="bold red" if is_active else "")

    def _report_due(self, *, set_index: int, due_h: float, due_utc_ns: int, in_s: float) -> None:
        """Print when the first set of this recorder is due: hour, UTC, and in how many minutes."""
        utc = datetime.fromtimestamp(due_utc_ns // NS_PER_S, tz=UTC)
        self._queue_line(
            f"set {set_index} is due at hour {due_h:g}, {utc:%Y-%m-%d %H:%M} UTC, in {in_s / 60.0:.0f} min"
        )

    def _report_waits(self, *, reason: str) -> None:
        """Print the reason why the recorder waits, in yellow."""
        self._queue_line(f"waiting: {reason}", style="yellow")

    def _report_asked(
        self, *, text: str, within_s: float, position: str = "", shot_index: int | None = None, **_: object
    ) -> None:
        """Print a request to the person at the rig, with the time to act and the shot, if any."""
        shot = "" if shot_index is None else f" (position {position}, shot {shot_index + 1})"
        self._queue_line(f"{text}{shot}: within {format_duration(within_s)}", style="bold")

    def _report_gap(self, *, set_index: int, state: str, positions: list[str], reason: str) -> None:
        """Print the first of consecutive incomplete sets with equal description; the others are counted."""
        description = f"{state} at {', '.join(positions)}: {reason}"
        if self._gap is not None and self._gap[0] == description:
            self._gap = (description, self._gap[1], set_index)
            return
        self._print_gap_end()
        self._gap = (description, set_index, set_index)
        self._queue_line(f"set {set_index} {description}", style="yellow")

    def _print_gap_end(self) -> None:
        """Print the range of the further incomplete sets, if there are any, and reset the gap."""
        if self._gap is not None and self._gap[2] > self._gap[1]:
            description, first, last = self._gap
            others = f"set {last}" if last == first + 1 else f"sets {first + 1} to {last}"
            self._queue_line(f"{others}, too, {description}", style="yellow")
        self._gap = None


# A page on a screen ---------------------------------------------------------------------------------------


def describe_missing_screen(environment: Mapping[str, str], platform: str = sys.platform) -> str:
    """Return why a page opened by this process would not be visible; empty if there is a screen.

    Reasons: standard error is no terminal, CI, SSH, or no display on a ``platform`` that needs one.
    ``environment`` has the variables.
    """
    if not sys.stderr.isatty():
        return "no terminal"
    if environment.get("CI"):
        return "CI"
    if any(environment.get(name) for name in ("SSH_CONNECTION", "SSH_CLIENT", "SSH_TTY")):
        return "SSH"
    has_screen = any(environment.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return "" if has_screen or platform in ("win32", "darwin") else "no DISPLAY"


def open_page(url: str) -> bool:
    """Open a page in the browser of this computer; return False without screen or browser.

    The browser starts in a daemon thread, since that may take seconds: True does not mean that it succeeded.
    A browser that would occupy the terminal is not used unless the variable ``BROWSER`` is set.
    """
    if describe_missing_screen(os.environ):
        return False
    try:
        browser = webbrowser.get()
    except webbrowser.Error:
        return False
    takes_terminal = isinstance(browser, webbrowser.GenericBrowser) and not isinstance(
        browser, webbrowser.BackgroundBrowser
    )
    if takes_terminal and "BROWSER" not in os.environ:
        return False
    threading.Thread(target=browser.open, args=(url,), name="open-page", daemon=True).start()
    return True
