"""Guidance for each kind of alarm: one table for the page, the API and the how-to.

`docs/how-to/respond-to-an-alarm.md` shows `format_guidance_markdown`; a test compares.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class Guidance:
    """What an operator needs to know of a kind of alarm.

    Attributes
    ----------
    meaning, limitations
        What has been found, and what that does not prove.
    checks
        Likely causes, in the order in which to look.
    short
        The same in a sentence or two, for a message.
    contact
        Who decides.
    """

    meaning: str
    limitations: str
    checks: Sequence[str]
    short: str
    contact: str


GUIDANCE: Mapping[str, Guidance] = {
    kind: Guidance(**texts)
    for kind, texts in tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")).items()
}
"""By kind of alarm, the gravest for the wall first."""


def join_numbered_steps(steps: Sequence[str]) -> str:
    """Join steps, numbered from 1, to one text; empty for no steps.

    They are separated by "; ", but only by a space after a question mark.
    """
    parts = [f"{number} {step}" for number, step in enumerate(steps, start=1)]
    return "".join(part + (" " if part.endswith("?") else "; ") for part in parts).rstrip("; ")


def format_guidance_markdown() -> str:
    """Return the guidance on all kinds of alarm as a Markdown table, one row per kind, as in `GUIDANCE`."""
    lines = ["| Kind | It says | It does not say | Look first | Whom to call |", "|---|---|---|---|---|"]
    for kind, guidance in GUIDANCE.items():
        cells = (
            f"`{kind}`",
            guidance.meaning,
            guidance.limitations,
            join_numbered_steps(guidance.checks),
            guidance.contact,
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
