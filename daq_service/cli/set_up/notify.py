"""``notify test``: send test messages to receivers from this computer as this user."""

from __future__ import annotations

import json
import time
from pathlib import Path

import click

from daq_service.commands.send import get_user_name
from daq_service.errors import EXIT_NOT_MET, EXIT_OK, UsageError
from daq_service.processes.data_folder import load_settings_and_folder
from daq_service.processes.notifications.addresses import read_address
from daq_service.processes.notifications.by_apprise import deliver_by_apprise
from daq_service.processes.notifications.messages import Test, build_test_message
from daq_service.processes.notifications.webhook import Outcome, post_message


def run_test(*, config: Path | None, receiver: str | None, as_json: bool) -> int:
    """Run `solimon notify test`: send a test message to one receiver, or to all, and print the results.

    Returns 0 if every message was accepted, otherwise 6.

    Raises
    ------
    UsageError
        There is no such receiver, or its address or secret is missing; earlier messages are then
        already sent.
    """
    settings, _ = load_settings_and_folder(config, None)
    receivers = settings.notifications.receivers
    if not receivers or (receiver is not None and receiver not in receivers):
        wanted = "receivers are configured" if receiver is None else f"receiver {receiver!r} is configured"
        names = ", ".join(receivers) or "none"
        raise UsageError(f"no {wanted}; there are: {names} (see [notifications.receivers.NAME])")
    results: dict[str, Outcome] = {}
    for name in receivers if receiver is None else [receiver]:
        receiver_settings, test = receivers[name], Test(name=settings.name, mark="terminal")
        address = read_address(name, receiver_settings)
        message = build_test_message(test, name, get_user_name(), now_ns=time.time_ns())
        results[name] = (
            deliver_by_apprise(address, message)
            if receiver_settings.kind == "apprise"
            else post_message(address, message)
        )
        if not as_json:
            click.echo(f"{name:<24} {'ok' if results[name].ok else 'FAILED':<7} {results[name].description}")
    if as_json:
        outcomes = {
            name: {"ok": result.ok, "result": result.description, "status": result.status}
            for name, result in results.items()
        }
        click.echo(json.dumps({"receivers": outcomes}))
    return EXIT_OK if all(result.ok for result in results.values()) else EXIT_NOT_MET
