"""All commands of ``solimon``, read from ``commands.toml``; a function is imported when its command runs."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from daq_service.errors import EXIT_OK
from daq_service.processes.installation import require_extras

Table = Mapping[str, Any]
"""A table of ``commands.toml``."""

_SECTIONS: dict[str, dict[str, Table]] = tomllib.loads(
    Path(__file__).with_name("commands.toml").read_text(encoding="utf-8")
)
_SHARED = _SECTIONS.pop("shared")
SECTIONS: Mapping[str, Mapping[str, str]] = {
    section: {name: command["summary"] for name, command in commands.items()}
    for section, commands in _SECTIONS.items()
}
"""Summaries by section and command, in the order of ``solimon --help``."""


class _Positive(click.FloatRange):
    """Positive finite number: a range alone accepts infinity and NaN."""

    def convert(self, value: float, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Convert a text to a finite positive number; raise `click.BadParameter` if it is none."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


_TYPES: Mapping[str, click.ParamType[Any]] = {
    "path": click.Path(path_type=Path),
    "existing": click.Path(exists=True, path_type=Path),
    "file": click.Path(dir_okay=False, path_type=Path),
    "folder": click.Path(file_okay=False, path_type=Path),
    "port": click.IntRange(0, 65535),
    "number": click.FLOAT,
    "positive": _Positive(min=0.0, min_open=True),
    "fraction": click.FloatRange(0.0, 1.0, min_open=True, max_open=True),
}


def find_command(name: str) -> click.Command | None:
    """Build the click command of this name with its options; return None if there is none."""
    table = next((commands[name] for commands in _SECTIONS.values() if name in commands), None)
    return None if table is None else _build_command(name, table)


def import_and_call(target: str, starting: str = "", extras: Sequence[str] = (), **options: Any) -> int:
    """Import the function ``MODULE:NAME`` of this package, call it with the options, return its exit code.

    A function that returns None gives 0.

    Parameters
    ----------
    starting
        Line that is printed before the import, which takes seconds on a cold machine; empty: none.
    extras
        Extras of solimon that the function needs.

    Raises
    ------
    MissingExtraError
        One of them is not installed; nothing is imported.
    """
    require_extras(*extras)
    if starting:
        from daq_service.processes.printing import print_line

        print_line(starting)
    module, _, function = target.partition(":")
    return getattr(import_module(f"daq_service.cli.{module}"), function)(**options) or EXIT_OK


def _build_command(name: str, table: Table) -> click.Command:
    """Build a click command from its entry in the table; a group if the entry has ``commands``."""
    text = f"{table['summary']}\n\n{table.get('details', '')}"
    if "commands" in table:
        return click.Group(name, [_build_command(*item) for item in table["commands"].items()], help=text)
    given = table["target"], table.get("starting", ""), table.get("extras", ())
    callback = partial(import_and_call, *given, **table.get("fixed", {}))
    return click.Command(name, callback=callback, params=list(_build_parameters(table["options"])), help=text)


def _build_parameters(options: Sequence[str | Table]) -> Iterator[click.Parameter]:
    """Yield the click options of a command; a string in the list names one or more shared options.

    Raises KeyError for an unknown one.
    """
    for option in options:
        if isinstance(option, str):
            shared: Table | Sequence[str] = _SHARED[option]
            yield from _build_parameters([shared] if isinstance(shared, Mapping) else shared)
        else:
            yield _build_parameter(**option)


def _build_parameter(
    *,
    option: str = "",
    argument: str = "",
    type: str = "",  # noqa: A002 - a key of the file
    choices: Sequence[str] = (),
    range: Table | None = None,  # noqa: A002 - a key of the file
    **attributes: Any,
) -> click.Parameter:
    """Build an option or argument of click from its entry in the table of commands.

    ``choices`` and ``range`` override ``type``. A pair of flags (``--on/--off``) has the default None.
    """
    kind = click.Choice(choices) if choices else _TYPES.get(type)
    if range is not None:
        kind = (click.IntRange if isinstance(range["min"], int) else click.FloatRange)(**range)
    if argument:
        return click.Argument([argument], type=kind, **attributes)
    if "/" in option:  # neither of the two spellings means none of them
        attributes["default"] = None
    return click.Option(option.split(), type=kind, **attributes)
