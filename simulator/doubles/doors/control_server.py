"""The control channel's server: one JSON object a line, over TCP.

A request is ``{"command": name, ...arguments}``; an answer ``{"ok": result}`` or ``{"error": text}``.
"""

from __future__ import annotations

import json
import socketserver
from collections.abc import Mapping
from typing import Any

from hardware_drivers.measurement import ShotKey
from simulator.doubles.brain import Brain
from simulator.doubles.vendor_api.statuses import Status


class ControlServer(socketserver.ThreadingTCPServer):
    """Listens for `DoublesControl` on the loopback interface."""

    daemon_threads = True

    def __init__(self, brain: Brain, host: str = "127.0.0.1", port: int = 0) -> None:
        super().__init__((host, port), _Connection)
        self.brain = brain

    @property
    def address(self) -> str:
        """``host:port``."""
        host, port = self.server_address[:2]
        return f"{host!s}:{port}"


class _Connection(socketserver.StreamRequestHandler):
    server: ControlServer

    def handle(self) -> None:
        """Answer requests until the peer closes."""
        for line in self.rfile:
            try:
                request = json.loads(line)
                answer: dict[str, Any] = {"ok": obey(self.server.brain, request)}
            except (ValueError, TypeError, KeyError, Status) as error:
                answer = {"error": f"{type(error).__name__}: {error}"}
            self.wfile.write(json.dumps(answer).encode() + b"\n")


def obey(brain: Brain, request: Mapping[str, Any]) -> Any:
    """Carry out one request.

    Raises
    ------
    ValueError
        No such command, or arguments that make no sense.
    """
    arguments = dict(request)
    match arguments.pop("command", None):
        case "announce":
            brain.announce(ShotKey(**arguments["key"]), float(arguments["hour_h"]))
        case "inject":
            brain.faults.inject(**arguments)
        case "clear_faults":
            brain.faults.clear()
        case "release_hangs":
            brain.faults.release()
        case "wait_until_hanging":
            return brain.faults.wait_until_hanging(float(arguments["timeout_s"]))
        case "wait_until_no_tasks":
            return brain.wait_until_no_tasks(float(arguments["timeout_s"]))
        case "wait_until_quiet":
            return brain.wait_until_quiet(float(arguments["timeout_s"]))
        case "record":
            return brain.record()
        case "clear_record":
            brain.clear_record()
        case "unplug":
            brain.unplug(int(arguments["serial_number"]))
        case "plug":
            brain.plug(int(arguments["serial_number"]), str(arguments.get("name", "")))
        case "occupy":
            brain.occupy(str(arguments["resource"]), str(arguments["owner"]))
        case "vacate":
            brain.vacate(str(arguments["owner"]))
        case command:
            raise ValueError(f"command is {command!r}; there is no such command")
    return None
