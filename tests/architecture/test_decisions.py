"""Records of decisions have one form, one page and plain words; the index lists each of them once."""

import re
from pathlib import Path

import pytest

DECISIONS = Path(__file__).parents[2] / "docs/decisions"
RECORDS = sorted(DECISIONS.glob("[0-9]*.md"))
MOST_WORDS = 350
MOST_WORDS_PER_SENTENCE = 30
SECTIONS = ["Context", "Decision", "Consequences"]
SUCCESSORS = re.compile(r"(?:changed|extended)\b.*")
LINK = re.compile(r"\[([^]]*)\]\(([^)]*)\)")
REFUSED = re.compile(
    r"\b(?:tells?|telling|told)\b"
    r"|\b(?:anew|beside|thereby|whoever|whatever|nobody|somebody|so far as)\b"
    r"|(?-i:(?:^|[.!?]\s+)(?:Of|Beside|Behind)\s(?!course\b))"
    r"|(?-i:(?:^|[.!?]\s+)(?:What|Who|Whoever)\s(?!to\b)[^.?!\n]*\.(?=\s|$))"
    r"|\bstands?\b(?!-?(?:for|alone|by|out)\b)|\blies? (?:beyond|within|together|alone)\b"
    r"|\b(?:sets|shots|readings|days) running\b"
    r"|\b(?:alarms?|hours?|sets?|samples?|shots?|rows?|h|V) an? (?:second|hour|day|year|sensor|set|row)\b"
    r"|\bno more\b(?! than)"
    r"|\b(?:judg(?:e|es|ed|ing|ement)|verdicts?|once more|begun|mend(?:s|ed)?|graver?|gravest)\b",
    flags=re.IGNORECASE,
)
"""Constructions that are hard to read in a second language, or for which the glossary has a term."""


def read_sentences(path: Path) -> list[str]:
    """Read the sentences of a page: unwrapped, without code spans, emphasis and the targets of links."""
    text = re.sub(r"`[^`]*`", "", path.read_text(encoding="utf-8"))
    text = LINK.sub(r"\1", text).replace("*", "")
    pieces = re.split(r"\n\s*\n|\n(?=- )|[|]", text)
    unwrapped = [" ".join(re.sub(r"^\s*(?:#+|-) ", "", piece).split()) for piece in pieces]
    return [sentence for piece in unwrapped for sentence in re.split(r"(?<=[.!?])\s+", piece) if sentence]


def count_words(text: str) -> int:
    """Count the words and numbers of a text."""
    return sum(any(letter.isalnum() for letter in word) for word in text.split())


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


@pytest.mark.parametrize("path", [*RECORDS, DECISIONS / "README.md"], ids=lambda path: path.stem)
def test_a_page_is_in_short_sentences_of_plain_words(path):
    sentences = read_sentences(path)
    assert [found.group() for found in map(REFUSED.search, sentences) if found] == []
    assert [each for each in sentences if count_words(each) > MOST_WORDS_PER_SENTENCE] == []


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
