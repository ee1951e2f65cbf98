"""Hertz's law of two elastic bodies: ``F = A d^(3/2)`` (paper, equations 1 and 2)."""

from __future__ import annotations

import math

from simulator.materials import plane_modulus_pa


def sphere_on_sphere_stiffness(radius_m: float, youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """Stiffness of two equal spheres, in N/m^1.5.

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
    """Stiffness of a sphere on a flat of another material, in N/m^1.5.

    ``A = (4 sqrt(R) / 3) [(1 - nu_b^2) / E_b + (1 - nu_p^2) / E_p]^-1``: equation 2, second row, with
    the power -1 of the bracket that the print lacks.
    """
    compliance = 1.0 / plane_modulus_pa(youngs_modulus_pa, poisson_ratio)
    compliance += 1.0 / plane_modulus_pa(flat_youngs_modulus_pa, flat_poisson_ratio)
    return 4.0 * math.sqrt(radius_m) / 3.0 / compliance


def indentation_m(force_n: float, stiffness: float) -> float:
    """``d = (F / A)^(2/3)``: how far a static force presses two bodies together."""
    return float((max(force_n, 0.0) / stiffness) ** (2.0 / 3.0))
