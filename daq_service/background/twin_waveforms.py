"""Simulate waveforms of the twin on request, one at a time, in another process; each is kept in memory."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

from analysis.errors import AnalysisError
from analysis.waves.record_reduction import ExtractionSettings
from daq_service.assessment.twin_waveform import SimulatedShot, simulate_curve_shot
from daq_service.background.wall_curves import LOW_PRIORITY
from daq_service.processes.installation import MissingExtraError
from daq_service.processes.worker import leave_with_parent
from simulator.errors import SimulatorError
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import PlateParameters

Shot = tuple[ChainParameters, PlateParameters, ExtractionSettings, str, float]
"""Arguments of `simulate_curve_shot`."""
KEPT = 64
"""Shots in memory, some 30 kB each; then all are forgotten."""


def send_shot(results: Connection, shot: Shot) -> None:
    """Simulate a shot and send it, or the error; for a process of its own, with low priority."""
    leave_with_parent()
    if hasattr(os, "nice"):
        os.nice(LOW_PRIORITY)
    try:
        results.send(simulate_curve_shot(*shot))
    except (MissingExtraError, AnalysisError, SimulatorError) as error:
        results.send(error)


class TwinWaveforms:
    """Simulated shots, for threads.

    Parameters
    ----------
    send
        Sends a simulated shot, or the error, from another process.
    """

    def __init__(self, send: Callable[[Connection, Shot], None] = send_shot) -> None:
        self._send, self._lock = send, threading.Lock()
        self._found: dict[Shot, SimulatedShot | Exception] = {}
        self._running: tuple[Shot, BaseProcess, Connection] | None = None

    def find(self, shot: Shot) -> SimulatedShot | None:
        """Return a shot; None as long as it, or another one, is simulated.

        Raises
        ------
        MissingExtraError, AnalysisError, SimulatorError
            As `simulate_curve_shot`.
        """
        with self._lock:
            self._receive()
            if shot not in self._found and self._running is None:
                context = multiprocessing.get_context("spawn")
                results, sender = context.Pipe(duplex=False)
                process = context.Process(target=self._send, args=(sender, shot), daemon=True)
                process.start()
                sender.close()
                self._running = shot, process, results
            found = self._found.get(shot)
        if isinstance(found, Exception):
            raise found
        return found

    def _receive(self) -> None:
        """Keep the result of the process that is done, if one is."""
        if self._running is None or not self._running[2].poll():
            return
        shot, process, results = self._running
        if len(self._found) >= KEPT:
            self._found.clear()
        try:
            self._found[shot] = results.recv()
        except EOFError:
            process.join()
            self._found[shot] = SimulatorError(f"the simulation ended (exit code {process.exitcode})")
        self._running = None

    def close(self) -> None:
        """End the process that simulates."""
        with self._lock:
            if self._running is not None:
                self._running[1].terminate()
                self._running[1].join()
                self._running = None
