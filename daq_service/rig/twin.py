"""The twin's physics in a process of its own, beside the recorder's line.

Threads would share the interpreter's lock: the extraction of features hands it over at every array, and
each handing over costs as much as what is computed. Here a worker process builds the same specimen from the
same settings and computes records by their key; the recorder strikes, reads and stores as ever. The worker
holds nothing that could be lost: where it dies, the recorder computes its records itself.

The simulator is imported where it is needed: the worker starts while the recorder imports its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
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


def twin_executor(settings: Settings) -> ProcessPoolExecutor:
    """One worker process that computes `records` of these settings; its owner shuts it down."""
    return one_worker(_prepare, settings.model_dump_json())


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


def _prepare(settings_json: str) -> None:
    """Build the specimen before the first strike."""
    leave_with_parent()
    _specimen(settings_json)
