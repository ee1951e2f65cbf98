"""How-to pages: their generated tables are those of the code, their messages are in it, they stay short."""

import ast
import re
from pathlib import Path

import pytest
from support.how_to_tables import BLOCK, HOW_TO, TABLES, fill
from support.plain_language import count_words

ROOT = Path(__file__).parents[2]
PAGES = sorted(HOW_TO.glob("*.md"))
MOST_WORDS = 10_000
"""Of all pages together, without generated tables: a reader looks for a task, not for everything."""
PACKAGES = ("daq_service", "hardware_drivers", "analysis", "simulator")


def test_the_generated_tables_are_those_of_the_code():
    texts = {path.name: path.read_text(encoding="utf-8") for path in PAGES}
    outdated = [name for name, text in texts.items() if fill(text) != text]
    assert outdated == [], "run `python -m support.reference_pages` in tests/"
    assert sorted(name for text in texts.values() for name in BLOCK.findall(text)) == sorted(TABLES)


def test_the_pages_are_short():
    words = sum(count_words(BLOCK.sub("", path.read_text(encoding="utf-8"))) for path in PAGES)
    assert words < MOST_WORDS


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_each_page_has_one_title(page):
    titles = re.findall(r"^# (.+)$", re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL), re.M)
    assert len(titles) == 1
    assert re.fullmatch(r"[A-Z][^.:]+", titles[0])


def texts_of_the_code():
    """Yield the text of each string of the packages, with `{}` for each value filled in."""
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = (getattr(part, "value", None) for part in node.values)
                yield "".join(part if isinstance(part, str) else "{}" for part in parts)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value


def test_the_messages_of_commands_are_in_the_code():
    page = (HOW_TO / "troubleshooting.md").read_text(encoding="utf-8")
    section = page.partition("\n## Commands\n")[2].partition("\n## ")[0]
    messages = re.findall(r"^\| `([^`]+)` ", section, flags=re.MULTILINE)
    assert len(messages) > 7
    code = "\n".join(texts_of_the_code())
    assert [message for message in messages if message not in code] == []
