"""Constructions that texts for people avoid, sentences of a text, and all texts that solimon shows."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import click
from pygments.lexers import JavascriptLexer
from pygments.token import String

ROOT = Path(__file__).parents[2]
PACKAGES = ("daq_service", "hardware_drivers", "analysis", "simulator")
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
    """Texts and labels of HTML."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_data(self, data: str) -> None:
        """Collect a text."""
        self.found.append(data)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect the labels of an element."""
        self.found += [value or "" for name, value in attrs if name in ("aria-label", "title", "placeholder")]


def list_html_texts(html: str) -> list[str]:
    """List the texts and labels in HTML."""
    parser = _Texts()
    parser.feed(html)
    parser.close()
    return parser.found


def list_script_strings(code: str) -> Iterator[str]:
    """List the string literals of JavaScript, with `x` for each value in a template literal."""
    nested: list[str | None] = []  # texts of open template literals; None: code inside the one before
    for kind, text in JavascriptLexer().get_tokens(code):
        if kind in (String.Double, String.Single):
            yield text[1:-1]
        elif kind is String.Interpol:
            nested = [*nested, None] if text == "${" else nested[:-1]
        elif kind is String.Backtick and text != "`":
            nested[-1] = f"{nested[-1]}{text}"
        elif kind is String.Backtick and nested and nested[-1] is not None:
            yield f"{nested.pop()}"
        elif kind is String.Backtick:
            nested.append("")


def list_page_texts() -> Iterator[tuple[str, str]]:
    """List file and text of each label and sentence of the dashboard, with its scripts, and of reports."""
    web = ROOT / "daq_service/web"
    for path in sorted([*web.glob("dashboard/*.html"), *web.glob("templates/*.j2")]):
        html = re.sub(r"{#.*?#}|{%.*?%}", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
        yield from ((path.name, text) for text in list_html_texts(re.sub(r"{{.*?}}", "x", html)))
    for path in sorted((web / "dashboard").rglob("*.js")):
        if "vendor" not in path.parts:
            for text in list_script_strings(path.read_text(encoding="utf-8")):
                if " " in text.strip():
                    yield from ((path.name, found) for found in list_html_texts(text))


def _walk_strings(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for item in value.values():
            yield from _walk_strings(item)
    elif isinstance(value, list):
        for item in value:
            yield from _walk_strings(item)


def list_table_texts() -> Iterator[tuple[str, str]]:
    """List file and text of each string with a space in tables (TOML), with `x` for each value filled in."""
    for path in sorted(path for folder in PACKAGES for path in (ROOT / folder).rglob("*.toml")):
        for text in _walk_strings(tomllib.loads(path.read_text(encoding="utf-8"))):
            if " " in text.strip():
                yield path.relative_to(ROOT).as_posix(), re.sub(r"{[^{}]*}", "x", text)


def list_help_texts(command: click.Command, name: str = "solimon") -> Iterator[tuple[str, str]]:
    """List name and text of each part of the help of a command and of the commands in it."""
    context = click.Context(command, info_name=name, terminal_width=10_000, max_content_width=10_000)
    yield from ((name, text) for text in re.split(r"\n|  +", command.get_help(context)) if text)
    if isinstance(command, click.Group):
        for inner in command.list_commands(context):
            found = command.get_command(context, inner)
            assert found is not None
            yield from list_help_texts(found, f"{name} {inner}")


def list_terminal_texts() -> Iterator[tuple[str, str]]:
    """List file and text of each cell of the pictures of a terminal."""
    for path in sorted((ROOT / "tests/end_to_end/terminal").glob("*.txt")):
        cells = re.split(r"\n|  +", path.read_text(encoding="utf-8"))
        yield from ((path.name, text) for text in cells if text)


def list_printed_texts() -> Iterator[tuple[str, str]]:
    """List file and text of each string of three words or more in the code, except docstrings."""
    for path in sorted(path for folder in PACKAGES for path in (ROOT / folder).rglob("*.py")):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        skipped = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}  # docstrings
        skipped |= {id(part) for node in nodes if isinstance(node, ast.JoinedStr) for part in node.values}
        for node in nodes:
            parts = node.values if isinstance(node, ast.JoinedStr) else [node]
            if id(node) not in skipped and isinstance(node, ast.JoinedStr | ast.Constant):
                values = [getattr(part, "value", None) for part in parts]
                text = "".join(value if isinstance(value, str) else "x" for value in values)
                if text.count(" ") >= 2:
                    yield path.relative_to(ROOT).as_posix(), text
