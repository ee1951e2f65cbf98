"""What whoever started a command sees: a console with colour, a running test's news, the page on a screen."""

from __future__ import annotations

import logging
import os
import queue
import sys
import threading
import time
import webbrowser
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Literal, Self

import click

from daq_service.processes.printing import HELD_AFTER_S, PRINTING, discard_unwritten
from daq_service.settings.foreign_text import PlainStream, in_one_line

if TYPE_CHECKING:
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

log = logging.getLogger(__name__)

SHOWN_AFTER_S = 2.0
"""What is being done is told when it takes this long: words that flicker tell nobody anything."""
LOGGED_EVERY_S = 60.0
"""A log gets a line a set, of a test in simulated time one of many."""
DRAWN_PER_S = 2.0
MOST_HELD_LINES = 10_000
"""Later lines are dropped while a terminal is held."""


def console_on(stream: Literal["stdout", "stderr"]) -> Console:
    """Return rich's console: colour only on a terminal and without ``NO_COLOR``; it invents no highlights."""
    from rich.console import Console

    file = getattr(sys, stream)
    # Its own colours and moves of the cursor go past what escapes those of others.
    file = file.stream if isinstance(file, PlainStream) else file
    return Console(file=file, highlight=False, markup=False, emoji=False)


def duration(seconds: float) -> str:
    """Tell a time in the unit in which it has two or three digits."""
    for unit, length_s, digits in (("d", 86_400.0, 1), ("h", 3600.0, 1), ("min", 60.0, 0)):
        if seconds >= 2.0 * length_s:
            return f"{seconds / length_s:.{digits}f} {unit}"
    return f"{seconds:.0f} s"


class ProgressReport:
    """Tells of a running test on standard error: how far it is, its alarms, its gaps, its restarts.

    On a terminal the last line is rewritten and the others stay above it; elsewhere (a log, a journal, which
    date each line themselves) there are only lines. A terminal that is gone ends no test. One that is held
    (Ctrl-S, a selection on Windows) keeps nobody waiting: a thread writes, and whoever tells goes on.

    Parameters
    ----------
    news_to_stderr
        Where `line` writes: standard output belongs to somebody else.
    mono_s
        Monotonic time.
    """

    def __init__(self, *, news_to_stderr: bool = False, mono_s: Callable[[], float] = time.monotonic) -> None:
        self._news_to_stderr = news_to_stderr
        self._mono_s = mono_s
        self._live: Live | None = None
        self._lock = threading.RLock()
        self._doing, self._doing_since_s = "starting", mono_s()
        self._preparing: list[tuple[str, float]] = []
        self._progress, self._logged_s = "", -float("inf")
        self._gap: tuple[str, int, int] | None = None
        self._lines: queue.SimpleQueue[tuple[str, bool, str] | None] = queue.SimpleQueue()
        self._writer = threading.Thread(target=self._write, name=PRINTING, daemon=True)

    def __enter__(self) -> Self:
        if sys.stderr.isatty():
            from rich.live import Live

            self._live = Live(
                console=console_on("stderr"),
                get_renderable=self._text,
                refresh_per_second=DRAWN_PER_S,
                transient=True,
                redirect_stdout=False,
                redirect_stderr=False,
            )
        self._writer.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end_gap()
        self._lines.put(None)
        self._writer.join(HELD_AFTER_S)

    def line(self, text: str) -> None:
        """Tell what a person asked for, on standard output as a rule."""
        self._say(text, err=self._news_to_stderr)

    def _say(self, text: str, *, err: bool = True, style: str = "") -> None:
        if self._lines.qsize() < MOST_HELD_LINES:
            self._lines.put((in_one_line(text), err, style))

    def _write(self) -> None:
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
        discard_unwritten()

    def _print(self, text: str, *, err: bool, style: str) -> None:
        try:
            if self._live is not None and (err or sys.stdout.isatty()):
                self._live.console.print(text, style=style, soft_wrap=True)
            else:
                click.echo(text, err=err)
        except (OSError, ValueError) as gone:  # ValueError: closed, or letters that its encoding lacks
            log.debug("nobody reads %r: %s", text, gone)

    def _text(self) -> Text:
        """Compose the line that is rewritten."""
        from rich.text import Text

        with self._lock:
            doing, since_s = self._preparing[-1] if self._preparing else (self._doing, self._doing_since_s)
        took_s = self._mono_s() - since_s
        long = f"{doing}; {duration(took_s)} so far" if took_s >= SHOWN_AFTER_S else ""
        told = "; ".join(filter(None, (self._progress, long))) or doing
        return Text(in_one_line(told), no_wrap=True, overflow="ellipsis")

    # What a recorder says, by itself or to its supervisor -------------------------------------------------

    def __call__(self, event: str, **values: Any) -> None:
        """Hear an event of the recorder; what is not listed is nothing to be told."""
        hear = getattr(self, f"_hear_{event}", None)
        if hear is not None:
            with self._lock:
                hear(**values)

    def hear(self, child: str, message: Mapping[str, Any]) -> None:
        """Hear a message that a supervisor has from a child."""
        values = {name: value for name, value in message.items() if name != "event"}
        if message["event"] == "restarts":
            self._say(f"{child} {values['cause']}; started again in {values['in_s']:g} s", style="yellow")
        elif message["event"] == "printed":
            self._say(values["text"])
        elif child == "recorder":
            self(message["event"], **values)

    def _hear_beat(self, *, doing: str, **_: Any) -> None:
        if doing != self._doing:
            self._doing, self._doing_since_s = doing, self._mono_s()

    def _hear_preparing(self, *, what: str) -> None:
        self._preparing.append((what, self._mono_s()))

    def _hear_prepared(self, *, what: str) -> None:
        begun = [item for item in self._preparing if item[0] == what]
        if begun:  # else a line was lost on the way
            self._preparing.remove(begun[-1])
            took_s = self._mono_s() - begun[-1][1]
            if took_s >= SHOWN_AFTER_S:
                self._say(f"{what}: took {duration(took_s)}")

    def _hear_progress(self, *, done: int, planned: int, due_h: float) -> None:
        self._progress = f"hour {due_h:.1f}, set {done} of {planned}"
        if self._gap is not None and done - 1 > self._gap[2]:
            self._end_gap()
        now_s = self._mono_s()
        if self._live is None and (done == planned or now_s - self._logged_s >= LOGGED_EVERY_S):
            self._logged_s = now_s
            self._say(self._progress)

    def _hear_alarm(self, *, change: str, hour: float, severity: str, message: str, **_: Any) -> None:
        stands = change in ("alarm_raised", "alarm_worsened", "alarm_returned")
        words = f"ALARM, {severity}" if stands else change.replace("_", " ")
        self._say(f"hour {hour:.1f}, {words}: {message}", style="bold red" if stands else "")

    def _hear_waits(self, *, why: str) -> None:
        self._say(f"waiting: {why}", style="yellow")

    def _hear_asked(
        self, *, text: str, within_s: float, position: str = "", shot_index: int | None = None, **_: Any
    ) -> None:
        shot = "" if shot_index is None else f" (position {position}, shot {shot_index + 1})"
        self._say(f"{text}{shot}: within {duration(within_s)}", style="bold")

    def _hear_gap(self, *, set_index: int, state: str, positions: list[str], cause: str) -> None:
        """Tell the first of a row of sets that lack something for one reason; of the others the last one."""
        what = f"{state} at {', '.join(positions)}: {cause}"
        if self._gap is not None and self._gap[0] == what:
            self._gap = (what, self._gap[1], set_index)
            return
        self._end_gap()
        self._gap = (what, set_index, set_index)
        self._say(f"set {set_index} {what}", style="yellow")

    def _end_gap(self) -> None:
        if self._gap is not None and self._gap[2] > self._gap[1]:
            what, first, last = self._gap
            others = f"set {last}" if last == first + 1 else f"sets {first + 1} to {last}"
            self._say(f"{others}, too, {what}", style="yellow")
        self._gap = None


# A page on a screen ---------------------------------------------------------------------------------------


def why_no_screen(environment: Mapping[str, str], platform: str = sys.platform) -> str:
    """Say why nobody would see a page that is opened here; empty: somebody sits at a screen."""
    if not sys.stderr.isatty():
        return "no terminal"
    if environment.get("CI"):
        return "CI"
    if any(environment.get(name) for name in ("SSH_CONNECTION", "SSH_CLIENT", "SSH_TTY")):
        return "SSH"
    has_screen = any(environment.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return "" if has_screen or platform in ("win32", "darwin") else "no DISPLAY"


def open_page(url: str) -> bool:
    """Open a page in the browser of whoever sits at this computer; False where there is no screen, or none.

    In a thread, since a browser that starts may take seconds; and not in a browser that would take the
    terminal itself, unless the person named one (``BROWSER``).
    """
    if why_no_screen(os.environ):
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
