"""Tables of the how-to pages that are generated from the code.

``python -m support.reference_pages`` in ``tests/`` writes them between their markers in ``docs/how-to``;
``tests/architecture/test_how_to_pages.py`` compares.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path

from daq_service.alarms.guidance import GUIDANCE, join_numbered_steps, name_contact
from daq_service.cli.maintenance.acceptance.criteria import DEFAULTS
from daq_service.web.answers.problem import PROBLEM_TYPES

ROOT = Path(__file__).parents[2]
HOW_TO = ROOT / "docs/how-to"
FLAGS = ROOT / "daq_service/cli/doctor/trial.toml"
BLOCK = re.compile(r"(?<=<!-- generated: )(\w+) -->\n.*?(?=<!-- end -->)", flags=re.DOTALL)


def table(head: str, rows: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table; ``head`` has its titles, separated by a comma and a space."""
    titles = head.split(", ")
    lines = [titles, ["---"] * len(titles), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def alarms() -> str:
    """Return the guidance on all kinds of alarm, one row per kind."""
    rows = (
        (
            *(f"`{kind}`", found.meaning, found.limitations, join_numbered_steps(found.checks)),
            *(found.action.replace("{position}", "the position"), found.consequence, name_contact(kind)),
        )
        for kind, found in GUIDANCE.items()
    )
    return table("Kind, Meaning, Limitations, Checks in order, Action, If not done, Contact", rows)


def acceptance() -> str:
    """Return the default limits of the acceptance report."""
    rows = ((f"`{item.quantity}`", f"{item.sense} {item.limit:,.10g}") for item in DEFAULTS)
    return table("Criterion, Default limit", rows)


def flags() -> str:
    """Return the remedy of each flag of a shot."""
    remedies = tomllib.loads(FLAGS.read_text(encoding="utf-8"))
    return table("Flag, Remedy", ((f"`{flag}`", text) for flag, text in remedies.items()))


def problems() -> str:
    """Return every type of problem of the API with its remedy."""
    rows = (
        (f"`{name}`", str(kind.status), kind.title, kind.hint or "the answer's `hint`")
        for name, kind in sorted(PROBLEM_TYPES.items())
    )
    return table("Name, Status, Meaning, Remedy", rows)


TABLES: dict[str, Callable[[], str]] = {
    "alarms": alarms,
    "acceptance": acceptance,
    "flags": flags,
    "problems": problems,
}


def fill(text: str) -> str:
    """Return a page with its generated tables renewed."""
    return BLOCK.sub(lambda found: f"{found[1]} -->\n\n{TABLES[found[1]]()}\n", text)


def write_tables() -> None:
    """Write the tables into the pages."""
    for path in sorted(HOW_TO.glob("*.md")):
        text = path.read_text(encoding="utf-8")
        if (filled := fill(text)) != text:
            path.write_text(filled, encoding="utf-8", newline="\n")
