"""Output for a person on streams that may be closed, full or held (Ctrl-S), without blocking the process."""

from __future__ import annotations

import json
import logging
import os
import sys
import threading
from collections.abc import Iterable
from contextlib import suppress

import click

log = logging.getLogger(__name__)

PRINTING = "printing"
"""Name of printing threads: one that is left at the end holds a stream, which Python could not flush."""
HELD_AFTER_S = 2.0
"""A stream that accepts no line for this time is held."""


def print_line(text: str, *, err: bool = True) -> None:
    """Print a line on standard error, or on standard output, from a thread; wait for it at most 2 s.

    A closed stream is no error. If the stream accepts nothing (Ctrl-S), the thread keeps waiting after that;
    the process must then end by `force_exit_if_needed`.
    """

    def write() -> None:
        """Print the text; discard it if the stream is closed."""
        try:
            print(text, file=sys.stderr if err else sys.stdout, flush=True)
        except (OSError, ValueError) as error:
            log.debug("no reader for %r: %s", text, error)
            discard_unwritten_output()

    thread = threading.Thread(target=write, name=PRINTING, daemon=True)
    thread.start()
    thread.join(HELD_AFTER_S)


def print_result(result: object, lines: Iterable[str], *, as_json: bool) -> None:
    """Print the result of a command on standard output: one JSON object, or lines for a person.

    Blocks while the stream accepts nothing. Raises OSError if it is closed, and TypeError if ``result`` is
    not JSON-ready.
    """
    for line in [json.dumps(result)] if as_json else lines:
        click.echo(line)


def discard_unwritten_output() -> None:
    """Flush standard output and error; redirect a stream that fails to the null device.

    Otherwise Python's last flush of it would change the exit code to 120.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def force_exit_if_needed(code: int) -> None:
    """End the process at once, without cleanup, if Python would not end with this exit code; else return.

    A thread of `print_line` that still waits holds the lock of its stream, so that Python would abort the
    process; with PYTHONINSPECT it would continue to read commands from standard input.
    """
    if any(thread.name == PRINTING for thread in threading.enumerate()):
        os._exit(code)
    if "PYTHONINSPECT" in os.environ:
        discard_unwritten_output()
        os._exit(code)
