"""Server of the control channel: one JSON object per line, over TCP.

A request is ``{"command": name, ...arguments}``; an answer ``{"ok": result}`` or ``{"error": text}``.
"""

from __future__ import annotations

import json
import socketserver
from collections.abc import Callable, Mapping
from typing import Any

from hardware_drivers.measurement import ShotKey
from simulator.doubles.device_model import Brain
from simulator.doubles.transports.server import LoopbackServer
from simulator.doubles.vendor_api.statuses import Status


class ControlServer(LoopbackServer):
    """Server for `DoublesControl` on the loopback interface."""

    def __init__(self, brain: Brain) -> None:
        super().__init__(brain, _Connection)


class _Connection(socketserver.StreamRequestHandler):
    """Connection of one controlling process."""

    server: ControlServer

    def handle(self) -> None:
        """Answer JSON requests, one per line, until the peer closes; an invalid one with its error."""
        for line in self.rfile:
            try:
                request = json.loads(line)
                answer: dict[str, Any] = {"ok": execute_request(self.server.brain, request)}
            except (ValueError, TypeError, KeyError, Status) as error:
                answer = {"error": f"{type(error).__name__}: {error}"}
            self.wfile.write(json.dumps(answer).encode() + b"\n")


def execute_request(brain: Brain, request: Mapping[str, Any]) -> Any:
    """Execute one control request on the doubles; return its result in JSON types, None for most commands.

    Raises
    ------
    ValueError, TypeError, KeyError, Status
        No such command, or invalid arguments.
    """
    arguments = dict(request)
    command = arguments.pop("command", None)
    commands: Mapping[Any, Callable[..., Any]] = {
        "announce": lambda key, hour_h: brain.announce(ShotKey(**key), float(hour_h)),
        "disturb": brain.disturb,
        "inject": brain.faults.inject,
        "clear_faults": brain.faults.clear,
        "release_hangs": brain.faults.release,
        "wait_until_hanging": brain.faults.wait_until_hanging,
        "wait_until_no_tasks": brain.wait_until_no_tasks,
        "wait_until_quiet": brain.wait_until_quiet,
        "record": brain.record,
        "clear_record": brain.clear_record,
        "unplug": brain.unplug,
        "plug": brain.plug,
        "occupy": brain.occupy,
        "vacate": brain.vacate,
    }
    if command not in commands:
        raise ValueError(f"command is {command!r}; there is no such command")
    return commands[command](**arguments)
