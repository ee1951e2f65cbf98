"""The glossary defines each term once and names keys that there are."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
ROWS = [
    [cell.strip() for cell in line.split(" | ")]
    for line in (ROOT / "docs/reference/glossary.md").read_text(encoding="utf-8").splitlines()
    if line.startswith("| ") and not line.startswith("| Term")
]


def test_each_term_is_defined_once_in_one_sentence():
    terms = [term for row in ROWS for term in row[0].removeprefix("| ").split(", ")]
    assert len(terms) > 60
    assert sorted(terms) == sorted(set(terms))
    assert [row[0] for row in ROWS if not re.fullmatch(r"[A-Z][^.]*\.", row[1])] == []


def test_the_keys_are_keys_of_the_code():
    files = [path for name in ("daq_service", "analysis") for path in (ROOT / name).rglob("*.py")]
    files = [path for path in files if path.name != "earlier_names.py" and "migrations" not in path.parts]
    code = "\n".join(path.read_text(encoding="utf-8") for path in files)
    keys = {key.rpartition(".")[0] or key for row in ROWS for key in re.findall(r"`([^`]+)`", row[-1])}
    assert len(keys) > 20
    assert {key for key in keys if not re.search(rf"\b{re.escape(key)}\b", code)} == set()
