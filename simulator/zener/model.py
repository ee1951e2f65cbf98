"""Zener's model of the reflected solitary wave: one sphere strikes a large thin plate (paper, eqs 8-13).

The last sphere hits the plate at the particle speed of the incident wave. Flexural waves carry part of
its energy away for good, so it rebounds more slowly: the restitution e gives the amplitude of the PSW,
the contact time its delay. No preload, dashpot, sensor disk, plate edge or outline of a patch: only the
thickness under the sphere counts.

Sources: Zener 1941, doi:10.1103/PhysRev.59.669 (the paper's reference 58); equations as the paper
numbers them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from scipy.integrate import solve_ivp

from simulator.chain.hertz_contact import sphere_on_flat_stiffness, sphere_on_sphere_stiffness
from simulator.chain.spheres import FREE_FALL_M_PER_S2
from simulator.errors import IntegrationError, SpecimenError
from simulator.materials import plane_modulus_pa
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters

PARTICLE_SPEED_FRACTION = 0.682
"""Peak speed of a sphere in the wave over the striker's (the paper's reference 80)."""

LARGEST_INELASTICITY = 200.0
"""Bound of the solution of eq. 8; the paper's plate has 0.26 pristine and 103 at a depth of 0.95."""

LARGEST_FOR_EQUATION_10 = 1.0
"""Eq. 10 is proposed up to here (paper)."""

LARGEST_FOR_EQUATION_12 = 2.0
"""Eq. 12 stays within 1 % of eq. 8 up to here and grows without measure beyond (our limit)."""

TOLERANCE = 1e-12
"""Relative tolerance of a step; a second solution has a hundred times as much."""

AGREEMENT = 1e-8
"""Largest difference between both solutions (relative) and of the energy balance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenerImpact:
    """Solution of eq. 8, dimensionless."""

    inelasticity: float
    """Lambda of eq. 9."""
    restitution: float
    """e: speed after over speed before the impact."""
    contact_time: float
    """tau_c: first zero of the approach after the touch."""
    energy_residual: float
    """``1 - e^2`` less what the plate took, relative to the sphere's energy before the impact."""
    difference: float
    """Larger relative change of e and tau_c if the tolerance is loosened a hundredfold."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenerReflection:
    """Prediction of Zener's model for one transducer on one plate."""

    inelasticity: float
    restitution: float
    contact_time: float
    """Dimensionless."""
    amplitude_ratio: float
    tof_s: float


def solve_impact(inelasticity: float, *, tolerance: float = TOLERANCE) -> ZenerImpact:
    """Solve eq. 8 numerically for the restitution and contact time of an impact.

    Eq. 8, ``sigma'' + (1 + lambda d/dtau) sigma^(3/2) = 0``, has a force whose second derivative is infinite
    at both ends. With the sphere's speed ``p = sigma' + lambda sigma^(3/2)``, the root
    ``x = sqrt(sigma)`` and a time s with ``dtau = 2 x ds`` it becomes a polynomial system::

        dx/ds = p - lambda x^3,   dp/ds = -2 x^4,   dtau/ds = 2 x

    from x = 0, p = 1 to the next x = 0, where ``e = -p``. It is smooth throughout, so a method of order
    eight keeps its order. Near the end p and tau hardly depend on s: the event's own error is harmless.

    Parameters
    ----------
    inelasticity
        Lambda of eq. 9, 0 to 200.
    tolerance
        Relative one of a step.

    Raises
    ------
    SpecimenError
        Lambda is negative, not a number or too large.
    IntegrationError
        The solution does not converge or does not balance the energy.

    Notes
    -----
    Energy: the plate takes ``lambda int sigma^3 dtau = (1 - e^2) / 2``. Beyond lambda about 10 almost
    nothing is left to rebound and ``e = 0.679293 / lambda^5``.
    """
    _check_inelasticity(inelasticity, LARGEST_INELASTICITY, "make the plate thicker or the spheres smaller")
    restitution, contact_time, residual = _integrate_impact(inelasticity, tolerance)
    coarse_restitution, coarse_contact_time, _ = _integrate_impact(inelasticity, 100.0 * tolerance)
    difference = max(
        abs(coarse_restitution / restitution - 1.0),
        abs(coarse_contact_time / contact_time - 1.0),
    )
    # Written so that a NaN fails, too.
    if not (difference <= AGREEMENT and abs(residual) <= AGREEMENT):
        raise IntegrationError(
            f"eq. 8 at an inelasticity of {inelasticity:.6g}: two tolerances differ by {difference:.2g} and "
            f"the energy by {residual:.2g}, more than {AGREEMENT:.0e}; no numbers are returned, use a "
            f"smaller inelasticity"
        )
    return ZenerImpact(
        inelasticity=inelasticity,
        restitution=restitution,
        contact_time=contact_time,
        energy_residual=residual,
        difference=difference,
    )


def _integrate_impact(inelasticity: float, tolerance: float) -> tuple[float, float, float]:
    """Integrate eq. 8 at one tolerance; return restitution, contact time and energy residual.

    Raise IntegrationError if sphere and plate do not separate.
    """

    def slope(_: float, state: Sequence[float]) -> list[float]:
        """Return the derivatives by s of root, speed, time and energy loss."""
        x, p, _tau, _taken = state
        force = x * x * x
        return [p - inelasticity * force, -2.0 * x * force, 2.0 * x, 2.0 * inelasticity * x * force * force]

    def separation(_: float, state: Sequence[float]) -> float:
        """Return the root of the overlap, which is zero at separation."""
        return state[0]

    separation.terminal = True  # type: ignore[attr-defined]
    separation.direction = -1.0  # type: ignore[attr-defined]
    # No absolute tolerance that matters: e falls with the fifth power of lambda and must keep its digits.
    # The span only has to be longer than any contact: s grows with lambda cubed, to 2e7 at 200.
    solution = solve_ivp(
        slope,
        (0.0, 1e9),
        [0.0, 1.0, 0.0, 0.0],
        method="DOP853",
        rtol=tolerance,
        atol=1e-30,
        first_step=1e-3,
        events=separation,
    )
    if solution.status != 1:
        raise IntegrationError(
            f"eq. 8 at an inelasticity of {inelasticity:.6g}: sphere and plate did not separate "
            f"({solution.message}); use a smaller inelasticity"
        )
    _, p, contact_time, taken = (float(value) for value in solution.y_events[0][0])
    return -p, contact_time, 1.0 - p * p - 2.0 * taken


def approximate_restitution(inelasticity: float) -> float:
    """Approximate the restitution e, speed after over speed before, from the inelasticity lambda by eq. 10.

    ``e = exp(-1.6605 lambda)`` (paper). Raise SpecimenError for lambda outside 0 to 1.
    """
    _check_inelasticity(inelasticity, LARGEST_FOR_EQUATION_10, "use solve_impact instead of eq. 10")
    return math.exp(-1.6605 * inelasticity)


def approximate_contact_time(inelasticity: float) -> float:
    """Approximate the dimensionless contact time tau_c from the inelasticity lambda by eq. 12 of the paper.

    ``tau_c = 2.762 + 0.4568 exp(1.27 lambda)``. Raise SpecimenError for lambda outside 0 to 2.
    """
    _check_inelasticity(inelasticity, LARGEST_FOR_EQUATION_12, "use solve_impact instead of eq. 12")
    return 2.762 + 0.4568 * math.exp(1.27 * inelasticity)


def inelasticity_parameter(
    *,
    incident_speed_m_per_s: float,
    radius_m: float,
    sphere_density_kg_per_m3: float,
    sphere_youngs_modulus_pa: float,
    sphere_poisson_ratio: float,
    thickness_m: float,
    plate_density_kg_per_m3: float,
    plate_youngs_modulus_pa: float,
    plate_poisson_ratio: float,
) -> float:
    """Compute the inelasticity parameter lambda of eq. 9, dimensionless.

    It is ``m / (T Z)``: mass of the sphere over the contact's time scale ``T = (m / (A sqrt(v)))^(2/5)``
    and the thin plate's impedance ``Z = 8 sqrt(D rho h)``.

    Parameters
    ----------
    incident_speed_m_per_s
        Speed of the sphere that meets the plate, ``0.682 v_imp`` in a chain.
    thickness_m
        Thickness under the sphere: what corrosion left.

    Raises
    ------
    ValueError
        A value is not finite or out of its range; lambda itself has no bound here.
    """
    _check_positive("incident_speed_m_per_s", incident_speed_m_per_s)
    _check_positive("radius_m", radius_m)
    _check_positive("sphere_density_kg_per_m3", sphere_density_kg_per_m3)
    _check_positive("sphere_youngs_modulus_pa", sphere_youngs_modulus_pa)
    _check_positive("thickness_m", thickness_m)
    _check_positive("plate_density_kg_per_m3", plate_density_kg_per_m3)
    _check_positive("plate_youngs_modulus_pa", plate_youngs_modulus_pa)
    for name, value in (
        ("sphere_poisson_ratio", sphere_poisson_ratio),
        ("plate_poisson_ratio", plate_poisson_ratio),
    ):
        if not -1.0 < value < 0.5:
            raise ValueError(f"{name} is {value}; it must lie between -1 and 0.5")
    plate = plane_modulus_pa(plate_youngs_modulus_pa, plate_poisson_ratio)
    sphere = plane_modulus_pa(sphere_youngs_modulus_pa, sphere_poisson_ratio)
    slenderness = 2.0 * radius_m / thickness_m
    # A product overflows to infinity, which the solution refuses with its own words; a power raises.
    geometry = math.pi**0.6 / (4.0 * math.sqrt(3.0)) * slenderness * slenderness
    density = (sphere_density_kg_per_m3 / plate_density_kg_per_m3) ** 0.6
    speed = (incident_speed_m_per_s**2 * plate_density_kg_per_m3 / plate) ** 0.1
    return float(geometry * density * speed * (1.0 + plate / sphere) ** -0.4)


def amplitude_ratio(restitution: float) -> float:
    """Compute the ratio of peak forces PSW / ISW by eq. 11, ``AR = e^(6/5)``.

    Raise ValueError unless e is above 0 and at most 1.
    """
    _check_restitution(restitution)
    return float(restitution**1.2)


def time_of_flight_s(
    *,
    restitution: float,
    contact_time: float,
    spheres_below: int,
    mass_kg: float,
    sphere_stiffness: float,
    plate_stiffness: float,
    impact_speed_m_per_s: float,
) -> float:
    """Compute the time from ISW to PSW at the sensor by eq. 13, in s.

    ``[1.18 (1 + e^(-1/5)) N A_s^(-2/5) + 1.08 tau_c A_p^(-2/5)] m^(2/5) v_imp^(-1/5)``: down and back
    through N contacts, and the stay at the plate (1.08 is ``0.682^(-1/5)``).

    Parameters
    ----------
    restitution, contact_time
        Dimensionless, of `solve_impact` or of eqs 10 and 12.
    spheres_below
        N, number of spheres between sensor and plate.
    sphere_stiffness, plate_stiffness
        ``A_s`` and ``A_p`` of eq. 2 in N/m^1.5.
    impact_speed_m_per_s
        Speed of the striker, not of the particles.

    Raises
    ------
    ValueError
        A value is not finite or out of its range.
    """
    _check_restitution(restitution)
    _check_positive("contact_time", contact_time)
    _check_positive("spheres_below", spheres_below)
    _check_positive("mass_kg", mass_kg)
    _check_positive("sphere_stiffness", sphere_stiffness)
    _check_positive("plate_stiffness", plate_stiffness)
    _check_positive("impact_speed_m_per_s", impact_speed_m_per_s)
    travel = 1.18 * (1.0 + restitution**-0.2) * spheres_below * sphere_stiffness**-0.4
    stay = 1.08 * contact_time * plate_stiffness**-0.4
    return float((travel + stay) * mass_kg**0.4 * impact_speed_m_per_s**-0.2)


def compute_reflection(
    chain: ChainParameters, plate: PlateParameters, *, depth_fraction: float = 0.0, closed_form: bool = False
) -> ZenerReflection:
    """Compute time of flight and amplitude ratio of a transducer on a plate thinned under it.

    Of the chain count radius, mass, material, temperature, spheres below the sensor and drop height; of
    the plate thickness and material. The model of the plate, its edges and the outline of a patch do not.

    Parameters
    ----------
    chain, plate
        The twin's parameters.
    depth_fraction
        Lost part of the thickness, 0 to 0.95: ``h (1 - depth)`` enters lambda, as if the whole plate were
        that thin.
    closed_form
        Eqs 10 and 12 in place of the numerical solution of eq. 8.

    Raises
    ------
    ValueError
        The depth is out of bounds.
    SpecimenError
        Lambda is out of bounds: the plate is too thin for the spheres. Or the spheres are not all equal,
        precompressed, or on a wet plate.
    IntegrationError
        As `solve_impact`.
    """
    if chain.spheres:
        raise SpecimenError(
            f"chain.spheres describes {len(chain.spheres)} bodies that differ; Zener's model knows equal "
            f"spheres only: take them out, or use the coupled model"
        )
    for key, value in (("chain.precompression_n", chain.precompression_n), ("plate.liquid", plate.liquid)):
        if value:
            raise SpecimenError(
                f"{key} is {value}; Zener's model knows none: take it out, or use the coupled model"
            )
    patch = CorrosionParameters(depth_fraction=depth_fraction)
    modulus = chain.body(0).youngs_modulus_pa
    impact_speed = math.sqrt(2.0 * FREE_FALL_M_PER_S2 * chain.drop_height_m)
    inelasticity = inelasticity_parameter(
        incident_speed_m_per_s=PARTICLE_SPEED_FRACTION * impact_speed,
        radius_m=chain.radius_m,
        sphere_density_kg_per_m3=chain.mass_kg / (4.0 / 3.0 * math.pi * chain.radius_m**3),
        sphere_youngs_modulus_pa=modulus,
        sphere_poisson_ratio=chain.poisson_ratio,
        thickness_m=plate.thickness_m * (1.0 - patch.depth_fraction),
        plate_density_kg_per_m3=plate.density_kg_per_m3,
        plate_youngs_modulus_pa=plate.warm_youngs_modulus_pa,
        plate_poisson_ratio=plate.poisson_ratio,
    )
    if closed_form:
        restitution = approximate_restitution(inelasticity)
        contact_time = approximate_contact_time(inelasticity)
    else:
        impact = solve_impact(inelasticity)
        restitution, contact_time = impact.restitution, impact.contact_time
    return ZenerReflection(
        inelasticity=inelasticity,
        restitution=restitution,
        contact_time=contact_time,
        amplitude_ratio=amplitude_ratio(restitution),
        tof_s=chain_time_of_flight_s(
            chain,
            plate,
            restitution=restitution,
            contact_time=contact_time,
            impact_speed_m_per_s=impact_speed,
        ),
    )


def chain_time_of_flight_s(
    chain: ChainParameters,
    plate: PlateParameters,
    *,
    restitution: float,
    contact_time: float,
    impact_speed_m_per_s: float,
) -> float:
    """Compute the time of flight of a chain on a plate by eq. 13, with stiffnesses of eq. 2, in s.

    Restitution and contact time are dimensionless. Raise ValueError for a value out of its range, such as a
    chain without spheres below the sensor.
    """
    sphere = chain.radius_m, chain.body(0).youngs_modulus_pa, chain.poisson_ratio
    return time_of_flight_s(
        restitution=restitution,
        contact_time=contact_time,
        spheres_below=chain.spheres_below,
        mass_kg=chain.mass_kg,
        sphere_stiffness=sphere_on_sphere_stiffness(*sphere),
        plate_stiffness=sphere_on_flat_stiffness(*sphere, plate.warm_youngs_modulus_pa, plate.poisson_ratio),
        impact_speed_m_per_s=impact_speed_m_per_s,
    )


def _check_inelasticity(value: float, largest: float, remedy: str) -> None:
    """Raise SpecimenError, with the remedy, for an inelasticity outside 0 to ``largest``."""
    if not 0.0 <= value <= largest:
        raise SpecimenError(
            f"the inelasticity is {value:.6g}; it must lie between 0 and {largest:g}: {remedy}"
        )


def _check_positive(name: str, value: float) -> None:
    """Raise ValueError for a value that is not positive and finite."""
    if not 0.0 < value < math.inf:
        raise ValueError(f"{name} is {value}; it must be a finite number greater than 0")


def _check_restitution(value: float) -> None:
    """Raise ValueError for a restitution that is not above 0 and at most 1."""
    # A numerical e of 1 may lie above it by as much as it is known.
    if not 0.0 < value <= 1.0 + AGREEMENT:
        raise ValueError(f"restitution is {value}; it must be greater than 0 and at most 1")
