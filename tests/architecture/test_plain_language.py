"""Texts for people are in plain terms and short sentences: documents, page, terminal, tables, messages."""

import itertools
import re
from collections.abc import Iterator

import pytest
from support.plain_language import (
    MOST_WORDS_PER_SENTENCE,
    REFUSED,
    REFUSED_IN_ALARMS,
    REFUSED_ON_SCREEN,
    ROOT,
    count_words,
    list_help_texts,
    list_page_texts,
    list_printed_texts,
    list_table_texts,
    list_terminal_texts,
    split_sentences,
)

from daq_service.cli.main import cli

PAGES = [
    path
    for path in sorted([ROOT / "README.md", *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/**/*.md")])
    if "generated" not in path.parts
]
TEXTS = {
    "page": (list_page_texts, 1000),
    "help": (lambda: list_help_texts(cli), 650),
    "terminal": (list_terminal_texts, 50),
    "tables": (list_table_texts, 1200),
    "messages": (list_printed_texts, 2300),
}
"""Collector of each kind of text, and how many it finds at least."""
EXCEPTIONS = {
    "daq_service/catalogue/migrations/": "SQL that changes catalogues of earlier versions, never shown",
}
"""Reason of each place, a file or a folder, that keeps refused constructions."""


def list_faults(texts: Iterator[tuple[str, str]], *refused: re.Pattern[str]) -> list[tuple[str, str, str]]:
    """List place, construction (or count of words) and sentence of each fault in texts."""
    found = []
    for place, text in texts:
        for sentence in split_sentences(text):
            found += [(place, hit.group(), sentence) for one in refused if (hit := one.search(sentence))]
            if count_words(sentence) > MOST_WORDS_PER_SENTENCE:
                found.append((place, f"{count_words(sentence)} words", sentence))
    return found


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_a_document_is_in_short_sentences_of_plain_words(path):
    text = path.read_text(encoding="utf-8")
    assert list_faults(iter([(path.name, text)]), REFUSED) == []


@pytest.mark.parametrize("kind", TEXTS)
def test_texts_on_screens_are_in_short_sentences_of_plain_words(kind):
    collect, fewest = TEXTS[kind]
    texts = list(collect())
    assert len(texts) >= fewest, "the collector does not find what it found"
    faults = list_faults(iter(texts), REFUSED, REFUSED_ON_SCREEN)
    assert [fault for fault in faults if not fault[0].startswith(tuple(EXCEPTIONS))] == []


def test_each_exception_is_needed():
    faults = list_faults(
        itertools.chain(*(collect() for collect, _ in TEXTS.values())), REFUSED, REFUSED_ON_SCREEN
    )
    assert [name for name in EXCEPTIONS if not any(fault[0].startswith(name) for fault in faults)] == []


def test_stored_texts_of_alarms_have_no_relative_time_and_no_internal_name():
    texts = [item for item in list_table_texts() if item[0] == "daq_service/alarms/texts.toml"]
    assert len(texts) > 250
    assert list_faults(iter(texts), REFUSED_IN_ALARMS) == []
