"""`docs/reference/test-support.md` lists each module of `tests/support`, and nothing else."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_each_module_is_listed_once():
    page = (ROOT / "docs/reference/test-support.md").read_text(encoding="utf-8")
    first_cells = re.findall(r"(?m)^\| (`[^|]*) \|", page)
    listed = [name for cell in first_cells for name in re.findall(r"`(\w+)`", cell)]
    modules = [path.stem for path in (ROOT / "tests/support").glob("*.py") if path.stem != "__init__"]
    assert sorted(listed) == sorted(modules)
