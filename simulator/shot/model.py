"""Shot: chain and plate integrated together from the striker's first touch.

`ShotModel` is prepared once for a transducer, a plate and an outline of the patch; each shot may then
have its own depth, drop height and tilt. Shots of one model can be computed in several threads, and many
at once side by side (`ShotModel.shots`), with the same digits.

Specimens other than the finite plate: `rigid_wall` does not move; `infinite_kirchhoff` moves with
``(F - F_static) / (8 sqrt(D rho h))``, the static load being carried where it is. Neither has a patch.
At a through hole nothing touches the last sphere: a retainer carries the weight of the chain and is
so soft that its force stays the weight, so the incident wave runs off the free end.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from hardware_drivers.bounds import check_value_bounds
from simulator.chain.spheres import Chain, Contacts, build_chain, change_strike, impact_speed_m_per_s
from simulator.errors import IntegrationError, SpecimenError
from simulator.materials import thin_plate_impedance_n_s_per_m
from simulator.numerics.arrays import FloatArray
from simulator.numerics.one_thread import use_one_blas_thread
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.cache import DEFAULT_CACHE_FOLDER
from simulator.plate.models import ModalPlate, prepare_modal_plate
from simulator.plate.reduced import PlateModes
from simulator.shot.modal_weights import modal_weights
from simulator.shot.registers import Propagator
from simulator.shot.side_by_side import UNMOVED, integrate_chains
from simulator.shot.time_step import choose_record_duration_s, choose_step_s, stiffest_contact_n_per_m

ENERGY_TOLERANCE = 1e-4
"""Largest defect of the energy balance, relative to the impact energy."""

STEP_HALVINGS = 4
"""A shot that misses `ENERGY_TOLERANCE` is repeated with half the step, at most so often; on a plate with
each halved step twice, see `WIDE_CUT_PHASE_RAD`."""

CUT_PHASE_RAD = 1.0
"""Modes of the plate that turn faster than this in a step stay as residual compliance."""

CONTACT_PHASE_SQUARED = 1.0
"""So do modes that would let contact spring and plate swing against each other faster than this: on a
very thin plate the explicit part of the integration could not follow."""

WIDE_CUT_PHASE_RAD = 10.0
"""Cut of the second attempt at a halved step, without that other limit: a strong dashpot keeps fast modes
stable, and their energy, which the residual compliance would lose, stays in the balance. It is as far as
`modal_weights` is exact."""

TURN_TO_END = 2.5
"""A record of automatic length lasts so many times as long as the incident wave takes to turn round."""

EXTENSIONS = 3
"""How often such a record is lengthened when a longer one shows a later turn."""

DEPTHS_KEPT = 64
"""Prepared depths a model remembers, the latest ones."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Impact:
    """Strike; a value of None is that of the model's parameters.

    Attributes
    ----------
    depth_fraction, drop_height_m, tilt_rad
        Depth of the patch, height the striker falls from, tilt of the sensor disk.
    through_hole
        There is nothing under the chain; the depth does not matter then.
    second_delay_s, second_drop_height_m
        A second impact: so long after the first touch, to the nearest step, the striker, taken off meanwhile,
        touches again as from this height (None: as at first). It meets the chain as it then moves. The
        record gets no longer by it, and `ShotForce.reflection_time_s` is that of the stronger wave.
    contacts
        How the strike finds the chain seated; None: as in the parameters.
    plate_modulus_factor
        Young's modulus of the plate over the nominal one, as its bending feels it; its contact has a factor
        of its own in `contacts`. An elastic bed under free edges goes with it, too.
    """

    depth_fraction: float | None = None
    drop_height_m: float | None = None
    tilt_rad: float | None = None
    through_hole: bool = False
    second_delay_s: float | None = None
    second_drop_height_m: float | None = None
    contacts: Contacts | None = None
    plate_modulus_factor: float = 1.0

    def __post_init__(self) -> None:
        """Raise ValueError for a delay or factor that is not positive and finite, or a lone second height."""
        delay_s = self.second_delay_s
        if delay_s is not None and not (math.isfinite(delay_s) and delay_s > 0.0):
            raise ValueError(f"second_delay_s is {delay_s}; it must be positive and finite, or None")
        if not (math.isfinite(self.plate_modulus_factor) and self.plate_modulus_factor > 0.0):
            raise ValueError(
                f"plate_modulus_factor is {self.plate_modulus_factor}; it must be positive and finite"
            )
        if delay_s is None and self.second_drop_height_m is not None:
            raise ValueError("second_drop_height_m is given without second_delay_s; give both")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShotForce:
    """Noise-free force at the sensor.

    Attributes
    ----------
    time_s
        float64, shape (n,): uniform, 0 at the striker's first touch.
    force_n
        float64, shape (n,): mean of the two contact forces at the sensor, static preload included.
    preload_n
        That mean before the strike.
    energy_residual
        Largest defect of the energy balance of chain and plate during the shot, relative to the
        striker's impact energy.
    step_s
        Step of the integration; `time_s` may be coarser.
    reflection_time_s
        When the force between chain and specimen was largest: no reflected wave reaches the sensor
        before. None at a hole.
    contact_force_n
        float64, shape (n_bodies, n), where asked for: force of the contact below each body, the striker
        first, static force included. A sensor in place of body i > 0 would see the mean of rows i - 1 and i.
    """

    time_s: FloatArray
    force_n: FloatArray
    preload_n: float
    energy_residual: float
    step_s: float
    reflection_time_s: float | None = None
    contact_force_n: FloatArray | None = None


class ShotModel:
    """Chain on a specimen, ready to be struck.

    Parameters
    ----------
    chain, plate, corrosion
        The transducer, the specimen and its patch; `corrosion.depth_fraction` is the default depth.
    duration_s
        Length of the record from first touch. None: it holds the reflected wave, 1.4 ms for the paper's
        chain, longer for slow chains and for soft specimens, where it comes late (`TURN_TO_END`).
    cache_folder
        Where reductions of plates are kept; None keeps none.
    step_s
        Step of the integration and of the record. None resolves the chain, by 0.5 us for the paper's.
    prepared_plate
        What `prepare_modal_plate` gives for `plate` and `corrosion`, if another chain has it already.
    energy_tolerance
        Largest defect of the energy balance, relative to the impact energy.

    Raises
    ------
    SpecimenError
        The patch does not fit the plate, or the specimen has no patch at all.
    """

    def __init__(
        self,
        chain: ChainParameters,
        plate: PlateParameters,
        corrosion: CorrosionParameters,
        *,
        duration_s: float | None = None,
        cache_folder: Path | None = DEFAULT_CACHE_FOLDER,
        step_s: float | None = None,
        prepared_plate: ModalPlate | None = None,
        energy_tolerance: float = ENERGY_TOLERANCE,
    ) -> None:
        """Build the chain and prepare the plate, whose reduction is read from the cache or computed."""
        self._chain = chain
        self._plate = plate
        self._corrosion = corrosion
        self._nominal = nominal = build_chain(chain, plate)
        self._chosen_step = step_s is not None
        self._energy_tolerance = energy_tolerance
        self._cache_folder = cache_folder
        for name, value in (("duration_s", duration_s), ("step_s", step_s)):
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise SpecimenError(f"{name} is {value}; it must be positive and finite")
        self._step_s = choose_step_s(nominal) if step_s is None else step_s
        self._contact_stiffness_n_per_m = stiffest_contact_n_per_m(nominal)
        self._chosen_duration_s = duration_s
        self._shortest_record_s = choose_record_duration_s(nominal) if duration_s is None else duration_s
        self._modal_plate = prepared_plate or prepare_modal_plate(plate, corrosion, cache_folder)
        if self._modal_plate is None and corrosion.depth_fraction > 0.0:
            raise SpecimenError(_no_patch_message(plate.model, corrosion.depth_fraction))
        self._prepared: OrderedDict[tuple[float, float, bool, float], Propagator] = OrderedDict()
        # The plate warms and cools with every set, also where its depth stays.
        self._modes = lru_cache(maxsize=DEPTHS_KEPT)(partial(_compute_modes, self._modal_plate))
        self._checked_depths = {corrosion.depth_fraction}
        self._lock = threading.Lock()

    def with_chain(self, chain: ChainParameters) -> ShotModel:
        """Return a model of another chain on the same plate, whose slow reduction is shared.

        Step and prepared depths are shared, too, unless its own step would be below 0.4 of this model's.
        """
        nominal = build_chain(chain, self._plate)
        if choose_step_s(nominal) < 0.4 * self._step_s and not self._chosen_step:
            return ShotModel(
                chain,
                self._plate,
                self._corrosion,
                duration_s=self._chosen_duration_s,
                cache_folder=self._cache_folder,
                prepared_plate=self._modal_plate,
                energy_tolerance=self._energy_tolerance,
            )
        other = copy(self)
        other._chain = chain
        other._nominal = nominal
        if self._chosen_duration_s is None:
            other._shortest_record_s = choose_record_duration_s(nominal)
        return other

    def with_liquid(self, depth_factor: float) -> ShotModel | None:
        """Return a model with `depth_factor` times the liquid's depth; None for a dry plate."""
        liquid = self._plate.liquid
        if liquid is None:
            return None
        return ShotModel(
            self._chain,
            replace(self._plate, liquid=replace(liquid, depth_m=depth_factor * liquid.depth_m)),
            self._corrosion,
            duration_s=self._chosen_duration_s,
            cache_folder=self._cache_folder,
            step_s=self._step_s if self._chosen_step else None,
            energy_tolerance=self._energy_tolerance,
        )

    def shot(
        self,
        *,
        depth_fraction: float | None = None,
        drop_height_m: float | None = None,
        tilt_rad: float | None = None,
        through_hole: bool = False,
        contact_forces: bool = False,
    ) -> ShotForce:
        """Simulate the force at the sensor for one strike.

        Parameters
        ----------
        depth_fraction, drop_height_m, tilt_rad
            Replace those of the parameters for this shot.
        through_hole
            Strike above a through hole, which reflects nothing.
        contact_forces
            Keep the force at every contact of the chain, too.

        Raises
        ------
        ValueError
            A replacement breaks the bounds of its parameter, or a plate without patch gets a depth.
        IntegrationError
            The energy balance fails even with the finest step.
        """
        impact = Impact(
            depth_fraction=depth_fraction,
            drop_height_m=drop_height_m,
            tilt_rad=tilt_rad,
            through_hole=through_hole,
        )
        return self.shots([impact], contact_forces=contact_forces)[0]

    def shots(self, impacts: Iterable[Impact], *, contact_forces: bool = False) -> list[ShotForce]:
        """Simulate strikes in order, side by side per depth, bit-identical to each alone; raise as `shot`."""
        by_wall: dict[tuple[float, float, bool], list[tuple[int, Chain]]] = {}
        count = 0
        for count, impact in enumerate(impacts, start=1):
            depth = 0.0 if impact.through_hole else self._find_wall_depth(impact)
            wall = depth, impact.plate_modulus_factor, impact.through_hole
            by_wall.setdefault(wall, []).append((count - 1, self._build_struck_chain(impact)))
        forces: dict[int, ShotForce] = {}
        for (depth, modulus, is_hole), struck in by_wall.items():
            chains = [chain for _, chain in struck]
            found = (
                self._integrate_over_hole(chains, contact_forces)
                if is_hole
                else self._integrate_over_wall(chains, depth, modulus, contact_forces)
            )
            forces.update(zip((order for order, _ in struck), found, strict=True))
        return [forces[order] for order in range(count)]

    def _find_wall_depth(self, impact: Impact) -> float:
        """Return an impact's depth fraction; ValueError out of bounds, SpecimenError without a patch."""
        if impact.depth_fraction is None:
            return self._corrosion.depth_fraction
        depth = float(impact.depth_fraction)
        if depth not in self._checked_depths:
            replace(self._corrosion, depth_fraction=depth)  # checks the bounds
            self._checked_depths = {self._corrosion.depth_fraction, depth}  # most shots repeat the last one
        if self._modal_plate is None and depth > 0.0:
            raise SpecimenError(_no_patch_message(self._plate.model, depth))
        return depth

    def _build_struck_chain(self, impact: Impact) -> Chain:
        """Return the chain with an impact's height, tilt, contacts and second strike, or raise ValueError."""
        chain, height_m, tilt_rad = self._chain, impact.drop_height_m, impact.tilt_rad
        struck = self._nominal
        if height_m is not None or tilt_rad is not None or impact.contacts is not None:
            height_m = chain.drop_height_m if height_m is None else float(height_m)
            tilt_rad = chain.tilt_rad if tilt_rad is None else float(tilt_rad)
            check_value_bounds(ChainParameters, {"drop_height_m": height_m, "tilt_rad": tilt_rad})
            struck = change_strike(struck, chain.damping_n_s_per_m, height_m, tilt_rad, impact.contacts)
        if impact.second_delay_s is None:
            return struck
        second_speed = struck.impact_speed_m_per_s
        if impact.second_drop_height_m is not None:
            check_value_bounds(ChainParameters, {"drop_height_m": float(impact.second_drop_height_m)})
            second_speed = impact_speed_m_per_s(float(impact.second_drop_height_m))
        return replace(struck, second_delay_s=impact.second_delay_s, second_speed_m_per_s=second_speed)

    def _integrate_over_wall(
        self, chains: list[Chain], depth: float, modulus: float, contact_forces: bool
    ) -> list[ShotForce]:
        """Simulate chains over a wall of one depth and modulus; repeat up to thrice with longer records."""

        def prepare(step: float, wide: bool) -> Propagator:
            return self._prepare_propagator(depth, step, wide, modulus)

        forces = self._find_forces(chains, prepare, self._shortest_record_s, contact_forces=contact_forces)
        if self._chosen_duration_s is None:
            for k, chain in enumerate(chains):
                for _ in range(EXTENSIONS):
                    needed = TURN_TO_END * (forces[k].reflection_time_s or 0.0)
                    if forces[k].time_s[-1] >= needed:
                        break
                    forces[k] = self._find_forces([chain], prepare, needed, contact_forces=contact_forces)[0]
        return forces

    def _integrate_over_hole(self, chains: list[Chain], contact_forces: bool) -> list[ShotForce]:
        """Simulate chains above a through hole; the reflection times are None."""
        free_ends = [
            replace(
                chain,
                stiffness_n_per_m15=_clear_last(chain.stiffness_n_per_m15),
                damping_n_s_per_m=_clear_last(chain.damping_n_s_per_m),
                static_force_n=_clear_last(chain.static_force_n),
                static_overlap_m=_clear_last(chain.static_overlap_m),
            )
            for chain in chains
        ]
        forces = self._find_forces(
            free_ends,
            lambda step, wide: UNMOVED,
            self._shortest_record_s,
            retainer_force_n=float(self._nominal.static_force_n[-1]),
            contact_forces=contact_forces,
        )
        return [replace(force, reflection_time_s=None) for force in forces]

    def _find_forces(
        self,
        chains: list[Chain],
        specimen: Callable[[float, bool], Propagator],
        duration_s: float,
        *,
        retainer_force_n: float = 0.0,
        contact_forces: bool = False,
    ) -> list[ShotForce]:
        """Integrate with smaller steps and more modes until energy balances; else raise IntegrationError."""
        samples = round(duration_s / self._step_s) + 1
        time_s = self._step_s * np.arange(samples, dtype=np.float64)
        forces: dict[int, ShotForce] = {}
        pending = list(range(len(chains)))
        for halving, wide in _list_attempts(modal=self._modal_plate is not None):
            every = 2**halving
            step = self._step_s / every
            records = integrate_chains(
                [chains[k] for k in pending],
                specimen(step, wide),
                step,
                (samples - 1) * every + 1,
                retainer_force_n=retainer_force_n,
                contact_forces=contact_forces,
            )
            open_balances = {}
            for k, record in zip(pending, records, strict=True):
                defect = record.defect_j / chains[k].impact_energy_j
                if not defect <= self._energy_tolerance:
                    open_balances[k] = defect
                    continue
                observed = record.contact_force_n
                forces[k] = ShotForce(
                    time_s=time_s,
                    force_n=np.ascontiguousarray(record.force_n[::every]),
                    preload_n=chains[k].preload_n,
                    energy_residual=defect,
                    step_s=step,
                    reflection_time_s=record.reflection_step * step,
                    contact_force_n=None if observed is None else np.ascontiguousarray(observed[:, ::every]),
                )
            pending = list(open_balances)
            if not pending:
                return [forces[k] for k in range(len(chains))]
        raise IntegrationError(
            f"the energy balance is off by {open_balances[pending[0]]:.3g} of the impact energy with a step "
            f"of {step:.3g} s; at most {self._energy_tolerance} is allowed; look for an extreme mass, "
            "stiffness or damping"
        )

    def _prepare_propagator(self, depth: float, step: float, wide: bool, modulus: float) -> Propagator:
        """Return the modes' weights of a thinned wall for a time step; the latest 64 are kept in memory."""
        if self._modal_plate is None:
            still = _make_specimen_without_modes(self._plate)
            return still._replace(mobility_m_per_n_s=still.mobility_m_per_n_s / math.sqrt(modulus))
        key = depth, step, wide, modulus
        with self._lock:
            if key in self._prepared:
                self._prepared.move_to_end(key)
                return self._prepared[key]
        phase, yielding = CUT_PHASE_RAD, CONTACT_PHASE_SQUARED / (self._contact_stiffness_n_per_m * step**2)
        if wide:
            phase, yielding = WIDE_CUT_PHASE_RAD, math.inf
        every_mode = self._modes(depth)
        if modulus != 1.0:
            every_mode = every_mode.with_scaled_modulus(modulus)
        modes = every_mode.cut_off_fast_modes(phase / step, yielding)
        propagator = Propagator(
            bank=modal_weights(modes.omega_rad_per_s, modes.participation, step),
            residual_compliance_m_per_n=modes.residual_compliance_m_per_n,
        )
        with self._lock:
            self._prepared[key] = propagator
            if len(self._prepared) > DEPTHS_KEPT:
                self._prepared.popitem(last=False)
        return propagator


def _compute_modes(plate: ModalPlate | None, depth: float) -> PlateModes:
    """Compute the modes of a plate at a depth fraction with BLAS limited to one thread."""
    assert plate is not None, "an analytic anchor has no modes"
    with use_one_blas_thread():
        return plate.modes(depth)


def _make_specimen_without_modes(plate: PlateParameters) -> Propagator:
    """Return the propagator of a plate without modes: a rigid wall, or an infinite thin plate's mobility."""
    if plate.model == "rigid_wall":
        return UNMOVED
    impedance = thin_plate_impedance_n_s_per_m(
        plate.warm_youngs_modulus_pa, plate.poisson_ratio, plate.density_kg_per_m3, plate.thickness_m
    )
    return UNMOVED._replace(mobility_m_per_n_s=1.0 / impedance)


def _clear_last(values: FloatArray) -> FloatArray:
    """Return a copy of an array with zero as its last value."""
    changed = values.copy()
    changed[-1] = 0.0
    return changed


def _no_patch_message(model: str, depth: float) -> str:
    """Return the error message for a depth in a plate model without a patch."""
    return (
        f"depth_fraction is {depth}, but a plate of model {model} has no patch; "
        f"use depth 0 or plate.model = 'mindlin' or 'solid'"
    )


def _list_attempts(*, modal: bool) -> Iterator[tuple[int, bool]]:
    """Yield the attempts of an integration: halvings of the step, and whether to keep more modes.

    More modes are those up to `WIDE_CUT_PHASE_RAD`.
    """
    for halving in range(STEP_HALVINGS + 1):
        yield halving, False
        if halving and modal:
            yield halving, True
