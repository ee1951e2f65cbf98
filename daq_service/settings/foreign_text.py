"""Texts of other people where they leave the program: names, notes, file names, an instrument's replies.

A terminal obeys control characters, a log takes a line break for a new line, and a spreadsheet executes a
cell that begins like a formula.
"""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

_BLANK = (
    "\\x00-\\x20\\x7f-\\xa0\\xad\\u034f\\u061c\\u115f\\u1160\\u1680\\u17b4\\u17b5\\u180b-\\u180f\\u2000-\\u200f"
    "\\u2028-\\u202f\\u205f-\\u206f\\u2800\\u3000\\u3164\\ufe00-\\ufe0f\\ufeff\\uffa0\\ufff0-\\ufffb"
)
"""Spaces, control characters and characters without a shape, of the basic plane."""
WRITTEN = re.compile(f"[^{_BLANK}]")
"""Something that can be seen, for Python and for JSON Schema alike."""
_CONTROLS = "\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069"
_CONTROL = re.compile(f"(?!^\r)[{_CONTROLS}]")
"""A carriage return may begin a text: progress rewrites its line."""
_CONTROL_OR_BREAK = re.compile(f"[\n{_CONTROLS}]")
_FORMULA = re.compile(r"[\t\r\n]|\s*[=+\-@\uff1d\uff0b\uff0d\uff20]")


def require_visible_text(text: str, *, message: str) -> str:
    """Check that a text has visible characters and return it.

    Raises
    ------
    ValueError
        It is empty or blank, with ``message``.
    """
    if not WRITTEN.search(text):
        raise ValueError(message)
    return text


def escape_controls(text: str) -> str:
    """Write control characters as their escapes; line breaks and tabs stay."""
    return _CONTROL.sub(_escape_character, text)


def to_one_line(text: str) -> str:
    """Write control characters and line breaks as their escapes."""
    return _CONTROL_OR_BREAK.sub(_escape_character, text)


def escape_all_to_one_line(values: Any) -> Any:
    """Apply `to_one_line` to every text of a JSON-ready value."""
    if isinstance(values, dict):
        return {name: escape_all_to_one_line(value) for name, value in values.items()}
    if isinstance(values, (list, tuple)):
        return [escape_all_to_one_line(value) for value in values]
    return to_one_line(values) if isinstance(values, str) else values


def escape_spreadsheet_cell(text: str) -> str:
    """Return a text with a leading apostrophe if a spreadsheet would execute it."""
    return f"'{text}" if _FORMULA.match(text) else text


def _escape_character(match: re.Match[str]) -> str:
    """Return a character as its escape sequence."""
    return ascii(match[0])[1:-1]


class PlainStream:
    """A text stream to which control characters come as their escapes."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Write a text with its control characters escaped."""
        return self.stream.write(escape_controls(text))

    def __getattr__(self, name: str) -> object:
        return getattr(self.stream, name)


@contextmanager
def escape_output() -> Iterator[None]:
    """Escape control characters in all that is written to standard output and standard error."""
    before = {name: getattr(sys, name) for name in ("stdout", "stderr")}
    try:
        for name, stream in before.items():
            setattr(sys, name, stream and PlainStream(stream))
        yield
    finally:
        for name, stream in before.items():
            setattr(sys, name, stream)


class OneLineFormatter(logging.Formatter):
    """A record is one line, with the lines of a traceback indented below it: none can be forged."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - logging's name
        """Format a log message in one line, with control characters escaped."""
        return to_one_line(super().formatMessage(record))

    def format(self, record: logging.LogRecord) -> str:
        """Format a log record with its traceback, with control characters escaped."""
        return escape_controls(super().format(record)).replace("\n", "\n  ")
