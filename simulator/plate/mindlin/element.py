"""Reissner-Mindlin plate element with four nodes and without locking (MITC4), on rectangles.

Unknowns of a node are ``w, beta_x, beta_y``: the deflection along the chain and the rotations of the
normal in the xz and yz planes (``u = z beta_x``), so that the shear strains are ``w_,x + beta_x`` and
``w_,y + beta_y``. The transverse shear is interpolated from the middles of the edges (MITC4: Bathe and
Dvorkin 1985, doi:10.1002/nme.1620210213), which keeps coarse elements from locking.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from simulator.materials import plane_modulus_pa, shear_modulus_pa
from simulator.numerics.arrays import FloatArray
from simulator.parameters.plate import PlateParameters

SHEAR_CORRECTION = 5.0 / 6.0
"""kappa of equation 3, for a rectangular cross-section."""

DOF_PER_NODE = 3
GAUSS_POINTS = tuple(
    (sign_x / math.sqrt(3.0), sign_y / math.sqrt(3.0)) for sign_x in (-1.0, 1.0) for sign_y in (-1.0, 1.0)
)
"""Natural coordinates (xi, eta) in the order in which the elements are integrated."""


def element_matrices(
    plate: PlateParameters, width_m: FloatArray, height_m: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Compute bending, shear, translational and rotary matrices of rectangles of full thickness.

    Parameters
    ----------
    plate
        Material and thickness h.
    width_m, height_m
        Sizes along x, shape (n_x,), and y, shape (n_y,): the elements are all their pairs.

    Returns
    -------
    Four float64 arrays, shape (n_x n_y, 12, 12). Two Gauss points along each side integrate all four
    exactly on rectangles (equations 3-7, with equation 5 corrected to the shear modulus).
    """
    a, b = (side.ravel() for side in np.meshgrid(width_m, height_m, indexing="ij"))
    sums = [np.zeros((len(a), 12, 12)) for _ in range(4)]
    for kinds in _compute_gauss_point_matrices(plate, a, b):
        for kind, matrices in enumerate(kinds):
            sums[kind] += matrices
    return sums[0], sums[1], sums[2], sums[3]


def compute_thinned_coefficients(
    plate: PlateParameters, a: FloatArray, b: FloatArray, linear: FloatArray, cubic: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compute the coefficients of 1, s, s^2, s^3 in stiffness and mass of elements of uneven thickness.

    s is the fraction of the thickness that remains in the middle of a patch; the local thickness differs
    from one Gauss point to the next.

    Parameters
    ----------
    plate
        Material and pristine thickness.
    a, b
        Sizes along x and y in m, shape (n,).
    linear, cubic
        Coefficients of 1, s, s^2, s^3 in the thickness and in its cube, relative to the pristine ones,
        shape (4, 4, n): coefficient, Gauss point, element.

    Returns
    -------
    Stiffness and mass, float64, shape (4, n, 12, 12): coefficient, element.
    """
    stiffness, mass = np.zeros((2, 4, len(a), 12, 12))
    for point, (bending, shear, translation, rotation) in enumerate(
        _compute_gauss_point_matrices(plate, a, b)
    ):
        for j in range(4):
            in_thickness, in_cube = linear[j, point, :, None, None], cubic[j, point, :, None, None]
            stiffness[j] += in_cube * bending + in_thickness * shear
            mass[j] += in_thickness * translation + in_cube * rotation
    return stiffness, mass


def _compute_gauss_point_matrices(
    plate: PlateParameters, a: FloatArray, b: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Yield the contribution of each Gauss point to the four matrices, each shape (n, 12, 12).

    In order: bending, shear, translational and rotary; ``a`` and ``b``, shape (n,), are the elements' sizes
    along x and y in m.
    """
    h, nu, modulus_pa = plate.thickness_m, plate.poisson_ratio, plate.warm_youngs_modulus_pa
    c = plane_modulus_pa(modulus_pa, nu) * np.array(
        [[1.0, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, (1.0 - nu) / 2.0]]
    )
    bending_law = h**3 / 12.0 * c
    shear_law = SHEAR_CORRECTION * h * shear_modulus_pa(modulus_pa, nu) * np.eye(2)
    mass_law = plate.density_kg_per_m3 * np.diag([h, 0.0, 0.0])
    inertia_law = plate.density_kg_per_m3 * h**3 / 12.0 * np.diag([0.0, 1.0, 1.0])
    area = (0.25 * a * b)[:, None, None]
    for xi, eta in GAUSS_POINTS:
        curvature, shear, value = _strain_displacement_rows(xi, eta, a, b)
        yield (
            np.swapaxes(curvature, 1, 2) @ (area * (bending_law @ curvature)),
            np.swapaxes(shear, 1, 2) @ (area * (shear_law @ shear)),
            np.swapaxes(value, 1, 2) @ (area * (mass_law @ value)),
            np.swapaxes(value, 1, 2) @ (area * (inertia_law @ value)),
        )


def _strain_displacement_rows(
    xi: float, eta: float, a: FloatArray, b: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute rows that turn 12 nodal values into curvatures, shear strains and values, (n, 3 or 2, 12).

    They hold at the natural coordinates ``xi``, ``eta`` of elements of the sizes ``a``, ``b`` in m, shape
    (n,).
    """
    node_xi = np.array([-1.0, 1.0, 1.0, -1.0])
    node_eta = np.array([-1.0, -1.0, 1.0, 1.0])
    shape = 0.25 * (1.0 + xi * node_xi) * (1.0 + eta * node_eta)
    along_x = 0.5 * node_xi * (1.0 + eta * node_eta) / a[:, None]
    along_y = 0.5 * node_eta * (1.0 + xi * node_xi) / b[:, None]

    w, beta_x, beta_y = (slice(k, None, DOF_PER_NODE) for k in range(DOF_PER_NODE))
    curvature = np.zeros((len(a), 3, 12))
    curvature[:, 0, beta_x] = along_x
    curvature[:, 1, beta_y] = along_y
    curvature[:, 2, beta_x] = along_y
    curvature[:, 2, beta_y] = along_x

    # MITC4: the xz strain is taken at the middles of the two edges along x and varies linearly across
    # (there beta_x is the mean of the edge's two nodes); likewise yz.
    shear = np.zeros((len(a), 2, 12))
    shear[:, 0, w] = along_x
    shear[:, 0, beta_x] = 0.25 * (1.0 + eta * node_eta)
    shear[:, 1, w] = along_y
    shear[:, 1, beta_y] = 0.25 * (1.0 + xi * node_xi)

    value = np.zeros((len(a), 3, 12))
    for row, unknown in enumerate((w, beta_x, beta_y)):
        value[:, row, unknown] = shape
    return curvature, shear, value
