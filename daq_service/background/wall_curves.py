"""Simulate the wall curves of transducers that no file holds, once, while a test in real time records."""

from __future__ import annotations

import logging
import multiprocessing
import os
from collections.abc import Callable, Sequence
from multiprocessing.process import BaseProcess

from daq_service.assessment.wall_bank import Kind, build_bank, open_bank, store_bank
from daq_service.background.task import BackgroundTask
from daq_service.processes.installation import MissingExtraError, require_extras
from daq_service.processes.worker import leave_with_parent

log = logging.getLogger(__name__)

LOW_PRIORITY = 10
"""Increment of a process's niceness: a set always comes first."""


def build_missing_banks(kinds: Sequence[Kind]) -> None:
    """Build and store the banks of these kinds; for a process of its own, with low priority."""
    leave_with_parent()
    if hasattr(os, "nice"):
        os.nice(LOW_PRIORITY)
    for kind in kinds:
        store_bank(build_bank(*kind))


class WallCurves(BackgroundTask):
    """Background task that has the missing banks built; without one a transducer has no wall thickness yet.

    Parameters
    ----------
    kinds
        That of each transducer's bank.
    build
        Builds the missing ones, in another process.
    """

    def __init__(
        self, kinds: Sequence[Kind], build: Callable[[Sequence[Kind]], None] = build_missing_banks
    ) -> None:
        self._process: BaseProcess | None = None
        missing = [kind for kind in dict.fromkeys(kinds) if open_bank(*kind) is None]
        if not missing:
            return
        try:
            require_extras("twin")
        except MissingExtraError as error:
            log.warning("no wall thickness, its curves need the twin: %s", error)
            return
        self._process = multiprocessing.get_context("spawn").Process(target=build, args=(missing,))
        self._process.daemon = True
        self._process.start()
        log.info("simulating the wall curves of %d transducers, about 6 min of CPU each", len(missing))

    def run_for(self, seconds: float) -> None:
        """Report the end of the simulation."""
        del seconds
        if self._process is not None and self._process.exitcode is not None:
            if self._process.exitcode == 0:
                log.info("the wall curves are there: wall thickness from the next set on")
            else:
                log.warning("no wall curves (exit code %d): no wall thickness", self._process.exitcode)
            self._process = None

    def close(self) -> None:
        """End the simulation; the next recorder begins it again."""
        if self._process is not None:
            self._process.terminate()
            self._process.join()
