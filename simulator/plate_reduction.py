"""One small model of the plate for every depth of its patch.

The plate is linear and driven by one force, so the vectors that matter span a Krylov space: the
static deflection ``K^-1 b``, then ``x_1 = (K + sigma^2 M)^-1 b``, ``x_(j+1) = (K + sigma^2 M)^-1 M x_j``.
A few dozen hold everything the plate does within a record; a sigma of the order of the wave's own
frequencies needs far fewer than sigma = 0. Such spaces at several depths are merged into one basis V,
and stiffness and mass are projected onto it (Galerkin, ``V^T K V``): they stay cubic polynomials in the
remaining thickness, so that a new depth costs one small eigenvalue problem.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse.linalg import LinearOperator

from simulator.mindlin_plate import AffinePlate

FloatArray = NDArray[np.float64]

BASIS_DEPTHS = (0.0, 0.3, 0.6, 0.8, 0.9, 0.95)
"""Depths whose Krylov vectors enter the basis."""

VECTORS_PER_DEPTH = 50

SHIFT_RAD_PER_S = 6e4
"""sigma: about the circular frequency of a solitary wave of the paper's chain (10 kHz)."""

MERGE_TOLERANCE = 1e-6
"""Directions weaker than this part of the strongest are left out of the merged basis."""

UNSEEN_FRACTION = 1e-9
"""Modes that give less than this part of the static deflection are left out."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlateModes:
    """Modes of the plate at one depth, as the chain feels them.

    Attributes
    ----------
    omega_rad_per_s
        float64, shape (n_modes,), rising.
    participation
        float64, shape (n_modes,): phi, the mass-normalised deflection under the chain, kg^-1/2.
    residual_compliance_m_per_n
        Static compliance of all modes left out.
    """

    omega_rad_per_s: FloatArray
    participation: FloatArray
    residual_compliance_m_per_n: float = 0.0

    @property
    def static_compliance_m_per_n(self) -> float:
        """Deflection under a static unit force."""
        modal = np.sum((self.participation / self.omega_rad_per_s) ** 2)
        return float(modal) + self.residual_compliance_m_per_n

    def cut_above(self, omega_rad_per_s: float, yielding_per_kg: float) -> PlateModes:
        """Keep the lower modes; the others become residual compliance.

        Parameters
        ----------
        omega_rad_per_s
            No mode above this frequency is kept.
        yielding_per_kg
            Nor one with which the sum of phi^2, by which the plate yields to a sudden impulse, would
            exceed this.
        """
        flexibility = (self.participation / self.omega_rad_per_s) ** 2
        seen = flexibility > UNSEEN_FRACTION * flexibility.sum()
        kept = seen & (self.omega_rad_per_s <= omega_rad_per_s)
        kept &= np.cumsum(self.participation**2) <= yielding_per_kg
        return PlateModes(
            omega_rad_per_s=self.omega_rad_per_s[kept],
            participation=self.participation[kept],
            residual_compliance_m_per_n=self.residual_compliance_m_per_n + float(flexibility[~kept].sum()),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReducedPlate:
    """Projected plate, a cubic polynomial in the remaining thickness like `mindlin_plate.AffinePlate`.

    Attributes
    ----------
    stiffness, mass
        float64, shape (4, r, r): coefficients of 1, s, s^2 and s^3.
    load
        float64, shape (r,).
    """

    stiffness: FloatArray
    mass: FloatArray
    load: FloatArray

    def modes(self, depth_fraction: float) -> PlateModes:
        """All modes of the reduced plate with the patch thinned by `depth_fraction`."""
        s = 1.0 - depth_fraction
        k = self.stiffness[0] + s * self.stiffness[1] + s**2 * self.stiffness[2] + s**3 * self.stiffness[3]
        m = self.mass[0] + s * self.mass[1] + s**2 * self.mass[2] + s**3 * self.mass[3]
        eigenvalues, shapes = linalg.eigh(k, m, check_finite=False, overwrite_a=True, overwrite_b=True)
        return PlateModes(omega_rad_per_s=np.sqrt(eigenvalues), participation=shapes.T @ self.load)


def reduce_plate(
    plate: AffinePlate,
    *,
    depths: tuple[float, ...] = BASIS_DEPTHS,
    vectors_per_depth: int = VECTORS_PER_DEPTH,
) -> ReducedPlate:
    """Project `plate` onto the merged Krylov spaces at `depths`."""
    blocks = [
        krylov_vectors(*plate.at_depth(depth), plate.load, vectors_per_depth, added_mass=plate.added_mass)
        for depth in depths
    ]
    basis = merge(np.vstack(blocks), plate.at_depth(0.0)[1].diagonal())
    mass = np.stack([basis @ (matrix @ basis.T) for matrix in plate.mass])
    if plate.added_mass is not None:
        mass[0] += basis @ (plate.added_mass @ basis.T)
    return ReducedPlate(
        stiffness=np.stack([basis @ (matrix @ basis.T) for matrix in plate.stiffness]),
        mass=mass,
        load=basis @ plate.load,
    )


def krylov_vectors(
    stiffness: sparse.csc_matrix,
    mass: sparse.csc_matrix,
    load: FloatArray,
    count: int,
    *,
    added_mass: LinearOperator | None = None,
) -> FloatArray:
    """Mass-orthonormal: the static deflection under `load`, then the Krylov space; shape (count, n).

    The mass of a liquid enters every product, but not the factor: it would fill it.
    """
    factor = _factorized(stiffness)
    shifted = _factorized(stiffness + SHIFT_RAD_PER_S**2 * mass)
    vectors = np.empty((count, len(load)))
    mass_vectors = np.empty_like(vectors)
    right = load
    for j in range(count):
        x = linalg.cho_solve_banded((shifted if j else factor, True), right, check_finite=False)
        x = x - vectors[:j].T @ (mass_vectors[:j] @ x)
        mass_x = mass @ x if added_mass is None else mass @ x + added_mass @ x
        norm = np.sqrt(x @ mass_x)
        vectors[j] = x / norm
        mass_vectors[j] = mass_x / norm
        right = mass_vectors[j] if j else load
    return vectors


def merge(vectors: FloatArray, weight: FloatArray) -> FloatArray:
    """Orthonormal basis (in the diagonal `weight`) of what the rows of `vectors` span, shape (r, n)."""
    strength, directions = linalg.eigh((vectors * weight) @ vectors.T, check_finite=False)
    kept = strength > MERGE_TOLERANCE**2 * strength[-1]
    return np.asarray((directions[:, kept] / np.sqrt(strength[kept])).T @ vectors)


def _factorized(matrix: sparse.csc_matrix) -> FloatArray:
    return np.asarray(linalg.cholesky_banded(_lower_band(matrix), lower=True, check_finite=False))


def _lower_band(matrix: sparse.csc_matrix) -> FloatArray:
    """LAPACK's lower band storage: ``band[i - j, j] = matrix[i, j]``."""
    entries = matrix.tocoo()
    below = entries.row - entries.col
    lower = below >= 0
    band = np.zeros((int(below.max()) + 1, matrix.shape[0]))
    band[below[lower], entries.col[lower]] = entries.data[lower]
    return band
