"""Pages that describe code are made from it; the navigation of the site has every page once."""

import tomllib
from pathlib import Path

import pytest
from support.reference_pages import FOLDER, PAGES, render_page

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


@pytest.mark.parametrize("name", PAGES)
def test_a_generated_page_equals_what_the_code_describes(name):
    stored = (FOLDER / f"{name}.md").read_text(encoding="utf-8")
    assert stored == render_page(name), "`python -m support.reference_pages` in tests/ writes it"


def test_no_other_page_is_among_the_generated_ones():
    assert sorted(path.stem for path in FOLDER.iterdir()) == sorted(PAGES)


def test_the_navigation_has_every_page_once_and_no_other():
    project = tomllib.loads((ROOT / "zensical.toml").read_text(encoding="utf-8"))["project"]
    named = [page for section in project["nav"] for pages in section.values() for page in pages]
    records = set((DOCS / "decisions").glob("[0-9]*.md"))  # their index leads to them
    written = [path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md") if path not in records]
    assert sorted(named) == sorted(written)
