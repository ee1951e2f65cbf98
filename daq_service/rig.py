"""The only place that chooses between real, simulated and recorded instruments."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib.metadata import version

from daq_service.errors import UsageError
from daq_service.settings import Settings
from hardware_drivers.instruments import Clock, Rig


@contextmanager
def open_rig(settings: Settings, clock: Clock, epoch_utc_ns: int) -> Iterator[Rig]:
    """Instruments of the configured kind; safe again when the context ends.

    Raises
    ------
    UsageError
        The specimen cannot be simulated as configured.
    """
    from simulator.coupled_model import ShotModel
    from simulator.errors import SimulatorError
    from simulator.instruments import build_bench
    from simulator.specimen import Transducer

    places = settings.positions
    # One worker: the physics of the next shots runs while this one is stored and judged.
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="twin") as executor:
        try:
            transducers = {
                name: Transducer(
                    chain=places[name].chain,
                    model=ShotModel(places[name].chain, places[name].plate, places[name].corrosion),
                )
                for name in settings.names_of("solitary_wave")
            }
        except SimulatorError as error:
            raise UsageError(f"the twin cannot be built as configured: {error}") from error
        bench = build_bench(
            settings.twin,
            clock=clock,
            epoch_utc_ns=epoch_utc_ns,
            transducers=transducers,
            probed_thickness_m={
                name: places[name].plate.thickness_m for name in settings.names_of("pulse_echo")
            },
            shots_per_set=settings.schedule.shots_per_set,
            executor=executor,
        )
        rig = Rig(
            kind="simulated",
            clock=clock,
            striker=bench.striker,
            digitizer=bench.digitizer,
            pulse_echo=bench.pulse_echo,
            identity={"twin": version("solimon"), "seed": str(settings.twin.seed)},
        )
        with rig:
            yield rig
