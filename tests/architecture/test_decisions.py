"""The index of decisions lists every record once, and its rows lead to records."""

import re
from pathlib import Path

DECISIONS = Path(__file__).parents[2] / "docs/decisions"


def test_every_decision_has_its_row_in_the_index():
    index = (DECISIONS / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \[(\d+)\]\((\S+)\) \| \S.* \| accepted\b.*\|$", index, flags=re.MULTILINE)
    records = sorted(path.name for path in DECISIONS.glob("[0-9]*.md"))
    assert [name for _, name in rows] == records
    assert all(int(number) == int(name[:4]) for number, name in rows)
