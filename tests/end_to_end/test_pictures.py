"""Pictures of the docs: each is made by the command, shows what its text says, and is small."""

import re

import pytest
from support.pictures import DEMO, DOCS, PICTURES, make, parsed_line, source_of
from test_docs import PAGES

MOST_BYTES = 1_500_000
"""Limit of all files: each clone of the repository contains them."""


def test_the_docs_show_the_pictures_that_the_command_makes_and_no_others():
    shown = {
        (page.parent / target).resolve()
        for page in PAGES
        for target in re.findall(r"!\[[^\]]+\]\(([^)]+)\)", page.read_text(encoding="utf-8"))
    }
    # A drawing; a test; `solimon design --figure`.
    drawn = ("how-to/wiring.svg", "pictures/set-up.png", "pictures/array-design.svg")
    of_other_sources = {DOCS / name for name in drawn}
    assert shown - of_other_sources == {DOCS / picture.file for picture in PICTURES}


def test_each_step_of_the_tutorial_has_its_picture():
    text = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    _, *steps = re.split(r"^## ", text, flags=re.MULTILINE)
    without = [step.partition("\n")[0] for step in steps if "![" not in step]
    assert f"\nsolimon {DEMO}\n" in text, "the pictures are of what a reader is told to run"
    assert len(steps) == 7
    assert without == []


def test_each_screenshot_matches_the_list():
    assert {p.file: parsed_line(DOCS / p.file) for p in PICTURES} == {p.file: source_of(p) for p in PICTURES}
    assert sum((DOCS / picture.file).stat().st_size for picture in PICTURES) < MOST_BYTES


@pytest.mark.slow
@pytest.mark.browser
def test_the_command_writes_all_files(tmp_path):
    make(tmp_path)
    made = {path.relative_to(tmp_path).as_posix(): parsed_line(path) for path in tmp_path.rglob("*.*")}
    assert made == {picture.file: source_of(picture) for picture in PICTURES}
