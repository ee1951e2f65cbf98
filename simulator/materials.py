"""Constants from elastic moduli: plane modulus, plate stiffness, driving-point impedance."""

from __future__ import annotations

import math

REFERENCE_TEMPERATURE_C = 20.0
"""Moduli are given at this temperature."""


def plane_modulus_pa(youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """Return ``E / (1 - nu^2)`` in Pa, the modulus of contacts and thin plates."""
    return youngs_modulus_pa / (1.0 - poisson_ratio**2)


def shear_modulus_pa(youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """Return ``G = E / (2 (1 + nu))`` in Pa; equation 5 of the paper prints it without the 2."""
    return youngs_modulus_pa / (2.0 * (1.0 + poisson_ratio))


def bending_stiffness_n_m(youngs_modulus_pa: float, poisson_ratio: float, thickness_m: float) -> float:
    """Return the bending stiffness ``D = E h^3 / (12 (1 - nu^2))`` in N m."""
    return plane_modulus_pa(youngs_modulus_pa, poisson_ratio) * thickness_m**3 / 12.0


def thin_plate_impedance_n_s_per_m(
    youngs_modulus_pa: float, poisson_ratio: float, density_kg_per_m3: float, thickness_m: float
) -> float:
    """Return the driving-point impedance ``8 sqrt(D rho h)`` of an infinite Kirchhoff plate, in N s/m.

    D is the bending stiffness, rho the density, h the thickness. It is real: the point under a force F moves
    with ``F / (8 sqrt(D rho h))`` (Zener 1941, doi:10.1103/PhysRev.59.669, the paper's reference 58).
    """
    bending = bending_stiffness_n_m(youngs_modulus_pa, poisson_ratio, thickness_m)
    return 8.0 * math.sqrt(bending * density_kg_per_m3 * thickness_m)


def youngs_modulus_at_pa(youngs_modulus_pa: float, change_per_k: float, temperature_c: float) -> float:
    """Return Young's modulus ``E (1 + c (T - 20 C))`` at a temperature in Pa; c is per kelvin."""
    return youngs_modulus_pa * (1.0 + change_per_k * (temperature_c - REFERENCE_TEMPERATURE_C))
