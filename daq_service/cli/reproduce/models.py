"""Compute the models' results: functions for an executor, possibly in another process.

The specimen is that of the paper unless a study changes one parameter; the defaults are the paper's,
independent of a configuration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from simulator.chain.spheres import build_chain
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.plate import build_plate
from simulator.plate.solid.plate import build_solid_plate
from simulator.shot.model import ShotModel
from simulator.shot.pulse_summary import summarise_pulses
from simulator.zener.model import (
    ZenerReflection,
    approximate_contact_time,
    approximate_restitution,
    compute_reflection,
    solve_impact,
)

FloatArray = NDArray[np.float64]

ISW_STEPS = (0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15, 1.2)
"""ISW amplitude over the nominal one (figure 12)."""

LONGEST_SEARCH = 60

Point = tuple[float, float, float, float]
"""What is varied, time of flight in us, amplitude ratio, the same without the static force."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pulse:
    """Noise-free shot: peaks of the sensor's force, static preload included but in the dynamic ratio."""

    depth_fraction: float
    isw_peak_n: float
    tof_us: float
    amplitude_ratio: float
    dynamic_amplitude_ratio: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceTrace:
    """Force at one body of the chain over time, arrays of shape (n,)."""

    body: int
    time_s: FloatArray
    force_n: FloatArray


def compute_pulses_over_depth(
    chain: ChainParameters, plate: PlateParameters, patch: CorrosionParameters, depths: tuple[float, ...]
) -> list[Pulse]:
    """Simulate one shot for each relative depth of the patch, in order.

    Raises SimulatorError if a shot cannot be computed.
    """
    model = ShotModel(chain, plate, patch)
    return [_compute_pulse(model, depth, chain.drop_height_m) for depth in depths]


def compute_pulses_over_isw(
    chain: ChainParameters, plate: PlateParameters, ratios: tuple[float, ...]
) -> list[Point]:
    """Simulate shots with these ratios of the nominal ISW peak force, each found by its drop height.

    Returns a point for each. Raises SimulatorError if a shot cannot be
    computed, ValueError or RuntimeError if no drop height is found within `LONGEST_SEARCH` steps.
    """
    model = ShotModel(chain, plate, CorrosionParameters())
    nominal_n = _compute_pulse(model, 0.0, chain.drop_height_m).isw_peak_n
    found = []
    for ratio in ratios:
        # F ~ h^(3/5) in a long chain: the root lies well inside half and twice that.
        guess_m = chain.drop_height_m * ratio ** (5.0 / 3.0)
        height_m = brentq(
            lambda h, ratio=ratio: _compute_pulse(model, 0.0, h).isw_peak_n / nominal_n - ratio,
            0.5 * guess_m,
            2.0 * guess_m,
            xtol=1e-9,
            maxiter=LONGEST_SEARCH,
        )
        pulse = _compute_pulse(model, 0.0, float(height_m))
        found.append((ratio, pulse.tof_us, pulse.amplitude_ratio, pulse.dynamic_amplitude_ratio))
    return found


def compute_zener_over_isw(ratios: tuple[float, ...], closed_form: bool) -> list[Point]:
    """Compute Zener's model over the ISW's amplitude, ``F ~ v^(6/5) ~ h^(3/5)`` as in Table 2.

    ``ratios`` are those of the nominal ISW amplitude. Returns a point for each.
    Raises SimulatorError if the model cannot compute one.

    Parameters
    ----------
    closed_form
        By eqs 10 and 12 instead of a numerical solution of eq. 8.
    """
    chain, found = ChainParameters(), list[Point]()
    for ratio in ratios:
        higher = replace(chain, drop_height_m=chain.drop_height_m * ratio ** (5.0 / 3.0))
        reflection = compute_reflection(higher, PlateParameters(), closed_form=closed_form)
        ar = reflection.amplitude_ratio  # of an impact without static force
        found.append((ratio, 1e6 * reflection.tof_s, ar, ar))
    return found


def compute_impact_over_inelasticity(inelasticities: tuple[float, ...]) -> dict[str, list[float]]:
    """Compute restitution and contact time by eq. 8 and by eqs 10 and 12, one value per lambda.

    Returns columns by name, dimensionless; eq. 10 is NaN above lambda = 1. Raises SimulatorError for a lambda
    outside the model's range.
    """
    columns: dict[str, list[float]] = {
        name: [] for name in ("inelasticity", "e_eq8", "e_eq10", "tau_c_eq8", "tau_c_eq12")
    }
    for inelasticity in inelasticities:
        exact = solve_impact(inelasticity)
        columns["inelasticity"].append(inelasticity)
        columns["e_eq8"].append(exact.restitution)
        columns["e_eq10"].append(approximate_restitution(inelasticity) if inelasticity <= 1.0 else math.nan)
        columns["tau_c_eq8"].append(exact.contact_time)
        columns["tau_c_eq12"].append(approximate_contact_time(inelasticity))
    return columns


def compute_forces_along_chain(plate: PlateParameters) -> list[ForceTrace]:
    """Simulate the force in N at every body between striker and last sphere, from the top.

    All bodies are equal spheres, sensor included: the same shot is simulated with each body in turn as
    sensor.
    """
    chain = ChainParameters(sensor="sphere")
    bodies = chain.spheres_above + 1 + chain.spheres_below
    found = []
    for body in range(1, bodies - 1):
        moved = replace(chain, spheres_above=body, spheres_below=bodies - 1 - body)
        force = ShotModel(moved, plate, CorrosionParameters()).shot()
        found.append(ForceTrace(body=body, time_s=force.time_s, force_n=force.force_n))
    return found


def compute_impact_speed(chain: ChainParameters, plate: PlateParameters) -> float:
    """Compute the speed of the striker at impact, m/s, after its free fall onto the chain."""
    return build_chain(chain, plate).impact_speed_m_per_s


def _compute_pulse(model: ShotModel, depth: float, drop_height_m: float) -> Pulse:
    """Simulate a shot and measure its peaks; ToF and ratio are NaN without a reflected wave.

    Raises SimulatorError, also if there is no incident wave.
    """
    summary = summarise_pulses(model.shot(depth_fraction=depth, drop_height_m=drop_height_m))
    reflected = (summary.tof_us, summary.amplitude_ratio, summary.dynamic_amplitude_ratio)
    tof_us, ratio, dynamic_ratio = (math.nan if value is None else value for value in reflected)
    return Pulse(
        depth_fraction=depth,
        isw_peak_n=summary.isw_peak_n,
        tof_us=tof_us,
        amplitude_ratio=ratio,
        dynamic_amplitude_ratio=dynamic_ratio,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeshLines:
    """Edges of the elements of a quarter of a plate from the contact outwards, in m.

    Attributes
    ----------
    z_m
        From the face under the chain; empty for a plate theory.
    nodes_m
        Nodes along x: the edges themselves where elements are linear.
    """

    x_m: FloatArray
    y_m: FloatArray
    z_m: FloatArray
    nodes_m: FloatArray
    patch_m: float
    depth_fraction: float
    unknowns: int
    contact_element_m: float


def build_mindlin_mesh(plate: PlateParameters) -> MeshLines:
    """Build the mesh lines of the Mindlin plate without corrosion.

    Raises SpecimenError if the patch does not fit the plate.
    """
    patch = CorrosionParameters()
    built = build_plate(plate, patch)
    return MeshLines(
        x_m=built.x_m,
        y_m=built.y_m,
        z_m=np.empty(0),
        nodes_m=built.x_m,
        patch_m=patch.size_m,
        depth_fraction=0.0,
        unknowns=int(built.free.size),
        contact_element_m=float(built.x_m[1] - built.x_m[0]),
    )


def build_solid_mesh(plate: PlateParameters, depth_fraction: float) -> MeshLines:
    """Build the mesh lines of the solid plate with the default patch at a relative depth.

    Raises SpecimenError if the model does not know such a plate, or the mesh grows too large.
    """
    patch = CorrosionParameters(depth_fraction=depth_fraction)
    built = build_solid_plate(plate, patch)
    x_m, y_m = built.x.breaks_m, built.y.breaks_m
    return MeshLines(
        x_m=x_m,
        y_m=y_m,
        z_m=built.z.breaks_m,
        nodes_m=built.x.nodes_m,
        patch_m=patch.size_m,
        depth_fraction=depth_fraction,
        unknowns=int(built.load.size),
        contact_element_m=float(x_m[1] - x_m[0]),
    )


def compute_zener_on_thickness(thickness_m: float) -> ZenerReflection:
    """Compute Zener's reflection on a plate of this thickness, m; a very thick one acts as a rigid wall.

    Raises SimulatorError if the plate is too thin for the model.
    """
    return compute_reflection(ChainParameters(), replace(PlateParameters(), thickness_m=thickness_m))
