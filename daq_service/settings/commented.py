"""Write a configuration as TOML that explains itself: each key with its description from the settings."""

from __future__ import annotations

import re
import textwrap
import tomllib
from collections.abc import Collection, Iterator, Mapping
from decimal import Decimal

import tomlkit
from tomlkit.items import Float, Item, Table, Trivia

from daq_service.settings.schema import describe_key
from daq_service.settings.tables import KeyPath, flatten

WIDTH = 118
COMMENT_COLUMN = 40
"""Comments begin here, or above a key that reaches further."""
_BLANK_LINES = re.compile(r"\n{3,}")
_SWITCHED_OFF = re.compile(r"^#(?=[a-z\[])", re.MULTILINE)


def format_commented_toml(
    values: Mapping[str, object], *, head: str = "", switched_off: Collection[KeyPath] = ()
) -> str:
    """Format a configuration as TOML text in which a comment describes each key at its first occurrence.

    Parameters
    ----------
    values
        Nested tables as a file gives them; order is kept, but tables follow the keys next to them.
    head
        First comment of the file, without comment signs.
    switched_off
        Tables whose lines begin with a ``#``: without these signs they are switched on.
    """
    lines = ["#:schema ./settings.schema.json", *(f"# {line}".rstrip() for line in head.splitlines()), ""]
    document = tomlkit.document()
    for name, item in _build_commented_table(values, (), set()).items():
        document.append(name, item)
    text = _BLANK_LINES.sub("\n\n", tomlkit.dumps(document))
    return "\n".join([*lines, *_comment_out_tables(text.split("\n"), switched_off)])


def uncomment_tables(text: str) -> str:
    """Return the file's text with every commented-out key and table header active.

    Descriptions stay comments.
    """
    return _SWITCHED_OFF.sub("", text)


def _comment_out_tables(lines: list[str], tables: Collection[KeyPath]) -> Iterator[str]:
    """Yield the lines, with ``#`` before the keys and headers of these tables and of tables inside them."""
    off = False
    for line in lines:
        if line.startswith("["):
            path = next(iter(flatten(tomllib.loads(f"{line}\nkey = 0"))))
            off = any(path[: len(table)] == table for table in tables)
        yield f"#{line}" if off and line and not line.lstrip().startswith("#") else line


def _build_commented_table(values: Mapping[str, object], path: KeyPath, described: set[str]) -> Table:
    """Build a TOML table whose keys have their descriptions as comments; keys precede tables.

    ``path`` is that of the table. Texts in ``described`` are not repeated; new ones are added to it.
    """

    def describe_new_key(*name: str) -> str:
        """Return the description of a key below this table and note it; empty if the text was used before."""
        text = describe_key((*path, *name))
        new = text not in described
        described.add(text)
        return text if new else ""

    tables = {name: value for name, value in values.items() if isinstance(value, Mapping) and value}
    keys = {name: value for name, value in values.items() if name not in tables}
    table = tomlkit.table(is_super_table=not keys)
    above = _wrap_comment(describe_new_key()) if path and keys else []
    for name, value in keys.items():
        item = _to_toml_item(value)
        table.append(name, item)
        _add_comment(item, f"{tomlkit.key(name).as_string()} = {item.as_string()}", describe_new_key(name))
    for name, value in tables.items():
        table.append(name, _build_commented_table(value, (*path, name), described))
    # Last: tomlkit indents what is appended like the header.
    table.trivia.indent = "\n".join(["", *above, ""])
    return table


def _add_comment(item: Item, assignment: str, description: str) -> None:
    """Add a wrapped comment to a TOML item: after ``assignment``, or above it if that is too long.

    ``assignment`` is the item's text ``key = value``; it is too long if it exceeds `COMMENT_COLUMN`.
    """
    if len(assignment) > COMMENT_COLUMN - 2:
        item.trivia.indent = "".join(f"{line}\n" for line in _wrap_comment(description))
        return
    first, *rest = _wrap_comment(description, WIDTH - COMMENT_COLUMN) or [""]
    item.trivia.comment_ws = " " * (COMMENT_COLUMN - len(assignment)) if first else ""
    item.trivia.comment = first
    item.trivia.trail = "\n".join(["", *(f"{'':<{COMMENT_COLUMN}}{line}" for line in rest), ""])


def _wrap_comment(text: str, width: int = WIDTH) -> list[str]:
    """Wrap a text into lines of at most ``width`` characters that start with ``# ``; none for no text."""
    return [f"# {line}" for line in textwrap.wrap(text, width - 2, break_on_hyphens=False)]


def _to_toml_item(value: object) -> Item:
    """Convert a value to a TOML item, mappings to inline tables; a float to a power of 1000 if shorter."""
    match value:
        case float():
            powers = Decimal(repr(value)).normalize().to_eng_string().replace("E+", "e")
            text = min(powers if "e" in powers else repr(value), repr(value), key=len)
            return Float(value, Trivia(), text)
        case Mapping():
            inline = tomlkit.inline_table()
            for name, inner in value.items():
                inline.append(name, _to_toml_item(inner))
            return inline
        case list() | tuple():
            array = tomlkit.array()
            for inner in value:
                array.append(_to_toml_item(inner))
            return array
        case _:
            return tomlkit.item(value)
