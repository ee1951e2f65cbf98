"""Identifiers use the terms of the glossary: no word of `refused_words.txt` names anything."""

import io
import re
import subprocess
import tokenize
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
REFUSED = (ROOT / "tests/architecture/refused_words.txt").read_text().split()
KEYS_OF_ASSESS = ("nothing_judged", "default_because", "judged", "beside_the_median")
EXEMPT = {
    "tell": "method of Python's file objects",
    **dict.fromkeys(KEYS_OF_ASSESS, "key of `assess --json`, which others read"),
}
"""Identifier: the reason why it keeps its name."""


@cache
def refused(identifier):
    """Return whether a part of an identifier, in the singular or plural, is on the list."""
    parts = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", identifier).lower().split("_")
    return any(
        parts[-1] == word.removeprefix("*_") if "*" in word else {word, f"{word}s"} & set(parts)
        for word in REFUSED
    )


@pytest.mark.parametrize("name", ["told_of", "ToldColumn", "_verdicts", "TELLS", "lost_because"])
def test_the_list_refuses(name):
    assert refused(name)


@pytest.mark.parametrize("name", ["reported", "saidan", "intelligence"])
def test_the_list_accepts(name):
    assert not refused(name)


def test_no_identifier_has_a_refused_word():
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True)
    found: dict[str, list[str]] = {}
    exempt: set[str] = set()
    for file in listed.stdout.split():
        source = (ROOT / file).read_text(encoding="utf-8")
        if not any(map(refused, re.findall(r"[A-Za-z]\w*", source))):  # in a comment or a text neither
            continue
        for token in tokenize.generate_tokens(io.StringIO(source).readline):
            if token.type != tokenize.NAME or not refused(token.string):
                continue
            if token.string in EXEMPT:
                exempt.add(token.string)
            else:
                found.setdefault(token.string, []).append(f"{file}:{token.start[0]}")
    assert found == {}
    assert exempt == EXEMPT.keys(), "an exemption that nothing needs goes"
