"""Control of a double in a process of its own: the side of tests and the demonstration.

The control channel carries one JSON object a line; `control_server` answers it.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hardware_drivers.measurement import ShotKey
from simulator.doubles.chassis.crosstalk import Crosstalk
from simulator.doubles.chassis.description import Description, build_default_description, to_json
from simulator.doubles.errors import DoublesProcessError
from simulator.doubles.transports.library import DEFAULT_CACHE_FOLDER, build_environment, build_library

DEFAULT_TIMEOUT_S = 30.0
READY_TIMEOUT_S = 60.0
EXIT_TIMEOUT_S = 10.0


class DoublesControl:
    """Client of the control channel; a context manager. Not for several threads at once."""

    def __init__(self, address: str, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        host, _, port = address.rpartition(":")
        self.address = address
        self._timeout_s = timeout_s
        self._socket = socket.create_connection((host, int(port)), timeout=timeout_s)
        self._file = self._socket.makefile("rb")

    def __enter__(self) -> DoublesControl:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the control connection; the double continues."""
        self._file.close()
        self._socket.close()

    def _send_command(self, command: str, **arguments: Any) -> Any:
        """Send a command to the double, wait for its answer, and return the result.

        The time limit is that of the connection, plus the command's ``timeout_s``, if any.

        Raises
        ------
        DoublesProcessError
            The double is gone, or does not answer in time.
        ValueError
            It rejects the command.
        """
        # A question that waits is answered only then.
        self._socket.settimeout(self._timeout_s + arguments.get("timeout_s", 0.0))
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
        """Set key and hour of the next strike, or pulse-echo record, at the key's position.

        Raise ValueError if nothing is wired there.
        """
        self._send_command("announce", key=asdict(key), hour_h=hour_h)

    def disturb(self, position: str, crosstalk: Crosstalk) -> None:
        """Replace the crosstalk from the coil at a position into its sensor; `Crosstalk()` removes it."""
        self._send_command("disturb", position=position, crosstalk=asdict(crosstalk))

    def inject(self, function: str, kind: str, **how: float | None) -> None:
        """Request a fault of kind error, hang, lie or death (`faults.Faults.inject` has the other arguments).

        Raise ValueError if it is invalid.
        """
        self._send_command("inject", function=function, kind=kind, **how)

    def clear_faults(self) -> None:
        """Discard every pending fault; calls that hang continue to hang."""
        self._send_command("clear_faults")

    def release_hangs(self) -> None:
        """Release all calls that hang; they are then executed."""
        self._send_command("release_hangs")

    def wait_until_hanging(self, timeout_s: float) -> bool:
        """Block until a call hangs; return False if none does within ``timeout_s``."""
        return bool(self._send_command("wait_until_hanging", timeout_s=timeout_s))

    def wait_until_no_tasks(self, timeout_s: float) -> bool:
        """Block until no task exists, as after a client's end; return False after ``timeout_s``."""
        return bool(self._send_command("wait_until_no_tasks", timeout_s=timeout_s))

    def wait_until_quiet(self, timeout_s: float) -> bool:
        """Block until no striker falls and no wave continues; return False after ``timeout_s``."""
        return bool(self._send_command("wait_until_quiet", timeout_s=timeout_s))

    def record(self) -> dict[str, Any]:
        """Return everything that the double has recorded, in JSON types (`Brain.record`)."""
        found: dict[str, Any] = self._send_command("record")
        return found

    def clear_record(self) -> None:
        """Discard recorded calls, level changes and leaked tasks; levels, tasks and strikes stay."""
        self._send_command("clear_record")

    def unplug(self, serial_number: int) -> None:
        """Remove a board from the chassis by serial number; raise ValueError if there is none."""
        self._send_command("unplug", serial_number=serial_number)

    def plug(self, serial_number: int, name: str = "") -> None:
        """Plug a removed board in, under another name if one is given; raise ValueError if there is none."""
        self._send_command("plug", serial_number=serial_number, name=name)

    def occupy(self, resource: str, owner: str) -> None:
        """Reserve ``<board>/ai``, ``<board>/ctr0`` ... or an NI-SCOPE board for another process, ``owner``.

        A board is given by name or serial number. Raise ValueError for an unknown name.
        """
        self._send_command("occupy", resource=resource, owner=owner)

    def vacate(self, owner: str) -> None:
        """Release everything that `occupy` has reserved for this owner."""
        self._send_command("vacate", owner=owner)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunningDoubles:
    """Running double.

    Attributes
    ----------
    wire, grpc
        Addresses, ``host:port``: for the C libraries and for gRPC (empty without that front).
    control
        The control channel, connected; `DoublesControl.address` is where another process connects.
    """

    wire: str
    grpc: str
    control: DoublesControl
    process: subprocess.Popen[bytes]

    def client_environment(
        self,
        *libraries: str,
        cache: Path = DEFAULT_CACHE_FOLDER,
        environment: Mapping[str, str] | None = None,
    ) -> dict[str, str]:
        """Return the environment of a child process that uses this double; build missing libraries.

        Parameters
        ----------
        libraries
            Keys of `library.SONAMES`; none: ``nidaqmx``.
        environment
            Variables to start from; None: those of this process.

        Raises
        ------
        LibraryBuildError
            A library cannot be built here.
        """
        folders = [build_library(library, cache) for library in libraries or ("nidaqmx",)]
        return build_environment(self.wire, *folders, environment=environment)

    def kill(self) -> None:
        """Kill the process, as a crash of the driver does, and wait for its end.

        Raise subprocess.TimeoutExpired if it has not ended after `EXIT_TIMEOUT_S`.
        """
        self.process.kill()
        self.process.wait(EXIT_TIMEOUT_S)


@contextmanager
def running_doubles(
    description: Description | None = None, *, warm_up: bool = True, timeout_s: float = READY_TIMEOUT_S
) -> Iterator[RunningDoubles]:
    """Run ``python -m simulator.doubles`` within the context; wait until it is ready.

    At exit its standard input closes; it is killed if it does not end within `EXIT_TIMEOUT_S`.

    Raises
    ------
    DoublesProcessError
        It ended, or was not ready within ``timeout_s``.
    """
    with tempfile.TemporaryDirectory(prefix="solimon-doubles-") as folder:
        file = Path(folder) / "description.json"
        file.write_text(to_json(description or build_default_description()), encoding="utf-8")
        command = [sys.executable, "-P", "-m", "simulator.doubles", "--description", str(file)]
        if not warm_up:
            command.append("--no-warm-up")
        # The double itself is no client: a library path meant for clients does not concern it.
        environment = {name: text for name, text in os.environ.items() if name != "SOLIMON_DOUBLES"}
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            ready = _read_ready_line(process, timeout_s)
            with DoublesControl(ready["control"]) as control:
                yield RunningDoubles(
                    wire=ready["wire"], grpc=ready.get("grpc", ""), control=control, process=process
                )
        finally:
            process.stdin.close()
            try:
                process.wait(EXIT_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            process.stdout.close()


def _read_ready_line(process: subprocess.Popen[bytes], timeout_s: float) -> dict[str, str]:
    """Read the JSON line that a process prints when it is ready; kill the process after ``timeout_s``.

    Raises
    ------
    DoublesProcessError
        It ended before, or no line came in time.
    """
    assert process.stdout is not None
    # A pipe has no deadline of its own on every platform; ending the process ends the wait.
    watch = threading.Timer(timeout_s, process.kill)
    watch.start()
    try:
        line = process.stdout.readline()
    finally:
        watch.cancel()
    if not line:
        raise DoublesProcessError(
            f"the double ended with code {process.wait()} or was not ready within {timeout_s} s; "
            "see its standard error"
        )
    ready: dict[str, str] = json.loads(line)
    return ready
