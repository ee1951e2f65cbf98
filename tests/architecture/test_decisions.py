"""Records of decisions have one form and one page; the index lists each of them once."""

import re
from pathlib import Path

import pytest
from support.plain_language import LINK, count_words

DECISIONS = Path(__file__).parents[2] / "docs/decisions"
RECORDS = sorted(DECISIONS.glob("[0-9]*.md"))
MOST_WORDS = 350
SECTIONS = ["Context", "Decision", "Consequences"]
SUCCESSORS = re.compile(r"(?:changed|extended)\b.*")


def read_heading_and_status(path: Path) -> tuple[str, str]:
    """Read the first line and the status of a record, without its marks of Markdown."""
    heading, status, *_ = path.read_text(encoding="utf-8").split("\n\n")
    return heading.removeprefix("# "), " ".join(status.split())


@pytest.mark.parametrize("path", RECORDS, ids=lambda path: path.stem)
def test_a_record_is_one_page_of_context_decision_and_consequences(path):
    text = path.read_text(encoding="utf-8")
    heading, status = read_heading_and_status(path)
    assert heading.startswith(f"{int(path.name[:4])}. ")
    assert re.match(r"Status: accepted[.;]", status)
    assert re.findall(r"^#+ (.*)", text, flags=re.MULTILINE)[1:] == SECTIONS
    assert all(section.strip() for section in re.split(r"^## .*", text, flags=re.MULTILINE))
    assert count_words(text) <= MOST_WORDS


def test_the_index_lists_every_record_once_with_its_title_and_successors():
    index = (DECISIONS / "README.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| \[(.+)\]\(([^)]+)\) \| \S.* \| accepted(?:; (.*))? \|$", index, flags=re.MULTILINE
    )
    assert sorted(name for _, name, _ in rows) == [path.name for path in RECORDS]
    for title, name, successors in rows:
        heading, status = read_heading_and_status(DECISIONS / name)
        named = SUCCESSORS.search(status)
        assert title == heading
        assert LINK.findall(successors) == [
            (text.removeprefix("decision "), target)
            for text, target in LINK.findall(named.group() if named else "")
        ]


def test_links_of_records_lead_to_pages():
    links = [
        (path.name, target)
        for path in [*RECORDS, DECISIONS / "README.md"]
        for _, target in LINK.findall(path.read_text(encoding="utf-8"))
    ]
    assert len(links) > len(RECORDS)
    assert [link for link in links if not (DECISIONS / link[1]).is_file()] == []
