"""The control channel: one JSON object a line, over TCP, for tests and the demo.

A request is ``{"command": name, ...arguments}``; an answer ``{"ok": result}`` or ``{"error": text}``.
"""

from __future__ import annotations

import json
import socket
import socketserver
from collections.abc import Mapping
from dataclasses import asdict
from types import TracebackType
from typing import Any

from hardware_drivers.measurement import ShotKey
from simulator.doubles.brain import Brain
from simulator.doubles.errors import DoublesProcessError
from simulator.doubles.statuses import Status

DEFAULT_TIMEOUT_S = 30.0


class ControlServer(socketserver.ThreadingTCPServer):
    """Listens for `DoublesControl` on the loopback interface."""

    daemon_threads = True
    allow_reuse_address = True

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


class DoublesControl:
    """Client of the control channel; a context manager. Not for several threads at once."""

    def __init__(self, address: str, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        host, _, port = address.rpartition(":")
        self.address = address
        self._socket = socket.create_connection((host, int(port)), timeout=timeout_s)
        self._file = self._socket.makefile("rb")

    def __enter__(self) -> DoublesControl:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection; the double goes on."""
        self._file.close()
        self._socket.close()

    def _ask(self, command: str, **arguments: Any) -> Any:
        try:
            self._socket.sendall(json.dumps({"command": command} | arguments).encode() + b"\n")
            line = self._file.readline()
        except OSError as error:
            raise DoublesProcessError(f"the double at {self.address} does not answer: {error}") from error
        if not line:
            raise DoublesProcessError(f"the double at {self.address} is gone")
        answer = json.loads(line)
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer["ok"]

    def announce(self, key: ShotKey, hour_h: float) -> None:
        """Say which shot the next strike at the key's position is, and its hour."""
        self._ask("announce", key=asdict(key), hour_h=hour_h)

    def inject(
        self,
        function: str,
        kind: str,
        *,
        code: int | None = None,
        nth: int = 1,
        times: int = 1,
        seconds: float | None = None,
    ) -> None:
        """Order a fault (`faults.Faults.inject`); kind is error, hang, lie or death."""
        self._ask("inject", function=function, kind=kind, code=code, nth=nth, times=times, seconds=seconds)

    def clear_faults(self) -> None:
        """Forget every fault not yet carried out."""
        self._ask("clear_faults")

    def release_hangs(self) -> None:
        """Let hanging calls go on."""
        self._ask("release_hangs")

    def wait_until_hanging(self, timeout_s: float) -> bool:
        """Wait until a call hangs; False at the deadline."""
        return bool(self._ask("wait_until_hanging", timeout_s=timeout_s))

    def record(self) -> dict[str, Any]:
        """Fetch calls, lines, levels, tasks, reservations, leaks, strikes, boards (`Brain.record`)."""
        found: dict[str, Any] = self._ask("record")
        return found

    def clear_record(self) -> None:
        """Forget calls, line events and leaks."""
        self._ask("clear_record")

    def unplug(self, serial_number: int) -> None:
        """Take a board out."""
        self._ask("unplug", serial_number=serial_number)

    def plug(self, serial_number: int, name: str = "") -> None:
        """Put a board back, under another name if one is given."""
        self._ask("plug", serial_number=serial_number, name=name)

    def occupy(self, resource: str, owner: str) -> None:
        """Let another process hold ``<board>/ai``, ``<board>/ctr0`` ... (board by name or serial number)."""
        self._ask("occupy", resource=resource, owner=owner)

    def vacate(self, owner: str) -> None:
        """Let that other process give everything back."""
        self._ask("vacate", owner=owner)
