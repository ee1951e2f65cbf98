"""Commands that are sent to a running test."""

from __future__ import annotations

import sys
from functools import partial
from importlib import import_module
from typing import Any

import click

from daq_service.cli.groups import options
from daq_service.cli.groups.options import command, option

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

SENT = (
    options.CONFIG,
    options.DATA_DIR,
    option("--note", "--reason", "note", default="", help="Reason; needed to pause and to renew a baseline."),
    option("--author", help="Author of the command; default: this user."),
    options.JSON,
)
OF_A_TRANSDUCER = (options.POSITION, *SENT)


def _send(kind: str, *, note: str, **given: Any) -> int:
    """Ask for a missing reason and send the command."""
    if kind in REASONS and not note.strip():
        message, question = REASONS[kind]
        if not sys.stdin.isatty():
            raise click.UsageError(message)
        note = click.prompt(question, err=True)
    code: int = import_module("daq_service.commands.send").send_command(kind, note=note, **given)
    return code


def _switch_supply(
    on: bool | None, voltage_v: float | None, current_limit_a: float | None, note: str, **given: Any
) -> int:
    if on is None:
        raise click.UsageError("give --on or --off")
    if not on and (voltage_v is not None or current_limit_a is not None):
        raise click.UsageError("--voltage-v and --current-limit-a belong to --on")
    values = {"voltage_v": voltage_v, "current_limit_a": current_limit_a} if on else {}
    return _send("supply_on" if on else "supply_off", note=note, **values, **given)


pause = command("pause", partial(_send, "pause"), *SENT)
resume = command("resume", partial(_send, "resume"), *SENT)
disable = command("disable", partial(_send, "disable"), *OF_A_TRANSDUCER)
enable = command("enable", partial(_send, "enable"), *OF_A_TRANSDUCER)
strike = command("strike", partial(_send, "strike"), *OF_A_TRANSDUCER)
approve_baseline = command("approve-baseline", partial(_send, "approve_baseline"), *OF_A_TRANSDUCER)
renew_baseline = command("renew-baseline", partial(_send, "renew_baseline"), *OF_A_TRANSDUCER)
trust_clock = command("trust-clock", partial(_send, "trust_clock"), *SENT)
supply = command(
    "supply",
    _switch_supply,
    option("--on/--off", "on", default=None, help="Switch the supply on or off."),
    option("--voltage-v", type=float, help="With --on: voltage in V; default: the configuration's."),
    option("--current-limit-a", type=float, help="With --on: limit in A; default: the configuration's."),
    *SENT,
    details="Nothing else ever switches it on.",
)
