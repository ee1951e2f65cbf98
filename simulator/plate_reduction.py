"""One small model of the plate for every depth of its patch.

The plate is linear and driven by one force, so the vectors that matter span a Krylov space (`krylov`). A
few dozen hold everything the plate does within a record. Such spaces at several depths are merged into
one basis V, and stiffness and mass are projected onto it (Galerkin, ``V^T K V``): they stay cubic
polynomials in the remaining thickness, so that a new depth costs one small eigenvalue problem.

What a space needs most counts most in the merge: each of its modes comes with the flexibility that it
adds at the frequency of the shift, and every space with the same weight; so do static deflections.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from simulator.band_factor import FactorFamily
from simulator.driven_modes import driven_modes
from simulator.krylov import SHIFT_RAD_PER_S, lanczos
from simulator.mindlin_element import DOF_PER_NODE
from simulator.mindlin_plate import AffinePlate

FloatArray = NDArray[np.float64]

BASIS = ((0.0, 50), (0.3, 28), (0.6, 28), (0.8, 28), (0.9, 28), (0.95, 32))
"""Depths whose Krylov vectors enter the basis, and how many of each: what lies between can use those of
both ends."""

STATIC_DEPTHS = (0.0, 0.95)
"""Depths whose static deflections enter the basis."""

LIQUID_VECTORS = 8
"""With a liquid each depth gets so many more vectors, and as many of the dry plate: the factors know nothing
of the liquid, so that its own space alone would stop converging at some 1e-5."""

MERGE_TOLERANCE = 5e-7
"""Directions weaker than this part of the strongest are left out of the merged basis."""

MODES_PER_DIRECTION = 0.75
"""The fastest modes of so many directions are no modes of the plate, and three quarters do as well."""

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
        float64, shape (4, r, r): coefficients of 1, s, s^2 and s^3, symmetric. The last direction of the
        basis is that of the load, no other feels it.
    load
        float64, shape (1,): force in the last direction for a unit force of the chain.
    """

    stiffness: FloatArray
    mass: FloatArray
    load: FloatArray

    def modes(self, depth_fraction: float) -> PlateModes:
        """Modes of the reduced plate with the patch thinned by `depth_fraction`."""
        size = self.stiffness.shape[1]
        powers = (1.0 - depth_fraction) ** np.arange(4.0)
        k, m = ((powers @ terms.reshape(4, -1)).reshape(size, size) for terms in (self.stiffness, self.mass))
        omega, participation, residual = driven_modes(
            k, m, float(self.load[0]), math.ceil(MODES_PER_DIRECTION * size)
        )
        return PlateModes(
            omega_rad_per_s=omega, participation=participation, residual_compliance_m_per_n=residual
        )


def reduce_plate(plate: AffinePlate, *, basis: tuple[tuple[float, int], ...] = BASIS) -> ReducedPlate:
    """Project `plate` onto the merged Krylov spaces of `basis`, pairs of a depth and a number of vectors."""
    order = _far_end_first(plate)
    shifted = tuple(k + SHIFT_RAD_PER_S**2 * m for k, m in zip(plate.stiffness, plate.mass, strict=True))
    factors, static_factors = FactorFamily(shifted, order), FactorFamily(plate.stiffness, order)
    tasks = [(plate, depth, count) for depth, count in basis]
    if plate.added_mass is not None:
        dry = replace(plate, added_mass=None)
        tasks = [(plate, depth, count + LIQUID_VECTORS) for depth, count in basis]
        tasks += [(dry, depth, LIQUID_VECTORS) for depth, _ in basis]
    total = sum(count for _, _, count in tasks)
    raw = np.empty((total + len(STATIC_DEPTHS), len(plate.load)))
    strengths, at = [], 0
    for system, depth, count in tasks:
        strengths.append(_space(system, factors, depth, raw[at : at + count]))
        at += count
    for row, depth in zip(raw[total:], STATIC_DEPTHS, strict=True):
        row[:] = static_factors.solve(static_factors.factor(1.0 - depth), plate.load)
        strengths.append(np.ones((1, 1)))
    vectors = merge(raw, np.sqrt(plate.at_depth(0.0)[1].diagonal()), strengths).T @ raw
    _turn_load_last(vectors, vectors @ plate.load)
    mass = _projected(plate.mass, vectors)
    if plate.added_mass is not None:
        mass[0] += vectors @ (plate.added_mass @ vectors.T)
    return ReducedPlate(
        stiffness=_projected(plate.stiffness, vectors), mass=mass, load=vectors[-1:] @ plate.load
    )


def _far_end_first(plate: AffinePlate) -> NDArray[np.int64]:
    """Order of elimination: line by line towards the first grid line, along the shorter lines."""
    node, kind = np.divmod(plate.free, DOF_PER_NODE)
    line, place = np.divmod(node, len(plate.y_m))
    if len(plate.y_m) > len(plate.x_m):
        line, place = place, line
    return np.lexsort((kind, place, line))[::-1].copy()


def _space(plate: AffinePlate, factors: FactorFamily, depth: float, vectors: FloatArray) -> FloatArray:
    """Fill the rows of `vectors` with a Krylov space; columns that make its modes of them.

    Each mode is as strong as its part in the response.
    """
    s = 1.0 - depth
    factor = factors.factor(s)
    matrix = sum((s**power * term for power, term in enumerate(plate.mass[1:], 1) if term.nnz), plate.mass[0])
    liquid = plate.added_mass

    def mass(x: FloatArray) -> FloatArray:
        return np.asarray(matrix @ x if liquid is None else matrix @ x + liquid @ x)

    diagonal, beside = lanczos(lambda x: factors.solve(factor, x), mass, plate.load, vectors)
    inverse, shapes = linalg.eigh_tridiagonal(diagonal, beside, check_finite=False)
    participation = (vectors @ plate.load) @ shapes
    # The eigenvalues are 1 / (omega^2 + sigma^2): this is the root of a mode's flexibility at sigma.
    return np.asarray(shapes * (participation * np.sqrt(np.abs(inverse))))


def merge(vectors: FloatArray, weight: FloatArray, strengths: list[FloatArray]) -> FloatArray:
    """Basis of what the rows of `vectors` span but for the weakest directions.

    Parameters
    ----------
    vectors
        float64, shape (count, n): the spaces' vectors, space after space.
    weight
        float64, shape (n,): the basis is orthonormal after multiplication with it.
    strengths
        For each space the columns that make its directions of its vectors, in their relative strength;
        all spaces get the same weight.

    Returns
    -------
    float64, shape (count, r): the columns that make the basis of the vectors.
    """
    weighted = vectors * weight
    gram = weighted @ weighted.T
    start = 0
    alike = []
    for columns in strengths:
        own = gram[start : start + len(columns), start : start + len(columns)]
        alike.append(columns / np.sqrt(np.sum(columns * (own @ columns))))
        start += len(columns)
    mixing = linalg.block_diag(*alike)
    strength, directions = linalg.eigh(mixing.T @ gram @ mixing, check_finite=False)
    kept = strength > MERGE_TOLERANCE**2 * strength[-1]
    return np.asarray(mixing @ (directions[:, kept] / np.sqrt(strength[kept])))


def _turn_load_last(vectors: FloatArray, load: FloatArray) -> None:
    """Reflect the basis so that the load, `load` in its coordinates, has its last direction."""
    normal = load / linalg.norm(load)
    normal[-1] += 1.0 if normal[-1] >= 0.0 else -1.0
    vectors -= np.outer(2.0 / (normal @ normal) * normal, normal @ vectors)


def _projected(terms: tuple[sparse.csc_matrix, ...], vectors: FloatArray) -> FloatArray:
    """Galerkin projection of each term onto the rows of `vectors`, shape (4, r, r)."""
    projected = np.zeros((len(terms), len(vectors), len(vectors)))
    columns = np.ascontiguousarray(vectors.T)
    for term, into in zip(terms, projected, strict=True):
        by_rows = term.T  # symmetric
        touched = np.flatnonzero(np.diff(by_rows.indptr))
        if len(touched) == len(columns):
            product = vectors @ (by_rows @ columns)
        else:  # a patch touches few unknowns
            product = columns[touched].T @ (by_rows[touched] @ columns)
        into[:] = 0.5 * (product + product.T)
    return projected
