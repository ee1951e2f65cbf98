"""A command on a pseudo-terminal, and what a person would see on its screen."""

from __future__ import annotations

import codecs
import os
import re
import select
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress

from support.waiting import WAIT_S, MachineTooSlowError, ended

if os.name != "nt":
    import pty
    import termios

COLUMNS, ROWS = 110, 40
CONTROL = re.compile(r"\x1b\[(\??)([\d;]*)([A-Za-z])|([\r\n\x07])|([^\x1b\r\n\x07]+)")


class PseudoTerminal:
    """Running command with all its output."""

    def __init__(self, process: subprocess.Popen[bytes], screen: int) -> None:
        self.process = process
        self.written = ""
        self._screen = screen
        self._decoded = codecs.getincrementaldecoder("utf-8")().decode

    def until(self, pattern: str, *, times: int = 1) -> None:
        """Read until the pattern was written this often; fail if the command ends before."""
        while len(re.findall(pattern, self.written)) < times:
            assert self._read(), f"ended without {pattern!r}: {self.written!r}"

    def enter(self, text: str = "") -> None:
        """Type a line."""
        os.write(self._screen, f"{text}\n".encode())

    def interrupt(self) -> int:
        """Press Ctrl-C, which reaches every process of the terminal; return the exit code."""
        os.killpg(self.process.pid, signal.SIGINT)
        return self.end()

    def end(self) -> int:
        """Read to the end; return the exit code."""
        while self._read():
            pass
        ended(self.process, "the command's end")
        return int(self.process.returncode)

    def _read(self) -> bool:
        if not select.select([self._screen], [], [], WAIT_S)[0]:
            raise MachineTooSlowError("another word of the command")
        try:
            new = os.read(self._screen, 65536)
        except OSError:  # Linux: the other side is closed
            new = b""
        self.written += self._decoded(new)  # a read may end within a character
        return bool(new)

    def shown(self) -> list[str]:
        """Return the lines on the screen and those that scrolled off its top."""
        return shown(self.written)


@contextmanager
def on_terminal(command: Sequence[str], environment: Mapping[str, str]) -> Iterator[PseudoTerminal]:
    """Start a command on its own terminal, without a desktop; it ends with the block."""
    screen, side = pty.openpty()
    termios.tcsetwinsize(side, (ROWS, COLUMNS))
    desktop = ("DISPLAY", "WAYLAND_DISPLAY", "CI", "NO_COLOR", "FORCE_COLOR", "COLUMNS", "LINES")
    kept = {name: value for name, value in os.environ.items() if name not in desktop}
    try:
        process = subprocess.Popen(
            command,
            stdin=side,
            stdout=side,
            stderr=side,
            start_new_session=True,
            env={**kept, "TERM": "xterm-256color", **environment},
        )
    finally:
        os.close(side)
    try:
        yield PseudoTerminal(process, screen)
    finally:
        with suppress(ProcessLookupError):  # the whole group may have ended, as it should
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        os.close(screen)


def shown(written: str) -> list[str]:
    """Interpret cursor movements and erasures, as far as rich uses them; return the lines."""
    lines, row, column = [""], 0, 0
    aside: list[str] = []
    for private, numbers, letter, control, text in CONTROL.findall(written):
        if text:
            line = lines[row].ljust(column)
            lines[row], column = line[:column] + text + line[column + len(text) :], column + len(text)
        elif control == "\r":
            column = 0
        elif control == "\n":
            row += 1
            lines += [""] * (row + 1 - len(lines))
        elif private and numbers == "1049":  # a screen of its own, and back
            lines, aside = ([""] * ROWS, lines) if letter == "h" else (aside, lines)
            row, column = (0 if letter == "h" else len(lines) - 1), 0
        elif letter == "A":
            row = max(0, row - int(numbers or 1))
        elif letter == "H":
            row = column = 0
        elif letter == "K":
            lines[row] = "" if numbers == "2" else lines[row][:column]
        elif letter == "J":
            lines[row:] = [""]
        else:
            assert letter in "mhl", f"{letter!r} is not known to this screen"
    return [line.rstrip() for line in lines]
