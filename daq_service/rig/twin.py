"""The twin's physics in a process of its own, beside the recorder's line.

Threads would share the interpreter's lock: the extraction of features hands it over at every array, and
each handing over costs as much as what is computed. Here a worker process builds the same specimen from the
same settings and computes records by their key; the recorder strikes, reads and stores as ever. The worker
holds nothing that could be lost: where it dies, the recorder computes its records itself.

The simulator is imported where it is needed: the worker starts while the recorder imports its own.
"""

from __future__ import annotations

import atexit
import multiprocessing
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

from daq_service.processes.worker import leave_with_parent, one_worker
from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Acquired
from hardware_drivers.measurement import ShotKey
from hardware_drivers.methods import PULSE_ECHO, SOLITARY_WAVE

if TYPE_CHECKING:
    from simulator.specimen import Specimen, Transducer


def transducers_of(settings: Settings) -> dict[str, Transducer]:
    """Chain and physics of each solitary-wave position.

    Raises
    ------
    SimulatorError
        One cannot be built as configured.
    """
    from simulator.shot.model import ShotModel
    from simulator.specimen import Transducer

    places = settings.positions
    return {
        name: Transducer(
            chain=places[name].chain,
            model=ShotModel(places[name].chain, places[name].plate, places[name].corrosion),
        )
        for name in settings.names_of(SOLITARY_WAVE)
    }


def twin_executor(settings: Settings, told: Connection | None = None) -> ProcessPoolExecutor:
    """One worker process that computes `records` of these settings; its owner shuts it down.

    Parameters
    ----------
    told
        Where it says that it begins to compile (True) and that it has (False).
    """
    return one_worker(_prepare, settings.model_dump_json(), told)


@contextmanager
def twin_process(settings: Settings, compiling: Callable[[bool], None]) -> Iterator[ProcessPoolExecutor]:
    """Give that process; a thread here calls ``compiling`` with what it says of its compilations."""
    hear, told = multiprocessing.get_context("spawn").Pipe(duplex=False)
    with hear:
        with told:  # once it has started, it alone holds this end: the pipe ends with it
            executor = twin_executor(settings, told)
        listening = threading.Thread(
            target=_pass_on, args=(hear, compiling), name="news-of-the-worker", daemon=True
        )
        listening.start()
        try:
            yield executor
        finally:
            executor.shutdown(cancel_futures=True)
            listening.join()


def _pass_on(hear: Connection, compiling: Callable[[bool], None]) -> None:
    begun = False
    with suppress(EOFError, OSError):  # the worker has ended, or was killed in the midst of a word
        while True:
            begun = hear.recv()
            compiling(begun)
    if begun:
        compiling(False)


def records(settings_json: str, strikes: Sequence[tuple[ShotKey, float]]) -> list[Acquired | None]:
    """Compute records of strikes in the worker (`Specimen.solitary_waves`)."""
    return _specimen(settings_json).solitary_waves(strikes)


@cache
def _specimen(settings_json: str) -> Specimen:
    from simulator.specimen import build_specimen

    settings = Settings.model_validate_json(settings_json)
    return build_specimen(
        settings.twin,
        transducers=transducers_of(settings),
        probed_thickness_m={
            name: settings.positions[name].plate.thickness_m for name in settings.names_of(PULSE_ECHO)
        },
    )


def _prepare(settings_json: str, told: Connection | None) -> None:
    """Build the specimen before the first strike."""
    leave_with_parent()
    if told is not None:
        from simulator.numerics.machine_code import compilation_told

        telling = ExitStack()
        telling.enter_context(compilation_told(told.send))
        atexit.register(telling.close)  # kept as long as the process
    _specimen(settings_json)
