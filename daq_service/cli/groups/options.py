"""Build commands: shared options, and calls that import the module of a command when it runs."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from daq_service.cli.groups.registry import summary
from daq_service.errors import EXIT_OK


class _Positive(click.FloatRange):
    """Positive finite number: a range alone accepts infinity and NaN."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is no finite number.", param, ctx)
        return number


Decorator = Callable[[Any], Any]
option, argument, Choice, IntRange = click.option, click.argument, click.Choice, click.IntRange

PATH = click.Path(path_type=Path)
FILE = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)
PORT_NUMBER = IntRange(0, 65535)
POSITIVE = _Positive(min=0.0, min_open=True)

CONFIG = argument("config", required=False, type=FILE)
CONFIG_FILE = argument("config", type=FILE)
NEW_FILE = argument("file", type=FILE)
DATA_DIR = option("--data-dir", type=FOLDER, help="Data folder; default: the configuration's.")
DATA_DIR_ALONE = option("--data-dir", type=FOLDER, required=True, help="Data folder of the test.")
ONE_TEST = (CONFIG, DATA_DIR)
SEED = option("--seed", type=IntRange(min=0), help="Seed of the twin's random numbers.")
JSON = option("--json", "as_json", is_flag=True, help="Print one JSON object on standard output.")
POSITION = option("--position", required=True, help="Position of the transducer, for example B.")
OVERWRITE = option("--overwrite", is_flag=True, help="Replace files that exist.")
FILES_JSON = (OVERWRITE, JSON)
ONE_TEST_JSON = (*ONE_TEST, JSON)
DATA_JSON = (DATA_DIR_ALONE, JSON)
NO_WEB = option("--no-web", is_flag=True, help="Start no web page.")
PAGE = (
    option("--port", type=PORT_NUMBER, default=0, show_default=True, help="Port; 0 takes a free one."),
    NO_WEB,
    option("--no-browser", is_flag=True, help="Do not open a browser."),
)
WORKERS = option("--workers", type=IntRange(1, 256), help="Worker count; default: one for each core.")
OF_A_CHILD = (
    option("--restart-reason", default="", hidden=True),
    option("--supervised", is_flag=True, hidden=True),
)


def repeated(flag: str, parameter: str, metavar: str, text: str) -> Decorator:
    """Return an option that may be given several times."""
    return option(flag, parameter, metavar=metavar, multiple=True, help=text)


def executor(text: str) -> Decorator:
    """Return the option that chooses where a long computation runs."""
    return option("--executor", metavar="processes|threads|dask://HOST", help=text)


def call(target: str, **options: Any) -> int:
    """Import the function ``MODULE:NAME`` of the command line and return its exit code."""
    module, _, function = target.partition(":")
    return getattr(import_module(f"daq_service.cli.{module}"), function)(**options) or EXIT_OK


def command(
    name: str, target: str | Callable[..., int | None], *options: Decorator, details: str = ""
) -> click.Command:
    """Build a command of the registry.

    Parameters
    ----------
    target
        Function that receives the options; as ``MODULE:NAME``, it is imported when the command runs.
    details
        Help after the summary.
    """
    return build(name, target, *options, text=f"{summary(name)}\n\n{details}")


def group(name: str, *commands: click.Command, details: str = "") -> click.Group:
    """Build a command of the registry that has commands of its own."""
    return click.Group(name, list(commands), help=f"{summary(name)}\n\n{details}")


def build(
    name: str, target: str | Callable[..., int | None], *options: Decorator, text: str
) -> click.Command:
    """Build a command with this help text."""
    function: Callable[..., int | None] = partial(call, target) if isinstance(target, str) else target
    for add_option in reversed(options):
        function = add_option(function)
    return click.command(name, help=text)(function)
