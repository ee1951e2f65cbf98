"""Commands that are sent to a running test."""

from __future__ import annotations

import sys
from importlib import import_module

import click

REASONS = {
    "pause": (
        "a pause needs a reason, which everybody sees: --reason 'hands in the rig'",
        "Why is the test paused",
    ),
    "renew_baseline": (
        "a baseline is retired for a reason, which stays with it: --reason 'sensor coupled again'",
        "Why is the baseline retired",
    ),
}
"""Error for a command without its reason, and the question at a terminal."""


def send(*, kind: str, note: str, **given: object) -> int:
    """Ask for a missing reason and send the command."""
    if kind in REASONS and not note.strip():
        message, question = REASONS[kind]
        if not sys.stdin.isatty():
            raise click.UsageError(message)
        note = click.prompt(question, err=True)
    code: int = import_module("daq_service.commands.send").send_command(kind, note=note, **given)
    return code


def switch_supply(
    *, on: bool | None, voltage_v: float | None, current_limit_a: float | None, note: str, **given: object
) -> int:
    """Send ``supply_on`` with its values, or ``supply_off``."""
    if on is None:
        raise click.UsageError("give --on or --off")
    values = {"voltage_v": voltage_v, "current_limit_a": current_limit_a}
    if on:
        return send(kind="supply_on", note=note, **given | values)
    if any(value is not None for value in values.values()):
        raise click.UsageError("--voltage-v and --current-limit-a belong to --on")
    return send(kind="supply_off", note=note, **given)
