"""Run ``status``: once, or repeatedly with ``--watch``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from daq_service.cli.status.facts import describe_status
from daq_service.cli.terminal import create_console
from daq_service.errors import EXIT_INTERRUPTED, EXIT_OK, SolimonError, UsageError
from daq_service.processes.child import stop_on_signals
from daq_service.processes.data_folder import load_settings_for_reading, require_data_folder
from daq_service.settings.foreign_text import escape_to_one_line

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

WATCH_EVERY_S = 1.0
PIPE_COLUMNS = 1000
"""What a program reads is not broken into lines for a screen."""


def run_status(*, config: Path | None, data_dir: Path | None, as_json: bool, watch: bool) -> int:
    """Run `solimon status`: print the status of a test once, or repeatedly until Ctrl-C with ``watch``.

    Returns 0, or 130 after ``watch``.

    Raises
    ------
    UsageError
        The folder is missing or holds other files, or ``watch`` has no terminal.
    StorageError
        The catalogue is lost, or cannot be read.
    """
    folder, facts = _read_status(config, data_dir)
    if as_json and not watch:
        click.echo(json.dumps(facts))
        return EXIT_OK

    from daq_service.cli.status.table import compose_status

    console = create_console("stdout")
    if watch:
        if as_json or not console.is_terminal:
            raise UsageError(
                "--watch draws on a terminal, and this is none; ask again and again without it, or take the "
                "stream of `solimon serve`"
            )
        return _watch_status(console, config, data_dir)
    if console.is_terminal:
        console.print(compose_status(facts, str(folder)))
        return EXIT_OK
    console.width = PIPE_COLUMNS
    with console.capture() as captured:
        console.print(compose_status(facts, str(folder)))
    click.echo("\n".join(line.rstrip() for line in captured.get().rstrip().splitlines()))
    return EXIT_OK


def _read_status(config: Path | None, data_dir: Path | None) -> tuple[Path, dict[str, object]]:
    """Return the data folder and its status for JSON.

    Raises UsageError for a missing or foreign folder, StorageError as `describe_status`.
    """
    settings, folder = load_settings_for_reading(config, data_dir)
    require_data_folder(folder)
    return folder, describe_status(folder, settings)


def _watch_status(console: Console, config: Path | None, data_dir: Path | None) -> int:
    """Show the status every `WATCH_EVERY_S` until Ctrl-C and return 130; errors are shown and retried."""
    from rich.live import Live

    last: RenderableType = ""
    # Not as an exception: one that comes within a callback of a library is lost.
    with stop_on_signals() as stop, Live(console=console, screen=True, auto_refresh=False) as live:
        while not stop.is_set():
            last = _compose_status_or_error(config, data_dir)
            live.update(last, refresh=True)
            stop.wait(WATCH_EVERY_S)
    console.print(last)
    return EXIT_INTERRUPTED


def _compose_status_or_error(config: Path | None, data_dir: Path | None) -> RenderableType:
    """Return the table of the status, or the message of a solimon error that prevents reading it."""
    from daq_service.cli.status.table import compose_status

    try:
        folder, facts = _read_status(config, data_dir)
    except SolimonError as error:
        return f"cannot be read now; next attempt follows: {escape_to_one_line(str(error))}"
    return compose_status(facts, str(folder))
