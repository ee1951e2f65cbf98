"""Run a double beside the caller and take it down again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from simulator.doubles.control import DoublesControl
from simulator.doubles.description import Description, default_description, to_json
from simulator.doubles.errors import DoublesProcessError
from simulator.doubles.library import DEFAULT_CACHE_FOLDER, build_library, client_environment

READY_TIMEOUT_S = 60.0
EXIT_TIMEOUT_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunningDoubles:
    """A double that is up.

    Attributes
    ----------
    wire, grpc
        Addresses for the C library and for gRPC (empty without that front).
    control
        Connected control channel.
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
        """Environment of a child process that shall meet this double; builds the libraries if needed."""
        folders = [build_library(library, cache) for library in libraries or ("nidaqmx",)]
        return client_environment(self.wire, *folders, environment=environment)

    def kill(self) -> None:
        """End the process at once, as a crash of the driver would."""
        self.process.kill()
        self.process.wait(EXIT_TIMEOUT_S)


@contextmanager
def running_doubles(
    description: Description | None = None, *, warm_up: bool = True, timeout_s: float = READY_TIMEOUT_S
) -> Iterator[RunningDoubles]:
    """Start ``python -m simulator.doubles``, wait until it is ready, end it afterwards.

    Raises
    ------
    DoublesProcessError
        It ended or said nothing within `timeout_s`.
    """
    with tempfile.TemporaryDirectory(prefix="solimon-doubles-") as folder:
        file = Path(folder) / "description.json"
        file.write_text(to_json(description or default_description()), encoding="utf-8")
        command = [sys.executable, "-m", "simulator.doubles", "--description", str(file)]
        if not warm_up:
            command.append("--no-warm-up")
        # The double itself is no client: a library path meant for clients does not concern it.
        environment = {name: text for name, text in os.environ.items() if name != "SOLIMON_DOUBLES"}
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            ready = _ready(process, timeout_s)
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


def _ready(process: subprocess.Popen[bytes], timeout_s: float) -> dict[str, str]:
    """Ready line of a process that was just started."""
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
            "its standard error says why"
        )
    ready: dict[str, str] = json.loads(line)
    return ready
