"""All commands of ``solimon``: section, name and summary, read from ``commands.toml``."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path

SECTIONS: Mapping[str, Mapping[str, str]] = tomllib.loads(
    Path(__file__).with_name("commands.toml").read_text(encoding="utf-8")
)
"""Summaries by section and command, in the order of ``solimon --help``."""


def section_of(name: str) -> str | None:
    """Return the section of a command; None if there is no such command."""
    return next((section for section, commands in SECTIONS.items() if name in commands), None)


def summary(name: str) -> str:
    """Return the summary of a command."""
    (text,) = (commands[name] for commands in SECTIONS.values() if name in commands)
    return text
