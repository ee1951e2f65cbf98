"""Statuses that the doubles answer with: ``statuses.RUNNING`` is the code of that name in `statuses.toml`.

Texts of NI-DAQmx close with the task's name and the number, as NI's do.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_ROWS = tomllib.loads(Path(__file__).with_name("statuses.toml").read_text(encoding="utf-8"))
CODES: Mapping[str, int] = {name: row["code"] for name, row in _ROWS.items()}
TEXTS: Mapping[int, str] = {row["code"]: row["text"] for row in _ROWS.values()}


def __getattr__(name: str) -> int:
    """Return the code of a status by its name in ``statuses.toml``; raise AttributeError if there is none."""
    if name not in CODES:
        raise AttributeError(f"statuses.toml has no status {name!r}")
    return CODES[name]


class Status(Exception):  # noqa: N818 - a warning is a status too
    """Status of a call that is not plain success.

    Parameters
    ----------
    code
        Negative for an error, positive for a warning.
    detail
        Details after the code's own text.
    task
        Name of the task concerned.
    values
        Out parameters that are answered all the same: all of them with a warning.
    """

    def __init__(
        self, code: int, detail: str = "", *, task: str = "", values: Mapping[str, Any] | None = None
    ) -> None:
        self.code = code
        self.values = dict(values or {})
        self.message = self._text(TEXTS.get(code, "A test requested this status."), detail, task)
        super().__init__(self.message)

    def _text(self, text: str, detail: str, task: str) -> str:
        """Format the message of a status as NI-DAQmx does: text and detail, if any, task and code."""
        task_line = f"Task Name: {task}" if task else ""
        return "\n".join(filter(None, [text, detail, task_line, f"Status Code: {self.code}"]))


class ScopeStatus(Status):
    """Status of NI-SCOPE: its message has no task and no number."""

    def _text(self, text: str, detail: str, task: str) -> str:
        """Format the message of a status as NI-SCOPE does: text and detail, without task and code."""
        return "\n".join(filter(None, [text, detail]))


def create_rejection(
    task: str, name: str, detail: str = "", *, code: int = CODES["INVALID_VALUE"], **values: object
) -> Status:
    """Create, not raise, the status for a property value that the driver rejects.

    Parameters
    ----------
    name
        Name of the property, such as ``SampClk.Rate``.
    **values
        ``requested``, ``minimum`` and ``maximum``, in NI's words; each is a line of the message.
    """
    value_lines = [f"{label.title()} Value: {value}" for label, value in values.items()]
    return Status(code, "\n".join([f"Property: {name}", *value_lines, *filter(None, [detail])]), task=task)
