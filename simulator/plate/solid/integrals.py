"""Integrals over the elements of the solid plate: in the plane, within a circle, and the load's own.

A stiffness or mass is a sum of products of such integrals in the plane and integrals through the thickness
(`tensor_basis`).
"""

from __future__ import annotations

import itertools
import math
from functools import lru_cache

import numpy as np

from simulator.materials import shear_modulus_pa
from simulator.numerics.arrays import FloatArray
from simulator.numerics.tensor_basis import Axis, lagrange
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.quadrature import gauss_rule, hertz_pressure_points

COMPONENTS = 3

VOID = 1e-9
"""Stiffness and mass of what a circle takes out of an element, relative to the metal: not quite nothing, so
that every unknown is held."""

CUT_POINTS = 16
"""Points of each of the integrals over an element that a circle cuts."""


def integrate_over_patch(
    x: Axis, y: Axis, corrosion: CorrosionParameters
) -> tuple[FloatArray, dict[tuple[int, int], tuple[FloatArray, ...]]]:
    """Return the fraction of each element within the patch, and integrals of elements that a circle cuts.

    The fractions have the shape (elements of x, of y). The integrals, as of `integrate_in_plane`, are those
    of what is left of the element, by its numbers along x and y; none for another outline than a circle.
    """
    half_x, half_y = corrosion.half_sizes_m
    near_x, near_y = (np.minimum(np.abs(a.breaks_m[1:]), np.abs(a.breaks_m[:-1])) for a in (x, y))
    far_x, far_y = (np.maximum(np.abs(a.breaks_m[1:]), np.abs(a.breaks_m[:-1])) for a in (x, y))
    if corrosion.shape != "round":
        within_x, within_y = far_x <= half_x * (1.0 + 1e-9), far_y <= half_y * (1.0 + 1e-9)
        return np.outer(within_x, within_y).astype(np.float64), {}
    inside = (np.hypot(far_x[:, None], far_y[None, :]) <= half_x * (1.0 + 1e-9)).astype(np.float64)
    touched = (np.hypot(near_x[:, None], near_y[None, :]) < half_x * (1.0 - 1e-9)) & (inside == 0.0)
    cut = {}
    along_x, along_y = (list(zip(a.breaks_m, a.breaks_m[1:], a.degrees, strict=False)) for a in (x, y))
    for ex, ey in np.argwhere(touched):
        whole = integrate_in_plane(x, y, int(ex), int(ey))
        lost = _integrate_within_circle(along_x[ex], along_y[ey], half_x)
        inside[ex, ey] = lost[0].sum() / whole[0].sum()
        cut[int(ex), int(ey)] = tuple(w - (1.0 - VOID) * part for w, part in zip(whole, lost, strict=True))
    return inside, cut


def integrate_in_plane(x: Axis, y: Axis, ex: int, ey: int) -> tuple[FloatArray, ...]:
    """Integrate products of shape functions over one element; six arrays, shape (nodes, nodes).

    ``N N``, ``N_,x N_,x``, ``N_,y N_,y``, ``N_,x N``, ``N_,y N`` and ``N_,x N_,y``, the first factor by row;
    N are the shape functions, N_,x and N_,y their derivatives.
    """
    mass_x, slope_x, stiffness_x = x.interval_matrices(ex)
    mass_y, slope_y, stiffness_y = y.interval_matrices(ey)
    along_x = mass_x, stiffness_x, mass_x, slope_x, mass_x, slope_x
    along_y = mass_y, mass_y, stiffness_y, mass_y, slope_y, slope_y.T
    products = np.einsum("kij,kmn->kimjn", along_x, along_y)  # Kronecker products
    return tuple(products.reshape(len(products), len(mass_x) * len(mass_y), -1))


Interval = tuple[float, float, int]
"""Start and end in m, and degree."""


@lru_cache(maxsize=256)
def _integrate_within_circle(x: Interval, y: Interval, radius_m: float) -> tuple[FloatArray, ...]:
    """Integrate over the part of an element within a circle about the origin; as `integrate_in_plane`.

    Cached, because all depths share the elements: callers must not write to the results.
    """
    left, right = np.sort(np.abs(x[:2]))
    bottom, top = np.sort(np.abs(y[:2]))
    crossings = [math.sqrt(radius_m**2 - side**2) for side in (bottom, top) if side < radius_m]
    ends = [left, *sorted(c for c in crossings if left < c < right), right]
    at_x, at_y, weights = [], [], []
    for start, end in itertools.pairwise(ends):
        # Squared towards the end: there the arc may stand upright.
        t, t_weight = gauss_rule(CUT_POINTS, 1.0)
        across = end - (end - start) * t**2
        for a, a_weight in zip(across, 2.0 * (end - start) * t * t_weight, strict=True):
            reach = min(top, math.sqrt(max(radius_m**2 - a**2, 0.0))) - bottom
            if reach <= 0.0:
                continue
            up, up_weight = gauss_rule(CUT_POINTS, reach)
            at_x.append(np.full(CUT_POINTS, a))
            at_y.append(bottom + up)
            weights.append(a_weight * up_weight)
    if not weights:
        nodes = (x[2] + 1) * (y[2] + 1)
        return (np.zeros((nodes, nodes)),) * 6
    sign_x, sign_y = (math.copysign(1.0, start + end) for start, end, _ in (x, y))
    value_x, along_x = _evaluate_shape_functions(x, sign_x * np.concatenate(at_x))
    value_y, along_y = _evaluate_shape_functions(y, sign_y * np.concatenate(at_y))
    pairs = ((value_x, value_y), (along_x, value_y), (value_x, along_y))
    n, n_x, n_y = ((a[:, :, None] * b[:, None, :]).reshape(len(a), -1) for a, b in pairs)
    weight = np.concatenate(weights)[:, None]
    products = ((n, n), (n_x, n_x), (n_y, n_y), (n_x, n), (n_y, n), (n_x, n_y))
    return tuple(np.asarray(first.T @ (weight * second)) for first, second in products)


def _evaluate_shape_functions(interval: Interval, at_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Evaluate an element's shape functions and their slopes per m, (points, degree + 1) each."""
    start, end, degree = interval
    value, slope = lagrange(degree, 2.0 * (at_m - start) / (end - start) - 1.0)
    return value, slope * (2.0 / (end - start))


def hertz_nodal_weights(x: Axis, y: Axis, radius_m: float, *, whole: bool) -> FloatArray:
    """Compute nodal loads of a unit force of Hertz's pressure about the origin, (nodes of x, nodes of y).

    The loads add up to one, for a quarter of the plate, too.
    """
    at_x, at_y, share = hertz_pressure_points(radius_m)
    signs = (1.0, -1.0) if whole else (1.0,)
    along_x, along_y = (sum(axis.values(sign * at) for sign in signs) for axis, at in ((x, at_x), (y, at_y)))
    weights = np.asarray(along_x).T @ ((share / share.sum())[:, None] * np.asarray(along_y))
    return np.asarray(weights / len(signs) ** 2)


def compute_in_plane_elasticity(
    plate: PlateParameters, integrals: tuple[FloatArray, ...]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Compute the in-plane factors of stiffness and mass of one isotropic element.

    Unknowns are numbered (node, component).

    The stiffness is ``A x (Z Z) + B x (Z' Z') + C x (Z' Z) + its transpose``, the mass ``D x (Z Z)``; Z are
    the functions through the thickness, x is the Kronecker product.

    Returns
    -------
    A, B, C, D
        float64, shape (3 nodes, 3 nodes).
    """
    nn, xx, yy, xn, yn, xy = integrals
    mu = shear_modulus_pa(plate.warm_youngs_modulus_pa, plate.poisson_ratio)
    lame = 2.0 * mu * plate.poisson_ratio / (1.0 - 2.0 * plate.poisson_ratio)
    u, v, w = range(COMPONENTS)
    a, b, c, d = (np.zeros((len(nn), COMPONENTS, len(nn), COMPONENTS)) for _ in range(4))
    a[:, u, :, u] = (lame + 2.0 * mu) * xx + mu * yy
    a[:, v, :, v] = (lame + 2.0 * mu) * yy + mu * xx
    a[:, w, :, w] = mu * (xx + yy)
    a[:, u, :, v] = lame * xy + mu * xy.T
    a[:, v, :, u] = a[:, u, :, v].T
    for component, stiffness in ((u, mu), (v, mu), (w, lame + 2.0 * mu)):
        b[:, component, :, component] = stiffness * nn
        d[:, component, :, component] = plate.density_kg_per_m3 * nn
    for component, slope in ((u, xn), (v, yn)):
        c[:, component, :, w] = mu * slope.T
        c[:, w, :, component] = lame * slope.T
    size = COMPONENTS * len(nn)
    return a.reshape(size, size), b.reshape(size, size), c.reshape(size, size), d.reshape(size, size)
