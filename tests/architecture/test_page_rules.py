"""The page is formatted and has plain names: short lines, no refused word in an identifier."""

import re
from pathlib import Path

import pytest
from test_identifiers import refused

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "daq_service/web/dashboard"
FILES = [
    path
    for path in sorted(PAGE.rglob("*"))
    if path.suffix in {".js", ".css", ".html"} and "vendor" not in path.parts
]
WIDTH = 120
# Prettier puts spaces around a division: a slash without one starts a regular expression.
CODE = re.compile(
    r"""//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'"""
    r"""|/(?=[^\s/*])(?:\\.|\[(?:\\.|[^\]\\])*\]|[^/\\\n\[])+/|(?P<name>[A-Za-z_$][\w$]*)|[`{}]""",
    flags=re.DOTALL,
)
TEXT = re.compile(r"(?:\\.|\$(?!\{)|[^`\\$])*", flags=re.DOTALL)


def names_of_script(script):
    """Return the identifiers of a script, without its comments, strings and regular expressions.

    The expressions within template literals count, at any depth.
    """
    found, braces, at = set(), [], 0
    while token := CODE.search(script, at):
        at = token.end()
        text = token[0] == "`"
        if token["name"]:
            found.add(token["name"])
        elif braces and token[0] in "{}":
            braces[-1] += 1 if token[0] == "{" else -1
            text = braces[-1] < 0
            if text:
                braces.pop()
        if text:
            at = TEXT.match(script, at).end()
            if script.startswith("${", at):
                braces.append(0)
            at += 2 if script.startswith("${", at) else 1
    return found


def names_of(path):
    """Return the identifiers of a script, and the classes and ids of a page or a style sheet."""
    content = path.read_text(encoding="utf-8")
    if path.suffix == ".js":
        return names_of_script(content)
    if path.suffix == ".css":
        return set(re.findall(r"[.#]([a-z][\w-]*)", content))
    return {name for value in re.findall(r'(?:id|class|for)="([^"]+)"', content) for name in value.split()}


def test_no_line_of_the_page_is_long():
    assert len(FILES) > 60
    long = [
        f"{path.relative_to(PAGE)}:{number}"
        for path in FILES
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if len(line) > WIDTH
    ]
    assert long == [], f"over {WIDTH} characters: `nox -s format`, and split what it leaves"


def test_no_name_of_the_page_has_a_refused_word():
    found = {(name, path.name) for path in FILES for name in {path.stem, *names_of(path)}}
    assert {(name, file) for name, file in found if refused(name.replace("-", "_"))} == set()


@pytest.mark.parametrize(
    ("script", "names"),
    [
        ('let a = "told"; // said', {"let", "a"}),
        ("a.replace(/[`*]told/g, b)", {"a", "replace", "g", "b"}),
        ("`told ${toldAt + `${x ? '}' : {y}} said`} anew` + b", {"toldAt", "x", "y", "b"}),
    ],
)
def test_names_are_those_of_the_code_alone(script, names):
    assert names_of_script(script) == names
