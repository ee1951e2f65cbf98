"""Doubles and clients in processes that start at once: forked from a server that has imported everything.

A process of its own is what dies or is killed in a test; started the usual way it would import for a
second or two each time.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest

from simulator.doubles.chassis.description import Description, to_json
from simulator.doubles.transports.control import DoublesControl, RunningDoubles
from support.waiting import MachineTooSlowError, happened

METHOD = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"


def context() -> multiprocessing.context.BaseContext:
    """Return the context that starts processes; the server imports this module before it forks."""
    made = multiprocessing.get_context(METHOD)
    if METHOD == "forkserver":
        here = Path(__file__).parents[1]
        paths = [str(here), str(here.parent), os.environ.get("PYTHONPATH", "")]
        os.environ["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
        made.set_forkserver_preload(["support.daqmx_models", "support.daqmx_warm"])
        with pytest.MonkeyPatch.context() as patch:
            patch.delenv("LD_LIBRARY_PATH", raising=False)  # a child finds no driver unless it gets one
            forkserver.ensure_running()
    return made


class RunningBrain(RunningDoubles):
    """Double in a forked process."""

    def kill(self) -> None:
        """End the process at once, as a crash of the driver would."""
        self.process.kill()
        self.process.join()


class _Ends:
    """Standard input and output of a double at a pipe: one line, then a wait for the end."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self.buffer = self

    def write(self, text: str) -> int:
        if text.strip():
            self._pipe.send(text)
        return len(text)

    def flush(self) -> None:
        """Do nothing: nothing is buffered."""

    def read(self) -> bytes:
        with suppress(EOFError):  # the end that is waited for
            self._pipe.recv()
        return b""


def serve(file: str, pipe: Connection) -> None:
    """Run ``python -m simulator.doubles`` in a child until the other end of the pipe is closed."""
    from simulator.doubles.__main__ import main

    sys.stdin = sys.stdout = _Ends(pipe)
    main(["--description", file])


@contextmanager
def running_brain(description: Description) -> Iterator[RunningBrain]:
    """Start a double, wait until it is ready, end it afterwards."""
    here, there = multiprocessing.Pipe()
    with tempfile.TemporaryDirectory(prefix="solimon-brain-") as folder:
        file = Path(folder) / "description.json"
        file.write_text(to_json(description), encoding="utf-8")
        process = context().Process(target=serve, args=(str(file), there), daemon=True)
        process.start()
        there.close()
        try:
            happened(here.poll, "the double was ready")
        except MachineTooSlowError:
            process.kill()
            raise
        ready = json.loads(here.recv())
    try:
        with DoublesControl(ready["control"]) as control:
            yield RunningBrain(wire=ready["wire"], grpc=ready["grpc"], control=control, process=process)
    finally:
        here.close()
        process.kill()
        process.join()
        process.close()


def in_a_process(work: Callable[..., None], *arguments: object) -> BaseProcess:
    """Start a client in a process of its own."""
    process = context().Process(target=work, args=arguments, daemon=True)
    process.start()
    return process
