"""Constructions that texts for people avoid, sentences of a text, and all texts that solimon shows."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

ROOT = Path(__file__).parents[2]
MOST_WORDS_PER_SENTENCE = 30
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
REFUSED_ON_SCREEN = re.compile(
    r"\b(?:says?|said|hears?|heard|beyond)\b"
    r"|\b(?:sure|certain(?:ty)?|confidence)\b(?! interval)"
    r"|\d(?:%|mm|µm|µs|us|ms|kHz|MHz|mV|mA|°C)(?!\w)",
    flags=re.IGNORECASE,
)
"""The same for texts of page, terminal and notifications."""
REFUSED_IN_ALARMS = re.compile(
    r"\b(?:now|today|currently|ago)\b|(?<![`\w./=-])[a-z]+(?:_[a-z0-9]+)+\b", flags=re.IGNORECASE
)
"""The same for stored texts of alarms: relative times, internal names."""


def split_sentences(text: str) -> list[str]:
    """Split a text into sentences: unwrapped, without code spans, emphasis and the targets of links."""
    text = LINK.sub(r"\1", re.sub(r"```.*?```|`[^`]*`", "", text, flags=re.DOTALL)).replace("*", "")
    pieces = re.split(r"\n\s*\n|\n(?=\s*- )|\n(?=\s*\d+\. )|[|]", text)
    unwrapped = [" ".join(re.sub(r"^\s*(?:#+|-|\d+\.) ", "", piece).split()) for piece in pieces]
    return [sentence for piece in unwrapped for sentence in re.split(r"(?<=[.!?:])\s+", piece) if sentence]


def count_words(text: str) -> int:
    """Count the words and numbers of a text."""
    return sum(any(letter.isalnum() for letter in word) for word in text.split())


class _Texts(HTMLParser):
    """Texts and labels of an HTML page."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_data(self, data: str) -> None:
        """Collect a text."""
        self.found.append(data)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect the labels of an element."""
        self.found += [value or "" for name, value in attrs if name in ("aria-label", "title", "placeholder")]


def list_page_texts() -> Iterator[tuple[str, str]]:
    """List file and text of each label and sentence of the dashboard, its scripts included."""
    folder = ROOT / "daq_service/web/dashboard"
    for path in sorted(folder.glob("*.html")):
        parser = _Texts()
        parser.feed(path.read_text(encoding="utf-8"))
        yield from ((path.name, text) for text in parser.found)
    for path in sorted(folder.rglob("*.js")):
        if "vendor" not in path.parts:
            code = re.sub(
                r"/\*.*?\*/|(?<![:\"'`])//[^\n]*", "", path.read_text(encoding="utf-8"), flags=re.DOTALL
            )
            for text in re.findall(r'"((?:[^"\\\n]|\\.)*)"|`((?:[^`\\]|\\.)*)`', code):
                words = re.sub(r"\$\{[^}]*\}", " x ", text[0] or text[1])
                if " " in words.strip() and re.search(r"[a-z]{2}", words):
                    yield path.name, words


def _walk_strings(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for item in value.values():
            yield from _walk_strings(item)
    elif isinstance(value, list):
        for item in value:
            yield from _walk_strings(item)


def list_table_texts(*names: str) -> Iterator[tuple[str, str]]:
    """List file and text of each string with a space in tables (TOML) below `daq_service`."""
    for name in names:
        for path in sorted((ROOT / "daq_service").glob(name)):
            for text in _walk_strings(tomllib.loads(path.read_text(encoding="utf-8"))):
                if " " in text.strip():
                    yield path.relative_to(ROOT).as_posix(), text


def list_printed_texts(folder: str) -> Iterator[tuple[str, str]]:
    """List file and text of each string of three words or more in the code of a folder; no docstrings."""
    for path in sorted((ROOT / folder).rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        docstrings = {
            id(node.body[0].value)
            for node in ast.walk(tree)
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
            and node.body
            and isinstance(node.body[0], ast.Expr)
        }
        documented = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)} | docstrings
        parts = {
            id(part): node
            for node in ast.walk(tree)
            if isinstance(node, ast.JoinedStr)
            for part in node.values
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.JoinedStr):
                text = "".join(
                    str(part.value) if isinstance(part, ast.Constant) else "x" for part in node.values
                )
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in parts:
                text = node.value
            else:
                continue
            if id(node) not in documented and text.count(" ") >= 2:
                yield path.relative_to(ROOT).as_posix(), text
