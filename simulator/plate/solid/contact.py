"""Exact solutions of elastic solids under Hertz's pressure: the half-space and the supported plate."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from simulator.materials import plane_modulus_pa
from simulator.numerics.arrays import FloatArray
from simulator.parameters.plate import PlateParameters

WAVES_PER_THICKNESS = 40.0
"""Waves with k h beyond this see a half-space, up to ``exp(-40)``."""

WAVES_PER_RADIUS = 60.0
"""A half-space's series ends at waves with k a of this size; what is beyond is 1e-6 of it."""

WIDE_RADIUS = 0.02
"""Radius that finds the images of the load, relative to the plate: wrong by its square."""


def half_space_indentation_m_per_n(
    youngs_modulus_pa: float, poisson_ratio: float, contact_radius_m: float
) -> float:
    """Compute a half-space's mean deflection under a unit force in m/N, ``0.6 (1 - nu^2) / (E a)``.

    Under ``p = p0 sqrt(1 - r^2 / a^2)``, ``p0 = 3 F / (2 pi a^2)``, the surface within the circle sinks by
    ``u(r) = pi p0 (1 - nu^2) (2 a^2 - r^2) / (4 E a)`` (Johnson 1985, Contact Mechanics, equation 3.41a,
    doi:10.1017/CBO9781139171731). The mean of ``r^2 / a^2`` with the weight p is, with t in its place,
    ``int t sqrt(1 - t) dt / int sqrt(1 - t) dt = (4 / 15) / (2 / 3) = 2 / 5``, so the mean of u is

        pi p0 (1 - nu^2) a (2 - 2 / 5) / (4 E) = 0.4 pi p0 a (1 - nu^2) / E = 0.6 (1 - nu^2) F / (E a).

    Another pressure or another weight has another factor.
    """
    return 0.6 / (plane_modulus_pa(youngs_modulus_pa, poisson_ratio) * contact_radius_m)


def surface_flexibility_m_per_pa(plate: PlateParameters, thickness_m: float, k: FloatArray) -> FloatArray:
    """Compute the loaded face's deflection in m/Pa per pressure ``sin ax sin by``, ``k^2 = a^2 + b^2``.

    Exact for hard simple support: half the load presses both faces against each other, half bends,

        (1 - nu^2) / (E k) [(cosh q - 1) / (sinh q + q) + (cosh q + 1) / (sinh q - q)],  q = k h,

    which is ``1 / (D k^4)`` for small q and a half-space's ``2 (1 - nu^2) / (E k)`` for large.
    """
    q = k * thickness_m
    e = np.exp(-q)
    pressed = (1.0 - e) ** 2 / (1.0 - e**2 + 2.0 * q * e)
    bent = (1.0 + e) ** 2 / (1.0 - e**2 - 2.0 * q * e)
    return np.asarray(
        (pressed + bent) / (plane_modulus_pa(plate.warm_youngs_modulus_pa, plate.poisson_ratio) * k)
    )


def transform_hertz_pressure(q: FloatArray) -> FloatArray:
    """Return the Fourier transform of Hertz's pressure per force at q = k a > 0; shape as q.

    It is ``3 (sin q - q cos q) / q^3``, k the wave number and a the radius of contact.
    """
    return np.asarray(3.0 * (np.sin(q) - q * np.cos(q)) / q**3)


def exact_contact_compliance_m_per_n(
    plate: PlateParameters, width_m: float, height_m: float, thickness_m: float
) -> float:
    """Return the averaged deflection in m/N of the centre circle of a simply supported plate.

    A double sine series. Short waves see a half-space; they are summed in closed form: the series of the
    half-space is its indentation and the deflection by the images of the load beyond the edges, which does
    not depend on the radius and is found with a wide one.
    """
    sizes = width_m, height_m
    plane_pa = plane_modulus_pa(plate.warm_youngs_modulus_pa, plate.poisson_ratio)

    def beyond_half_space(k: FloatArray) -> FloatArray:
        """Return the plate's flexibility at wave number k less the half-space's."""
        return surface_flexibility_m_per_pa(plate, thickness_m, k) - 2.0 / (plane_pa * k)

    total = _sum_wave_series(
        sizes, plate.contact_radius_m, WAVES_PER_THICKNESS / thickness_m, beyond_half_space
    )
    wide_m = WIDE_RADIUS * min(sizes)
    total += _sum_wave_series(sizes, wide_m, WAVES_PER_RADIUS / wide_m, lambda k: 2.0 / (plane_pa * k))
    return total + 0.6 / plane_pa * (1.0 / plate.contact_radius_m - 1.0 / wide_m)


def _sum_wave_series(
    sizes: tuple[float, float],
    radius_m: float,
    highest_per_m: float,
    flexibility: Callable[[FloatArray], FloatArray],
) -> float:
    """Sum the waves that move the plate's centre, each weighted by Hertz's pressure twice, in m/N.

    ``sizes`` and ``radius_m``, of plate and load, are in m; ``flexibility`` is in m/Pa over the wave number,
    up to ``highest_per_m``.
    """
    alpha, beta = (
        np.arange(1.0, highest_per_m * size / math.pi + 2.0, 2.0) * (math.pi / size) for size in sizes
    )
    total = 0.0
    for b in beta:
        k = np.hypot(alpha, b)
        total += float(np.sum(transform_hertz_pressure(k * radius_m) ** 2 * flexibility(k)))
    return 4.0 / (sizes[0] * sizes[1]) * total
