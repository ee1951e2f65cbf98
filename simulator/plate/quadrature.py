"""Gauss points of integrals over a plate's elements and over the circle of Hertz's pressure."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from simulator.numerics.arrays import FloatArray

RADIAL_POINTS = 48
ANGULAR_POINTS = 48
"""Points over a quarter of the circle: the nodal loads are sure to about 1e-4 of the largest."""


def gauss_rule(count: int, end: float) -> tuple[FloatArray, FloatArray]:
    """Return Gauss-Legendre points and weights on 0 to `end`, shape (count,) each."""
    points, weights = _find_gauss_points(count)
    return 0.5 * end * (points + 1.0), 0.5 * end * weights


_find_gauss_points = cache(np.polynomial.legendre.leggauss)


def hertz_pressure_points(radius_m: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return quadrature points over a quarter of the circle: x, y in m, and share; shape (2304,) each.

    A share is proportional to the force at its point; they add up to pi / 6.

    With ``c = sqrt(1 - r^2 / a^2)`` the force on a ring is ``c r dr ~ c^2 dc``, smooth in c: Gauss points
    in c and in the angle carry the pressure.
    """
    c, c_weight = gauss_rule(RADIAL_POINTS, 1.0)
    angle, angle_weight = gauss_rule(ANGULAR_POINTS, 0.5 * math.pi)
    r = radius_m * np.sqrt(1.0 - c**2)
    share = np.outer(c**2 * c_weight, angle_weight).ravel()
    return np.outer(r, np.cos(angle)).ravel(), np.outer(r, np.sin(angle)).ravel(), share
