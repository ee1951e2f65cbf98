"""Hertz's law of two elastic bodies: ``F = A d^(3/2)`` (paper, equations 1 and 2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from simulator.materials import plane_modulus_pa


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """Surface on one side of a contact.

    Attributes
    ----------
    radius_m
        Radius of curvature; infinity for a flat.
    """

    radius_m: float
    youngs_modulus_pa: float
    poisson_ratio: float


def contact_stiffness(above: Surface, below: Surface) -> float:
    """Compute Hertz's contact stiffness of two bodies, at least one of them round, in N/m^1.5.

    ``A = (4/3) sqrt(R) [(1 - nu_1^2) / E_1 + (1 - nu_2^2) / E_2]^-1`` with ``1 / R = 1 / R_1 + 1 / R_2``
    (Hertz 1882; Johnson, Contact Mechanics, 1985, section 4.2). Equation 2 is its two special cases.

    Raises
    ------
    ValueError
        Both sides are flat: that contact has no law of Hertz.
    """
    if math.isinf(above.radius_m) and math.isinf(below.radius_m):
        raise ValueError("two flat faces touch; Hertz's law needs a round body: put a sphere between")
    if above == below:  # equation 2 as it is printed, to its last bit
        return sphere_on_sphere_stiffness(above.radius_m, above.youngs_modulus_pa, above.poisson_ratio)
    radius = combined_radius_m(above, below)
    if math.isinf(above.radius_m):
        above, below = below, above
    compliance = 1.0 / plane_modulus_pa(above.youngs_modulus_pa, above.poisson_ratio)
    compliance += 1.0 / plane_modulus_pa(below.youngs_modulus_pa, below.poisson_ratio)
    return 4.0 * math.sqrt(radius) / 3.0 / compliance


def combined_radius_m(above: Surface, below: Surface) -> float:
    """Return R in m of two surfaces in contact, ``1 / R = 1 / R_1 + 1 / R_2``; infinity for two flats."""
    if math.isinf(above.radius_m) or math.isinf(below.radius_m):
        return min(above.radius_m, below.radius_m)
    return above.radius_m * below.radius_m / (above.radius_m + below.radius_m)


def sphere_on_sphere_stiffness(radius_m: float, youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """Compute Hertz's contact stiffness of two equal spheres, in N/m^1.5.

    ``A = E sqrt(2 R) / (3 (1 - nu^2))``: equation 2, first row.
    """
    return plane_modulus_pa(youngs_modulus_pa, poisson_ratio) * math.sqrt(2.0 * radius_m) / 3.0


def sphere_on_flat_stiffness(
    radius_m: float,
    youngs_modulus_pa: float,
    poisson_ratio: float,
    flat_youngs_modulus_pa: float,
    flat_poisson_ratio: float,
) -> float:
    """Compute Hertz's contact stiffness of a sphere on a flat of another material, in N/m^1.5.

    ``A = (4 sqrt(R) / 3) [(1 - nu_b^2) / E_b + (1 - nu_p^2) / E_p]^-1``: equation 2, second row, with
    the power -1 of the bracket that the print lacks.
    """
    sphere = Surface(radius_m=radius_m, youngs_modulus_pa=youngs_modulus_pa, poisson_ratio=poisson_ratio)
    flat = Surface(
        radius_m=math.inf, youngs_modulus_pa=flat_youngs_modulus_pa, poisson_ratio=flat_poisson_ratio
    )
    return contact_stiffness(sphere, flat)


def indentation_m(force_n: float, stiffness: float) -> float:
    """Return the indentation ``d = (F / A)^(2/3)`` in m under a static force, A in N/m^1.5; 0 for a pull."""
    return float((max(force_n, 0.0) / stiffness) ** (2.0 / 3.0))
