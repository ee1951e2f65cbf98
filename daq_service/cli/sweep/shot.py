"""Compute one row of a sweep: the only module that a worker process needs.

`solimon simulate` computes its single shots here, too, so that a row of a sweep has the same digits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from simulator.chain.contact_pressure import peak_pressures_pa, yield_pressures_pa
from simulator.errors import SimulatorError, SpecimenError
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.cache import DEFAULT_CACHE_FOLDER
from simulator.plate.models import ModalPlate, prepare_modal_plate
from simulator.plate.reduced import PlateModes
from simulator.shot.model import ShotForce, ShotModel
from simulator.shot.pulse_summary import summarise_pulses
from simulator.zener.model import compute_reflection

Specimen = tuple[ChainParameters, PlateParameters, CorrosionParameters]

RESULTS: Mapping[str, tuple[str, ...]] = {
    "coupled": (
        "isw_peak_n",
        "isw_time_us",
        "psw_peak_n",
        "psw_time_us",
        "tof_us",
        "amplitude_ratio",
        "dynamic_amplitude_ratio",
        "plate_pressure_pa",
        "sphere_pressure_pa",
        "plate_yield_ratio",
        "sphere_yield_ratio",
        "preload_n",
        "energy_residual",
        "step_s",
    ),
    "zener": ("tof_us", "inelasticity", "restitution", "contact_time", "amplitude_ratio"),
}
"""Numbers of a row, by model."""

OK = "ok"
NO_REFLECTION = "no reflected wave"
INVALID = "invalid: "
"""Begins the status of parameters that cannot go together."""

PREPARED_KEPT = 8
"""Plates, and chains on them, that a process remembers; rows come sorted by them."""

DEPTHS_KEPT = 4096
"""Depths of a plate whose modes it remembers: a few kB each."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """Result of a row.

    Attributes
    ----------
    index
        Of the row in the plan.
    numbers
        In the order of `RESULTS`; NaN where there is none.
    status
        `OK`, `NO_REFLECTION`, or why there are no numbers.
    force_n
        float64, shape (n,): the sensor's force from first touch, where asked for.
    sample_interval_s
        Its spacing; NaN without.
    """

    index: int
    numbers: tuple[float, ...]
    status: str
    force_n: NDArray[np.float64] | None = None
    sample_interval_s: float = math.nan


def compute_rows(model: str, rows: Sequence[tuple[int, Specimen]], waveforms: bool = False) -> list[Outcome]:
    """Compute rows of a plan, in a process or thread of an executor; return the outcomes in order.

    A row that cannot be computed has a status instead of an error.

    Parameters
    ----------
    model
        A key of `RESULTS`.
    rows
        Index and parameters of each.
    waveforms
        Keep the force of each shot, for ``coupled`` only.
    """
    return [_compute_outcome(model, index, specimen, waveforms) for index, specimen in rows]


def _compute_outcome(model: str, index: int, specimen: Specimen, waveforms: bool) -> Outcome:
    """Compute one shot; NaN and the reason as status if it is invalid or the model fails.

    Without a reflected wave the status is `NO_REFLECTION`. ``waveforms`` keeps the sensor's force.
    """
    no_numbers = (math.nan,) * len(RESULTS[model])
    try:
        if model == "zener":
            found, force = compute_zener_impact(*specimen), None
        else:
            force = compute_shot(*specimen)
            found = summarise_coupled_shot(specimen, force)
    except SpecimenError as error:
        return Outcome(index=index, numbers=no_numbers, status=f"{INVALID}{error}")
    except (SimulatorError, np.linalg.LinAlgError) as error:
        return Outcome(index=index, numbers=no_numbers, status=str(error))
    stored_force = force if waveforms else None
    return Outcome(
        index=index,
        numbers=tuple(math.nan if (value := found[name]) is None else value for name in RESULTS[model]),
        status=NO_REFLECTION if found["tof_us"] is None else OK,
        force_n=None if stored_force is None else stored_force.force_n,
        sample_interval_s=math.nan if stored_force is None else float(stored_force.time_s[1]),
    )


def compute_shot(chain: ChainParameters, plate: PlateParameters, corrosion: CorrosionParameters) -> ShotForce:
    """Integrate chain and plate together and return the forces; prepared models are cached.

    Raises SimulatorError if parameters do not go together or the integration fails.
    """
    return _build_model(chain, plate, replace(corrosion, depth_fraction=0.0)).shot(
        depth_fraction=corrosion.depth_fraction, contact_forces=True
    )


@lru_cache(maxsize=PREPARED_KEPT)
def _build_model(chain: ChainParameters, plate: PlateParameters, outline: CorrosionParameters) -> ShotModel:
    """Build the shot model of a chain on an uncorroded plate; `PREPARED_KEPT` models are cached."""
    # One for each chain: step and length of a shot follow from its drop height and tilt, too.
    return ShotModel(chain, plate, outline, prepared_plate=_prepare_cached_plate(plate, outline))


class _CachedPlate:
    """Modal plate that caches the modes of each depth for all chains."""

    def __init__(self, modal: ModalPlate) -> None:
        """Wrap the plate's ``modes`` in a cache of `DEPTHS_KEPT` depths."""
        self.modes: Callable[[float], PlateModes] = lru_cache(maxsize=DEPTHS_KEPT)(modal.modes)


@lru_cache(maxsize=PREPARED_KEPT)
def _prepare_cached_plate(plate: PlateParameters, outline: CorrosionParameters) -> _CachedPlate | None:
    """Return a plate that caches its modes by depth, itself cached; None for a model without modes.

    Its reduction is kept in `DEFAULT_CACHE_FOLDER`. Raises SpecimenError if the patch does not fit the plate.
    """
    modal = prepare_modal_plate(plate, outline, DEFAULT_CACHE_FOLDER)
    return None if modal is None else _CachedPlate(modal)


def summarise_coupled_shot(specimen: Specimen, force: ShotForce) -> dict[str, float | None]:
    """Return peaks (N), times (us), pressures (Pa) and integration quality of a shot by key of `RESULTS`.

    A yield ratio is the pressure over that of first yield. Values of the reflected wave are None if there is
    none. ``force`` needs its contact forces. Raises NoSolitaryWaveError without an incident wave.
    """
    assert force.contact_force_n is not None, "the shot was simulated without its contact forces"
    pressures_pa = peak_pressures_pa(*specimen[:2], force.contact_force_n)
    yield_ratios = pressures_pa / yield_pressures_pa(*specimen[:2])
    return {
        **asdict(summarise_pulses(force)),
        "plate_pressure_pa": float(pressures_pa[-1]),
        "sphere_pressure_pa": float(pressures_pa[:-1].max()),
        "plate_yield_ratio": float(yield_ratios[-1]),
        "sphere_yield_ratio": float(yield_ratios[:-1].max()),
        "preload_n": force.preload_n,
        "energy_residual": force.energy_residual,
        "step_s": force.step_s,
    }


def compute_zener_impact(
    chain: ChainParameters, plate: PlateParameters, corrosion: CorrosionParameters
) -> dict[str, float | None]:
    """Compute Zener's impact of the last sphere: ToF (us) and dimensionless results by key of `RESULTS`.

    Raises SimulatorError if the model cannot compute it, ValueError for a depth out of bounds.
    """
    row = asdict(compute_reflection(chain, plate, depth_fraction=corrosion.depth_fraction))
    return {"tof_us": 1e6 * row.pop("tof_s"), **row}
