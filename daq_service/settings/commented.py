"""Write a configuration as TOML that explains itself: each key with its description from the settings."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Collection, Iterator, Mapping
from decimal import Decimal
from typing import Any

from daq_service.settings.schema import describe
from daq_service.settings.stored import KeyPath

WIDTH = 118
COMMENT_COLUMN = 40
"""Comments begin here, or above a key that reaches further."""
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+\Z")
_SWITCHED_OFF = re.compile(r"^#(?=[a-z\[])", re.MULTILINE)


def commented_toml(
    values: Mapping[str, Any], *, head: str = "", switched_off: Collection[KeyPath] = ()
) -> str:
    """Return the text of a configuration file.

    Parameters
    ----------
    values
        Nested tables as a file gives them; order is kept, but for tables behind the keys beside them.
    head
        What a person reads first, without comment signs.
    switched_off
        Tables whose lines begin with a ``#``: taking these away switches them on.
    """
    lines = ["#:schema ./settings.schema.json", *(f"# {line}".rstrip() for line in head.splitlines()), ""]
    return "\n".join([*lines, *_table(values, (), switched_off, set())]) + "\n"


def switched_on(text: str) -> str:
    """Uncomment every table of a file that is switched off."""
    return _SWITCHED_OFF.sub("", text)


def _table(
    values: Mapping[str, Any], path: KeyPath, switched_off: Collection[KeyPath], described: set[str]
) -> Iterator[str]:
    def new_description(*name: str) -> str:
        """Return the description of a key, empty if it appeared before."""
        text = describe((*path, *name))
        new = text not in described
        described.add(text)
        return text if new else ""

    tables = {name: value for name, value in values.items() if isinstance(value, Mapping) and value}
    is_off = any(path[: len(table)] == table for table in switched_off)
    keys = [name for name in values if name not in tables]
    if path and keys:
        yield from ("", *_comment(new_description()))
        yield f"{'#' * is_off}[{'.'.join(map(_key, path))}]"
    for name in keys:
        for line in _assignment(name, values[name], new_description(name)):
            # A description stays what it is: only what a reader of TOML would see is switched off.
            yield line if line.lstrip().startswith("#") else f"{'#' * is_off}{line}"
    for name, value in tables.items():
        yield from _table(value, (*path, name), switched_off, described)


def _assignment(name: str, value: object, description: str) -> Iterator[str]:
    text = f"{_key(name)} = {_value(value)}"
    if len(text) > COMMENT_COLUMN - 2:
        yield from (*_comment(description), text)
        return
    first, *rest = _comment(description, WIDTH - COMMENT_COLUMN) or [""]
    yield f"{text:<{COMMENT_COLUMN}}{first}".rstrip()
    yield from (f"{'':<{COMMENT_COLUMN}}{line}" for line in rest)


def _comment(text: str, width: int = WIDTH) -> list[str]:
    return [f"# {line}" for line in textwrap.wrap(text, width - 2, break_on_hyphens=False)]


def _key(name: str) -> str:
    return name if _BARE_KEY.match(name) else _string(name)


def _string(text: str) -> str:
    # What JSON escapes TOML escapes alike; DEL, which JSON lets pass, TOML does not.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: object) -> str:
    match value:
        case str():
            return _string(value)
        case bool():
            return str(value).lower()
        case float():
            powers = Decimal(repr(value)).normalize().to_eng_string().replace("E+", "e")
            return min(powers if "e" in powers else repr(value), repr(value), key=len)
        case Mapping():
            return f"{{ {', '.join(f'{_key(name)} = {_value(below)}' for name, below in value.items())} }}"
        case list() | tuple():
            return f"[{', '.join(map(_value, value))}]"
        case _:
            return str(value)
