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
    """Return the text unchanged if it has at least one visible character.

    Raises
    ------
    ValueError
        It is empty or blank, with ``message``.
    """
    if not WRITTEN.search(text):
        raise ValueError(message)
    return text


def escape_controls(text: str) -> str:
    """Replace control and text-direction characters by escape sequences.

    Line breaks, tabs and a leading carriage return stay.
    """
    return _CONTROL.sub(_escape_character, text)


def escape_to_one_line(text: str) -> str:
    """Replace control characters and line breaks by escape sequences; tabs stay."""
    return _CONTROL_OR_BREAK.sub(_escape_character, text)


def escape_all_to_one_line(values: Any) -> Any:
    """Copy a JSON-ready value with `escape_to_one_line` applied to every text in it.

    Keys are not changed; tuples become lists.
    """
    if isinstance(values, dict):
        return {name: escape_all_to_one_line(value) for name, value in values.items()}
    if isinstance(values, (list, tuple)):
        return [escape_all_to_one_line(value) for value in values]
    return escape_to_one_line(values) if isinstance(values, str) else values


def escape_spreadsheet_cell(text: str) -> str:
    """Return the text, with an apostrophe before it if a spreadsheet would execute it as a formula."""
    return f"'{text}" if _FORMULA.match(text) else text


def _escape_character(match: re.Match[str]) -> str:
    r"""Return the escape sequence of the matched character, such as ``\x1b``."""
    return ascii(match[0])[1:-1]


class PlainStream:
    """A text stream to which control characters come as their escapes."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Write a text with its control characters escaped; return the number of characters written."""
        return self.stream.write(escape_controls(text))

    def __getattr__(self, name: str) -> object:
        """Return any other attribute of the wrapped stream."""
        return getattr(self.stream, name)


@contextmanager
def escape_output() -> Iterator[None]:
    """Escape control characters in standard output and standard error until the context ends."""
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
        """Format a log message as one line; control characters and line breaks become escape sequences."""
        return escape_to_one_line(super().formatMessage(record))

    def format(self, record: logging.LogRecord) -> str:
        """Format a log record; traceback lines are indented by two spaces and control characters escaped."""
        return escape_controls(super().format(record)).replace("\n", "\n  ")
