"""A shot: chain and plate integrated together from the striker's first touch.

`ShotModel` is prepared once for a transducer, a plate and an outline of the patch; each shot may then
have its own depth, drop height and tilt. Shots of one model can be computed in several threads.

Specimens other than the finite plate: `rigid_wall` does not move; `infinite_kirchhoff` moves with
``(F - F_static) / (8 sqrt(D rho h))``, the static load being carried where it is. Neither has a patch.
At a through hole nothing touches the last sphere: a retainer carries the weight of the chain and is
so soft that its force stays the weight, so the incident wave runs off the free end.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.chain_parameters import ChainParameters
from simulator.coupled_kernel import integrate, modal_weights
from simulator.errors import IntegrationError, SpecimenError
from simulator.granular_chain import Chain, build_chain
from simulator.hertz_contact import indentation_m
from simulator.materials import thin_plate_impedance_n_s_per_m
from simulator.one_thread import one_blas_thread
from simulator.plate_models import ModalPlate, modal_plate
from simulator.plate_parameters import CorrosionParameters, PlateParameters
from simulator.reduction_cache import DEFAULT_CACHE_FOLDER

FloatArray = NDArray[np.float64]

ENERGY_TOLERANCE = 1e-4
"""Largest defect of the energy balance, relative to the impact energy."""

STEP_HALVINGS = 4
"""A shot that misses `ENERGY_TOLERANCE` is repeated with half the step, at most so often; on a plate with
each halved step twice, see `WIDE_CUT_PHASE_RAD`."""

PHASE_PER_STEP_RAD = 0.05
"""The chain's highest frequency turns by no more than this in a step; see docs for the convergence."""

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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Propagator:
    """What `coupled_kernel.integrate` needs to know about the specimen, for one depth and step."""

    weights: FloatArray
    own_weights: FloatArray
    residual_compliance_m_per_n: float = 0.0
    mobility_m_per_n_s: float = 0.0


class ShotModel:
    """Chain on a specimen, ready to be struck.

    Parameters
    ----------
    chain, plate, corrosion
        The transducer, the specimen and its patch; `corrosion.depth_fraction` is the depth of a shot
        that names none.
    duration_s
        Length of the record from first touch. None chooses one that holds the reflected wave: 1.4 ms
        for the paper's chain, longer for slow chains and for a specimen so soft that the wave turns
        round late (`TURN_TO_END`).
    cache_folder
        Where reductions of plates are kept; None keeps none.
    step_s
        Step of the integration and spacing of the record, for studies of convergence. None chooses
        one that resolves the chain, 0.5 us for the paper's.
    prepared_plate
        What `modal_plate` gives for `plate` and `corrosion`, where the caller has it for another chain.

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
    ) -> None:
        self._chain = chain
        self._plate = plate
        self._corrosion = corrosion
        nominal = build_chain(chain, plate)
        for name, value in (("duration_s", duration_s), ("step_s", step_s)):
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise SpecimenError(f"{name} is {value}; it must be positive and finite")
        self._step_s = resolving_step_s(nominal) if step_s is None else step_s
        self._contact_stiffness_n_per_m = stiffest_contact_n_per_m(nominal)
        self._chosen_duration_s = duration_s
        self._shortest_record_s = record_duration_s(nominal) if duration_s is None else duration_s
        self._modal_plate = prepared_plate or modal_plate(plate, corrosion, cache_folder)
        if self._modal_plate is None and corrosion.depth_fraction > 0.0:
            raise SpecimenError(_no_patch(plate.model, corrosion.depth_fraction))
        self._prepared: OrderedDict[tuple[float, float, bool], _Propagator] = OrderedDict()
        self._lock = threading.Lock()

    def shot(
        self,
        *,
        depth_fraction: float | None = None,
        drop_height_m: float | None = None,
        tilt_rad: float | None = None,
        contact_forces: bool = False,
    ) -> ShotForce:
        """Force at the sensor for one strike.

        Parameters
        ----------
        depth_fraction, drop_height_m, tilt_rad
            Replace those of the parameters for this shot.
        contact_forces
            Keep the force at every contact of the chain, too.

        Raises
        ------
        ValueError
            A replacement breaks the bounds of its parameter.
        IntegrationError
            The energy balance fails even with the finest step.
        """
        depth = self._corrosion.depth_fraction if depth_fraction is None else float(depth_fraction)
        if depth != self._corrosion.depth_fraction:
            replace(self._corrosion, depth_fraction=depth)  # checks the bounds
        if self._modal_plate is None and depth > 0.0:
            raise SpecimenError(_no_patch(self._plate.model, depth))
        chain = self._struck(drop_height_m, tilt_rad)

        def specimen(step: float, wide: bool) -> _Propagator:
            return self._propagator(depth, step, wide)

        force = self._converged(chain, specimen, self._shortest_record_s, contact_forces=contact_forces)
        if self._chosen_duration_s is None:
            for _ in range(EXTENSIONS):
                needed = TURN_TO_END * (force.reflection_time_s or 0.0)
                if force.time_s[-1] >= needed:
                    break
                force = self._converged(chain, specimen, needed, contact_forces=contact_forces)
        return force

    def shot_at_hole(
        self,
        *,
        drop_height_m: float | None = None,
        tilt_rad: float | None = None,
        contact_forces: bool = False,
    ) -> ShotForce:
        """Force at the sensor above a through hole: an incident wave and no reflected one."""
        chain = self._struck(drop_height_m, tilt_rad)
        weight = float(chain.static_force_n[-1])
        free_end = replace(
            chain,
            stiffness_n_per_m15=_without_last(chain.stiffness_n_per_m15),
            damping_n_s_per_m=_without_last(chain.damping_n_s_per_m),
            static_force_n=_without_last(chain.static_force_n),
            static_overlap_m=_without_last(chain.static_overlap_m),
        )
        force = self._converged(
            free_end,
            lambda step, wide: _UNMOVED,
            self._shortest_record_s,
            retainer_force_n=weight,
            contact_forces=contact_forces,
        )
        return replace(force, reflection_time_s=None)

    def _struck(self, drop_height_m: float | None, tilt_rad: float | None) -> Chain:
        chain = self._chain
        if drop_height_m is not None:
            chain = replace(chain, drop_height_m=float(drop_height_m))
        if tilt_rad is not None:
            chain = replace(chain, tilt_rad=float(tilt_rad))
        return build_chain(chain, self._plate)

    def _converged(
        self,
        chain: Chain,
        specimen: Callable[[float, bool], _Propagator],
        duration_s: float,
        *,
        retainer_force_n: float = 0.0,
        contact_forces: bool = False,
    ) -> ShotForce:
        """Integrate with ever smaller steps, then also more modes, until the energy balance closes."""
        samples = round(duration_s / self._step_s) + 1
        defect = math.inf
        for halving, wide in self._attempts():
            every = 2**halving
            step = self._step_s / every
            force = np.empty((samples - 1) * every + 1)
            contacts = np.empty((len(chain.mass_kg), force.size) if contact_forces else (0, 0))
            defect_j, reflection = _integrate(
                chain, specimen(step, wide), step, retainer_force_n, force, contacts
            )
            defect = defect_j / chain.impact_energy_j
            if defect <= ENERGY_TOLERANCE:
                return ShotForce(
                    time_s=self._step_s * np.arange(samples, dtype=np.float64),
                    force_n=np.ascontiguousarray(force[::every]),
                    preload_n=chain.preload_n,
                    energy_residual=defect,
                    step_s=step,
                    reflection_time_s=reflection * step,
                    contact_force_n=np.ascontiguousarray(contacts[:, ::every]) if contact_forces else None,
                )
        raise IntegrationError(
            f"the energy balance is off by {defect:.3g} of the impact energy with a step of {step:.3g} s; "
            f"at most {ENERGY_TOLERANCE} is allowed; look for an extreme mass, stiffness or damping"
        )

    def _attempts(self) -> Iterator[tuple[int, bool]]:
        """Halvings of the step, and whether to keep modes up to `WIDE_CUT_PHASE_RAD`."""
        for halving in range(STEP_HALVINGS + 1):
            yield halving, False
            if halving and self._modal_plate is not None:
                yield halving, True

    def _propagator(self, depth: float, step: float, wide: bool) -> _Propagator:
        if self._modal_plate is None:
            return _specimen_without_modes(self._plate)
        key = depth, step, wide
        with self._lock:
            if key in self._prepared:
                self._prepared.move_to_end(key)
                return self._prepared[key]
        phase, yielding = CUT_PHASE_RAD, CONTACT_PHASE_SQUARED / (self._contact_stiffness_n_per_m * step**2)
        if wide:
            phase, yielding = WIDE_CUT_PHASE_RAD, math.inf
        with one_blas_thread():
            every_mode = self._modal_plate.modes(depth)
        modes = every_mode.cut_above(phase / step, yielding)
        weights, own_weights = modal_weights(modes.omega_rad_per_s, modes.participation, step)
        made = _Propagator(
            weights=weights,
            own_weights=own_weights,
            residual_compliance_m_per_n=modes.residual_compliance_m_per_n,
        )
        with self._lock:
            self._prepared[key] = made
            if len(self._prepared) > DEPTHS_KEPT:
                self._prepared.popitem(last=False)
        return made


_UNMOVED = _Propagator(weights=np.empty((10, 0)), own_weights=np.empty((6, 0)))


def _specimen_without_modes(plate: PlateParameters) -> _Propagator:
    if plate.model == "rigid_wall":
        return _UNMOVED
    impedance = thin_plate_impedance_n_s_per_m(
        plate.warm_youngs_modulus_pa, plate.poisson_ratio, plate.density_kg_per_m3, plate.thickness_m
    )
    return replace(_UNMOVED, mobility_m_per_n_s=1.0 / impedance)


def _integrate(
    chain: Chain,
    specimen: _Propagator,
    step: float,
    retainer_force_n: float,
    force: FloatArray,
    contacts: FloatArray,
) -> tuple[float, int]:
    defect_j, reflection = integrate(
        chain.mass_kg,
        chain.stiffness_n_per_m15,
        chain.dashpot_impulse_n_s_per_m,
        chain.static_force_n,
        chain.static_overlap_m,
        chain.gravity_m_per_s2,
        chain.impact_speed_m_per_s,
        chain.sensor,
        retainer_force_n,
        step,
        specimen.weights,
        specimen.own_weights,
        specimen.residual_compliance_m_per_n,
        specimen.mobility_m_per_n_s,
        chain.damping_exponent,
        chain.precompression_n,
        force,
        contacts,
    )
    return float(defect_j), int(reflection)


def _without_last(values: FloatArray) -> FloatArray:
    changed = values.copy()
    changed[-1] = 0.0
    return changed


def _no_patch(model: str, depth: float) -> str:
    return (
        f"depth_fraction is {depth}, but a plate of model {model} has no patch; "
        f"use depth 0 or plate.model = 'mindlin'"
    )


def resolving_step_s(chain: Chain) -> float:
    """Step of the integration for `chain`: the largest of 1, 2, 5 x 10^k s that resolves it.

    The dashpots between the spheres must relax slowly compared with a step, too.
    """
    m = float(chain.mass_kg.min())
    omega = 2.0 * math.sqrt(stiffest_contact_n_per_m(chain) / m)
    rate = float(chain.damping_n_s_per_m[:-1].max()) / m
    if chain.damping_exponent:
        rate *= (peak_overlap_m(chain) / chain.damping_reference_overlap_m) ** chain.damping_exponent
    longest = PHASE_PER_STEP_RAD / max(omega, rate)
    decade: float = 10.0 ** math.floor(math.log10(longest))
    # Rounding of the logarithm must not lose a step that is a power of ten.
    steps = [factor * decade for factor in (1.0, 2.0, 5.0)]
    return max(step for step in steps if step <= longest * (1.0 + 1e-9))


def stiffest_contact_n_per_m(chain: Chain) -> float:
    """Estimate dF/dd of a contact at its peak."""
    return 1.5 * float(chain.stiffness_n_per_m15.max()) * math.sqrt(peak_overlap_m(chain))


def peak_overlap_m(chain: Chain) -> float:
    """Estimate the largest overlap, from two spheres that collide at the striker's speed.

    A precompressed contact is pressed that much further.
    """
    a = float(chain.stiffness_n_per_m15.max())
    overlap: float = (0.625 * float(chain.mass_kg.max()) * chain.impact_speed_m_per_s**2 / a) ** 0.4
    return overlap + indentation_m(chain.precompression_n, float(chain.stiffness_n_per_m15.min()))


def record_duration_s(chain: Chain) -> float:
    """Record that holds the reflected wave: 1.4 ms, more for slower chains.

    A solitary wave needs about ``1.2 (m^2 / (A^2 v))^(1/5)`` from one contact to the next, down the
    chain and back to the sensor; 2.5 times that leaves room for a soft specimen.
    """
    m = float(chain.mass_kg.max())
    a = float(chain.stiffness_n_per_m15.min())
    per_contact: float = 1.2 * (m**2 / (a**2 * chain.impact_speed_m_per_s)) ** 0.2
    contacts = 2 * len(chain.mass_kg) - chain.sensor
    return max(1.4e-3, 2.5 * per_contact * contacts)
