"""Commands that are sent to a running test."""

from __future__ import annotations

import sys
from importlib import import_module

import click


def send_command(*, kind: str, note: str, **given: object) -> int:
    """Send a control command to the recorder, print its answer and return the exit code.

    ``given`` are further arguments of `daq_service.commands.send.send_command`.

    Raises
    ------
    BusyError
        No recorder runs, the command expired, or its result is unknown.
    UsageError
        Invalid arguments or folder, or the recorder refused.
    StorageError
        There are no data yet, or the catalogue cannot be written.
    """
    code: int = import_module("daq_service.commands.send").send_command(kind, note=note, **given)
    return code


def send_with_reason(*, kind: str, note: str, question: str, without_reason: str, **given: object) -> int:
    """Ask on the terminal for a missing reason, send the command, and return the exit code.

    Raises `click.UsageError` with the text ``without_reason`` if the reason is missing and standard input is
    no terminal, `click.Abort` if the question is cancelled; otherwise the errors of `send_command`.
    """
    if not note.strip():
        if not sys.stdin.isatty():
            raise click.UsageError(without_reason)
        note = click.prompt(question, err=True)
    return send_command(kind=kind, note=note, **given)


def switch_supply(
    *, on: bool | None, voltage_v: float | None, current_limit_a: float | None, note: str, **given: object
) -> int:
    """Send the command ``supply_on`` with voltage (V) and current limit (A), or ``supply_off``.

    Raises `click.UsageError` if neither is chosen, or values are given with ``--off``; otherwise the errors
    of `send_command`.
    """
    if on is None:
        raise click.UsageError("give --on or --off")
    values = {"voltage_v": voltage_v, "current_limit_a": current_limit_a}
    if on:
        return send_command(kind="supply_on", note=note, **given | values)
    if any(value is not None for value in values.values()):
        raise click.UsageError("--voltage-v and --current-limit-a belong to --on")
    return send_command(kind="supply_off", note=note, **given)
