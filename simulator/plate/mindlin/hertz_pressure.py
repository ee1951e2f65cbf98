"""Load spread as Hertz's pressure ``p0 sqrt(1 - r^2 / a^2)`` over a circle about the origin of a grid."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

RADIAL_POINTS = 48
ANGULAR_POINTS = 48
"""Points over a quarter of the circle: the nodal loads are sure to about 1e-4 of the largest."""


def hertz_nodal_weights(
    x_m: FloatArray, y_m: FloatArray, radius_m: float, *, symmetric: tuple[bool, bool]
) -> FloatArray:
    """Consistent nodal loads of a unit force of Hertz's pressure about the origin, shape (len(x), len(y)).

    The deflection is bilinear on an element. With ``c = sqrt(1 - r^2 / a^2)`` the force on a ring is
    ``c r dr ~ c^2 dc``, smooth in c: Gauss points in c and in the angle carry the pressure, and each
    gives its share to the four corners around it. The loads add up to one, also where symmetry leaves
    only the part with x >= 0 or y >= 0.
    """
    c, c_weight = _gauss(RADIAL_POINTS, 1.0)
    angle, angle_weight = _gauss(ANGULAR_POINTS, 0.5 * math.pi)
    r = radius_m * np.sqrt(1.0 - c**2)
    share = np.outer(c**2 * c_weight, angle_weight).ravel()
    along_x, along_y = np.outer(r, np.cos(angle)).ravel(), np.outer(r, np.sin(angle)).ravel()
    weights = np.zeros((len(x_m), len(y_m)))
    for sign_x in (1.0,) if symmetric[0] else (1.0, -1.0):
        for sign_y in (1.0,) if symmetric[1] else (1.0, -1.0):
            i, right = _cell(x_m, sign_x * along_x)
            j, upper = _cell(y_m, sign_y * along_y)
            np.add.at(weights, (i, j), share * (1.0 - right) * (1.0 - upper))
            np.add.at(weights, (i + 1, j), share * right * (1.0 - upper))
            np.add.at(weights, (i, j + 1), share * (1.0 - right) * upper)
            np.add.at(weights, (i + 1, j + 1), share * right * upper)
    return np.asarray(weights / weights.sum())


def _gauss(count: int, end: float) -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre points and weights on the interval from 0 to `end`."""
    points, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 * end * (points + 1.0), 0.5 * end * weights


def _cell(lines_m: FloatArray, at_m: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Find the element that holds each coordinate and how far along it lies, 0 to 1."""
    cell = np.clip(np.searchsorted(lines_m, at_m, side="right") - 1, 0, len(lines_m) - 2)
    return cell, (at_m - lines_m[cell]) / np.diff(lines_m)[cell]
