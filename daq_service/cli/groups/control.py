"""Commands that are sent to a running test."""

from __future__ import annotations

import sys
from importlib import import_module

import click


def send_command(*, kind: str, note: str, **given: object) -> int:
    """Send a control command to the recorder and return the exit code."""
    code: int = import_module("daq_service.commands.send").send_command(kind, note=note, **given)
    return code


def send_with_reason(*, kind: str, note: str, question: str, without_reason: str, **given: object) -> int:
    """Ask for a missing reason and send the command; without a terminal a missing one is an error."""
    if not note.strip():
        if not sys.stdin.isatty():
            raise click.UsageError(without_reason)
        note = click.prompt(question, err=True)
    return send_command(kind=kind, note=note, **given)


def switch_supply(
    *, on: bool | None, voltage_v: float | None, current_limit_a: float | None, note: str, **given: object
) -> int:
    """Send the command ``supply_on`` with its values, or ``supply_off``."""
    if on is None:
        raise click.UsageError("give --on or --off")
    values = {"voltage_v": voltage_v, "current_limit_a": current_limit_a}
    if on:
        return send_command(kind="supply_on", note=note, **given | values)
    if any(value is not None for value in values.values()):
        raise click.UsageError("--voltage-v and --current-limit-a belong to --on")
    return send_command(kind="supply_off", note=note, **given)
