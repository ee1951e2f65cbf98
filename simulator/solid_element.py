"""Eight-node brick that bends without locking, one element through the thickness of a plate.

To the trilinear displacements come ``1 - xi^2``, ``1 - eta^2`` and ``1 - zeta^2`` for each component,
own to the element and condensed out (Wilson, Taylor, Doherty and Ghaboussi 1973, in Numerical and
Computer Methods in Structural Mechanics, p. 43). Their gradients are taken with the Jacobian at the
element's centre, scaled by ``j0 / j``, so that they do no work on a constant stress whatever the
element's shape: the patch test holds (Taylor, Beresford and Wilson 1976, doi:10.1002/nme.1620100602).

These modes bend to a constant curvature. Where the curvature changes along an element much wider than
the plate is thick, the trilinear ``u`` and ``v`` still leave transverse shear strains like ``xi eta`` that
nothing balances, and the plate locks. Two bilinear modes of each shear strain take them up (enhanced
assumed strains: Simo and Rifai 1990, doi:10.1002/nme.1620290802; Andelfinger and Ramm 1993,
doi:10.1002/nme.1620360805). They are alike in all directions and mapped like the others.

The corners are numbered like a tensor grid: corner ``4 i + 2 j + k`` lies at the signs i, j, k (0 for
-1, 1 for +1) of xi, eta, zeta. Unknowns of a corner are its displacements along x, y, z.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from simulator.errors import SpecimenError
from simulator.materials import shear_modulus_pa

FloatArray = NDArray[np.float64]

CORNERS = 8
CORNER_SIGNS: FloatArray = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
"""xi, eta, zeta of the corners, shape (8, 3)."""

GAUSS_POINTS: FloatArray = CORNER_SIGNS / math.sqrt(3.0)
"""Two Gauss points along each direction, all of weight one, shape (8, 3)."""

SHEAR_PAIRS = ((1, 2), (0, 2), (0, 1))
"""Directions of the shear strains yz, xz, xy."""


def elasticity_pa(youngs_modulus_pa: float, poisson_ratio: float) -> FloatArray:
    """Isotropic stiffness for the strains xx, yy, zz and the engineering shears yz, xz, xy; (6, 6), Pa."""
    shear = shear_modulus_pa(youngs_modulus_pa, poisson_ratio)
    law = shear * np.diag([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    law[:3, :3] += 2.0 * shear * poisson_ratio / (1.0 - 2.0 * poisson_ratio)
    return law


def brick_stiffness(corners_m: FloatArray, youngs_modulus_pa: float, poisson_ratio: float) -> FloatArray:
    """Stiffness of bricks, the element's own modes condensed out.

    Parameters
    ----------
    corners_m
        float64, shape (elements, 8, 3), in the order of `CORNER_SIGNS`.
    youngs_modulus_pa, poisson_ratio
        Material of all of them.

    Returns
    -------
    float64, shape (elements, 24, 24), N/m.

    Raises
    ------
    SpecimenError
        An element is turned inside out or has no volume.
    """
    strain, volume = _strain_rows(corners_m)
    root = np.linalg.cholesky(elasticity_pa(youngs_modulus_pa, poisson_ratio))
    # Energy is the square of the rows ``L^T B sqrt(dV)`` with ``C = L L^T``, all Gauss points stacked.
    rows = (root.T @ strain) * np.sqrt(volume)[:, :, None, None]
    rows = rows.reshape(len(corners_m), -1, rows.shape[3])
    full = np.swapaxes(rows, 1, 2) @ rows
    n = 3 * CORNERS
    coupling = full[:, n:, :n]
    condensed = np.swapaxes(coupling, 1, 2) @ np.linalg.solve(full[:, n:, n:], coupling)
    return np.asarray(full[:, :n, :n] - condensed)


def brick_mass(corners_m: FloatArray, density_kg_per_m3: float) -> FloatArray:
    """Consistent mass of bricks, the same for each component; shape (elements, 8, 8), kg.

    Only the trilinear displacements carry mass. Exact for parallelepipeds; any shape keeps its mass.
    """
    shape = np.prod(1.0 + GAUSS_POINTS[:, None, :] * CORNER_SIGNS, axis=2) / 8.0
    _, determinant = _jacobian(corners_m, GAUSS_POINTS)
    products = (shape[:, :, None] * shape[:, None, :]).reshape(len(shape), -1)
    return np.asarray(density_kg_per_m3 * (determinant @ products).reshape(-1, CORNERS, CORNERS))


def _natural_derivatives(points: FloatArray) -> FloatArray:
    """Differentiate the corner functions along xi, eta, zeta; shape (points, 8, 3)."""
    factor = 1.0 + points[:, None, :] * CORNER_SIGNS
    others = np.stack([factor[..., 1] * factor[..., 2], factor[..., 0] * factor[..., 2]], axis=2)
    others = np.concatenate((others, (factor[..., 0] * factor[..., 1])[..., None]), axis=2)
    return np.asarray(CORNER_SIGNS * others / 8.0)


def _jacobian(corners_m: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``dx_i / dxi_k`` at the points, shape (elements, points, 3 (k), 3 (i)), and its determinant."""
    derivatives = np.swapaxes(_natural_derivatives(points), 1, 2)
    jacobian = derivatives[None] @ corners_m[:, None]
    determinant = np.linalg.det(jacobian)
    if not np.all(determinant > 0.0):
        worst = int(np.argmin(determinant.min(axis=1)))
        raise SpecimenError(
            f"element {worst} has the Jacobian {determinant[worst].min():.3g} m3 inside; it must be "
            f"positive: check the order of its corners and the grid lines"
        )
    return jacobian, determinant


def _strain_rows(corners_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rows from 24 corner, 9 incompatible and 6 enhanced values to strains, (elements, 8, 6, 39); volumes."""
    jacobian, determinant = _jacobian(corners_m, GAUSS_POINTS)
    centre, centre_determinant = _jacobian(corners_m, np.zeros((1, 3)))
    natural = np.swapaxes(_natural_derivatives(GAUSS_POINTS), 1, 2)
    compatible = np.linalg.solve(jacobian, np.broadcast_to(natural, (len(corners_m), *natural.shape)))
    own = -2.0 * GAUSS_POINTS[:, :, None] * np.eye(3)  # d(1 - xi_m^2) / dxi_k
    scale = (centre_determinant / determinant)[:, :, None, None]
    incompatible = scale * (np.linalg.inv(centre) @ own[None])
    gradient = np.concatenate((compatible, incompatible), axis=3)

    strain = np.zeros((*gradient.shape[:2], 6, 3 * gradient.shape[3]))
    u, v, w = (slice(k, None, 3) for k in range(3))
    along_x, along_y, along_z = (gradient[:, :, k] for k in range(3))
    strain[:, :, 0, u], strain[:, :, 1, v], strain[:, :, 2, w] = along_x, along_y, along_z
    strain[:, :, 3, v], strain[:, :, 3, w] = along_z, along_y
    strain[:, :, 4, u], strain[:, :, 4, w] = along_z, along_x
    strain[:, :, 5, u], strain[:, :, 5, v] = along_y, along_x
    enhanced = _enhanced_shear(np.asarray(np.linalg.inv(centre)))
    return np.concatenate((strain, scale * enhanced), axis=3), determinant


def _enhanced_shear(inverse: FloatArray) -> FloatArray:
    """Bilinear shear strains, mapped by the centre's inverse Jacobian; shape (elements, 8, 6, 6).

    The shear of two directions varies with the product of the third and either of them.
    """
    modes = []
    for third, (first, second) in enumerate(SHEAR_PAIRS):
        # A unit covariant shear: the tensor's two entries are half each.
        along, across = inverse[:, 0, :, first], inverse[:, 0, :, second]
        tensor = 0.5 * (along[:, :, None] * across[:, None, :] + across[:, :, None] * along[:, None, :])
        normal = [tensor[:, i, i] for i in range(3)]
        shear = [2.0 * tensor[:, i, j] for i, j in SHEAR_PAIRS]
        mapped = np.stack(normal + shear, axis=1)
        for other in (first, second):
            monomial = GAUSS_POINTS[:, third] * GAUSS_POINTS[:, other]
            modes.append(monomial[None, :, None] * mapped[:, None, :])
    return np.stack(modes, axis=3)
