"""Reduced model of the plate for every depth of its patch.

The plate is linear and driven by one force, so the vectors that matter span a Krylov space (`krylov`). A
few dozen hold everything the plate does within a record. Such spaces at several depths are merged into
one basis V, and stiffness and mass are projected onto it (Galerkin, ``V^T K V``): they stay cubic
polynomials in the remaining thickness, so that a new depth costs one small eigenvalue problem.

What a space needs most counts most in the merge: each of its modes comes with the flexibility that it
adds at the frequency of the shift, and every space with the same weight; so do static deflections.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from simulator.numerics.arrays import FloatArray
from simulator.numerics.band_factor import FactorFamily
from simulator.numerics.krylov import SHIFT_RAD_PER_S, lanczos
from simulator.plate.mindlin.element import DOF_PER_NODE
from simulator.plate.mindlin.plate import AffinePlate
from simulator.plate.reduced import ReducedPlate, merge_vectors

BASIS = ((0.0, 50), (0.3, 28), (0.6, 28), (0.8, 28), (0.9, 28), (0.95, 32))
"""Depths whose Krylov vectors enter the basis, and how many of each: what lies between can use those of
both ends."""

STATIC_DEPTHS = (0.0, 0.95)
"""Depths whose static deflections enter the basis."""

LIQUID_VECTORS = 8
"""With a liquid each depth gets so many more vectors, and as many of the dry plate: the factors know nothing
of the liquid, so that its own space alone would stop converging at some 1e-5."""


def reduce_plate(plate: AffinePlate, *, basis: tuple[tuple[float, int], ...] = BASIS) -> ReducedPlate:
    """Project a plate onto merged Krylov spaces; `basis` pairs depths with numbers of vectors.

    Raise LinAlgError if a matrix is not positive definite.
    """
    order = _order_from_far_end(plate)
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
        strengths.append(_fill_krylov_space(system, factors, depth, raw[at : at + count]))
        at += count
    for row, depth in zip(raw[total:], STATIC_DEPTHS, strict=True):
        row[:] = static_factors.solve(static_factors.factor(1.0 - depth), plate.load)
        strengths.append(np.ones((1, 1)))
    vectors = merge_vectors(raw, np.sqrt(plate.evaluate_at_depth(0.0)[1].diagonal()), strengths).T @ raw
    _align_last_with_load(vectors, vectors @ plate.load)
    mass = _project_terms(plate.mass, vectors)
    if plate.added_mass is not None:
        mass[0] += vectors @ (plate.added_mass @ vectors.T)
    return ReducedPlate(
        stiffness=_project_terms(plate.stiffness, vectors), mass=mass, load=vectors[-1:] @ plate.load
    )


def _order_from_far_end(plate: AffinePlate) -> NDArray[np.int64]:
    """Return the elimination order of the unknowns, shape (n,): line by line towards the first grid line."""
    node, kind = np.divmod(plate.free, DOF_PER_NODE)
    line, place = np.divmod(node, len(plate.y_m))
    if len(plate.y_m) > len(plate.x_m):
        line, place = place, line
    return np.lexsort((kind, place, line))[::-1].copy()


def _fill_krylov_space(
    plate: AffinePlate, factors: FactorFamily, depth: float, vectors: FloatArray
) -> FloatArray:
    """Fill the rows of `vectors` with a Krylov space; return the columns that combine them to modes.

    Each mode is as strong as its part in the response at ``depth``, a fraction of the thickness. Raise
    LinAlgError if the shifted stiffness is not positive definite.
    """
    s = 1.0 - depth
    factor = factors.factor(s)
    matrix = sum((s**power * term for power, term in enumerate(plate.mass[1:], 1) if term.nnz), plate.mass[0])
    liquid = plate.added_mass

    def mass(x: FloatArray) -> FloatArray:
        """Multiply by the mass matrix, that of a liquid included."""
        return np.asarray(matrix @ x if liquid is None else matrix @ x + liquid @ x)

    diagonal, off_diagonal = lanczos(lambda x: factors.solve(factor, x), mass, plate.load, vectors)
    inverse, shapes = linalg.eigh_tridiagonal(diagonal, off_diagonal, check_finite=False)
    participation = (vectors @ plate.load) @ shapes
    # The eigenvalues are 1 / (omega^2 + sigma^2): this is the root of a mode's flexibility at sigma.
    return np.asarray(shapes * (participation * np.sqrt(np.abs(inverse))))


def _align_last_with_load(vectors: FloatArray, load: FloatArray) -> None:
    """Reflect the basis, shape (r, n), in place so that the load acts only along its last vector.

    `load` is in the basis' coordinates.
    """
    normal = load / linalg.norm(load)
    normal[-1] += 1.0 if normal[-1] >= 0.0 else -1.0
    vectors -= np.outer(2.0 / (normal @ normal) * normal, normal @ vectors)


def _project_terms(terms: tuple[sparse.csc_matrix, ...], vectors: FloatArray) -> FloatArray:
    """Project each term onto the rows of `vectors` (Galerkin), shape (4, r, r)."""
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
