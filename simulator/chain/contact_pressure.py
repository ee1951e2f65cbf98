"""Largest pressure in the contacts of a chain, by Hertz, and the pressure of first yield."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np

from simulator.chain.hertz_contact import combined_radius_m
from simulator.chain.spheres import build_chain, list_contacts
from simulator.numerics.arrays import FloatArray
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import PlateParameters

FIRST_YIELD = 1.6
"""Largest pressure over yield strength where the softer body first yields, below its surface.

For a Poisson's ratio of 0.3, by Tresca's and von Mises' criterion (Johnson, Contact Mechanics, 1985,
section 6.2).
"""


def peak_pressure_pa(force_n: FloatArray, stiffness: FloatArray, radius_m: FloatArray) -> FloatArray:
    """Return Hertz's pressure in the middle of contacts in Pa, ``p0 = 3 F / (2 pi a^2)``; 0 for a pull.

    The radius a of a contact follows from ``a^2 = R d`` with the indentation ``d = (F / A)^(2/3)``.

    Parameters
    ----------
    force_n
        Complete force F of each contact.
    stiffness
        Hertz's contact stiffness A, in N/m^1.5.
    radius_m
        Combined radius of curvature R (`combined_radius_m`).
    """
    return np.asarray(1.5 * np.cbrt(np.maximum(force_n, 0.0) * stiffness**2) / (np.pi * radius_m))


def peak_pressures_pa(
    chain: ChainParameters, plate: PlateParameters, contact_force_n: FloatArray
) -> FloatArray:
    """Return the largest pressure of a shot below each body in Pa, shape (n_bodies,), the plate's last.

    Parameters
    ----------
    contact_force_n
        float64, shape (n_bodies, n), of `ShotForce`: static and dynamic force.
    """
    stiffness, radius_m, _ = _describe_contacts(chain, plate)
    return peak_pressure_pa(contact_force_n.max(axis=1), stiffness, radius_m)


def yield_pressures_pa(chain: ChainParameters, plate: PlateParameters) -> FloatArray:
    """Return the pressure of first yield below each body in Pa, shape (n_bodies,), the plate's last."""
    return FIRST_YIELD * _describe_contacts(chain, plate)[2]


@lru_cache(maxsize=8)
def _describe_contacts(
    chain: ChainParameters, plate: PlateParameters
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return A, R and the lower yield strength of each contact; cached, since many shots share a chain."""
    strengths_pa = [*(chain.body(i).yield_strength_pa for i in range(chain.bodies)), plate.yield_strength_pa]
    return (
        build_chain(chain, plate).stiffness_n_per_m15,
        np.array([combined_radius_m(*surfaces) for surfaces in list_contacts(chain, plate)]),
        np.array([min(pair) for pair in pairwise(strengths_pa)]),
    )
