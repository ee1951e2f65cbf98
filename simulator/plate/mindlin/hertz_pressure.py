"""Load of Hertz's pressure ``p0 sqrt(1 - r^2 / a^2)`` over a circle about the origin of a grid."""

from __future__ import annotations

import numpy as np

from simulator.numerics.arrays import FloatArray, IntArray
from simulator.plate.quadrature import hertz_pressure_points


def hertz_nodal_weights(
    x_m: FloatArray, y_m: FloatArray, radius_m: float, *, symmetric: tuple[bool, bool]
) -> FloatArray:
    """Compute nodal loads of a unit force of Hertz's pressure about the origin, shape (len(x), len(y)).

    The deflection is bilinear on an element: each of the `hertz_pressure_points` gives its share to the four
    corners around it. The loads add up to one, also where symmetry leaves only the part with x >= 0 or
    y >= 0.
    """
    along_x, along_y, share = hertz_pressure_points(radius_m)
    weights = np.zeros((len(x_m), len(y_m)))
    for sign_x in (1.0,) if symmetric[0] else (1.0, -1.0):
        for sign_y in (1.0,) if symmetric[1] else (1.0, -1.0):
            i, right = _locate_in_elements(x_m, sign_x * along_x)
            j, upper = _locate_in_elements(y_m, sign_y * along_y)
            np.add.at(weights, (i, j), share * (1.0 - right) * (1.0 - upper))
            np.add.at(weights, (i + 1, j), share * right * (1.0 - upper))
            np.add.at(weights, (i, j + 1), share * (1.0 - right) * upper)
            np.add.at(weights, (i + 1, j + 1), share * right * upper)
    return np.asarray(weights / weights.sum())


def _locate_in_elements(lines_m: FloatArray, at_m: FloatArray) -> tuple[IntArray, FloatArray]:
    """Find the element of each coordinate, within the grid, and the relative position in it, 0 to 1."""
    cell = np.clip(np.searchsorted(lines_m, at_m, side="right") - 1, 0, len(lines_m) - 2)
    return cell, (at_m - lines_m[cell]) / np.diff(lines_m)[cell]
