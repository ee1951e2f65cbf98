"""Cholesky factor of a sum of small dense matrices on a grid of cells, by nested dissection.

Each cell of the grid brings a dense symmetric matrix over the unknowns that it touches. The grid is cut
into halves again and again. From the single cells upwards, unknowns that no other cell touches are
eliminated with dense Cholesky factors, and what is left of two halves is added (George 1973,
doi:10.1137/0710032; multifrontal method: Duff and Reid 1983, doi:10.1145/356044.356047).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import blas, lapack

from simulator.errors import SpecimenError
from simulator.numerics.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Front:
    """Step of the elimination.

    Attributes
    ----------
    cell
        Number of the cell of a leaf, -1 for a merger.
    children
        Numbers of the two fronts that are merged.
    places
        Positions of their remaining unknowns in this front, whose first unknowns are the eliminated ones.
    eliminated, remaining
        Unknowns eliminated here, and those left to later fronts.
    """

    cell: int
    children: tuple[int, ...]
    places: tuple[IntArray, ...]
    eliminated: IntArray
    remaining: IntArray


def order_elimination(cells: IntArray, unknowns: Sequence[IntArray]) -> list[Front]:
    """Return the fronts that eliminate all unknowns by nested dissection; each comes after its children.

    Parameters
    ----------
    cells
        Place of each cell in the grid, shape (cells, 2).
    unknowns
        Sorted unknowns of each cell.
    """
    touched = np.bincount(np.concatenate(list(unknowns)))
    fronts: list[Front] = []

    def add_fronts(chosen: IntArray) -> tuple[int, IntArray, IntArray]:
        """Append the fronts of some cells; return the last front, its remaining unknowns and counts."""
        children: tuple[int, ...] = ()
        places: tuple[IntArray, ...] = ()
        if len(chosen) == 1:
            here = unknowns[chosen[0]]
            count = np.ones(len(here), dtype=np.int64)
        else:
            halves = [add_fronts(half) for half in _cut_in_halves(cells, chosen)]
            here = np.union1d(halves[0][1], halves[1][1])
            count = np.zeros(len(here), dtype=np.int64)
            children = halves[0][0], halves[1][0]
            places = np.searchsorted(here, halves[0][1]), np.searchsorted(here, halves[1][1])
            for place, half in zip(places, halves, strict=True):
                count[place] += half[2]
        done = count == touched[here]
        position = np.where(done, np.cumsum(done), done.sum() + np.cumsum(~done)) - 1
        fronts.append(
            Front(
                cell=int(chosen[0]) if len(chosen) == 1 else -1,
                children=children,
                places=tuple(position[place] for place in places),
                eliminated=here[done],
                remaining=here[~done],
            )
        )
        return len(fronts) - 1, here[~done], count[~done]

    add_fronts(np.arange(len(cells)))
    return fronts


def _cut_in_halves(cells: IntArray, chosen: IntArray) -> tuple[IntArray, IntArray]:
    """Split cells across their longer side into the most equal halves; return the cells of each."""
    places = cells[chosen]
    extent = places.max(axis=0) - places.min(axis=0)
    along = places[:, int(extent[1] > extent[0])]
    cuts = np.unique(along)[1:]
    cut = cuts[np.argmin([abs(2 * np.sum(along < c) - len(along)) for c in cuts])]
    return chosen[along < cut], chosen[along >= cut]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DissectedCholesky:
    """Factor of one matrix; `solve` applies it to a right-hand side."""

    fronts: list[Front]
    factors: list[tuple[FloatArray, FloatArray]]

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve the linear system for one right-hand side, shape (unknowns,), which is not changed."""
        x = right.copy()
        for front, (own, below) in zip(self.fronts, self.factors, strict=True):
            if len(front.eliminated):
                x[front.eliminated] = blas.dtrsv(own, x[front.eliminated], lower=1)
                x[front.remaining] -= below @ x[front.eliminated]
        for front, (own, below) in zip(self.fronts[::-1], self.factors[::-1], strict=True):
            if len(front.eliminated):
                left = x[front.eliminated] - below.T @ x[front.remaining]
                x[front.eliminated] = blas.dtrsv(own, left, lower=1, trans=1)
        return x


def factorize(fronts: list[Front], cell_matrix: Callable[[int, IntArray], FloatArray]) -> DissectedCholesky:
    """Compute the Cholesky factor of the sum of the cells' matrices, front by front.

    Parameters
    ----------
    fronts
        From `order_elimination`.
    cell_matrix
        Dense matrix of one cell over its unknowns in the given order.

    Raises
    ------
    SpecimenError
        The matrix is not positive definite.
    """
    factors = []
    waiting: dict[int, FloatArray] = {}
    for number, front in enumerate(fronts):
        count, size = len(front.eliminated), len(front.eliminated) + len(front.remaining)
        if front.cell >= 0:
            matrix = cell_matrix(front.cell, np.concatenate((front.eliminated, front.remaining)))
        else:
            matrix = np.zeros((size, size))
        for child, place in zip(front.children, front.places, strict=True):
            rows = np.zeros((size, len(place)))
            rows[place] = waiting.pop(child)
            matrix[place] += rows.T
        own, below, waiting[number] = _eliminate_unknowns(matrix, count)
        factors.append((own, below))
    return DissectedCholesky(fronts=fronts, factors=factors)


def _eliminate_unknowns(matrix: FloatArray, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Eliminate the first unknowns; return their Cholesky factor, its continuation, and the Schur complement.

    ``count`` is the number of eliminated unknowns. Raise SpecimenError if the matrix is not positive
    definite.
    """
    below, schur = np.asfortranarray(matrix[count:, :count]), matrix[count:, count:]
    if not count:
        return np.empty((0, 0)), below, schur
    own, info = lapack.dpotrf(np.asfortranarray(matrix[:count, :count]), lower=1, overwrite_a=1)
    if info != 0:
        raise SpecimenError(
            "the stiffness of the solid plate is not positive definite: elements too thin or a material too "
            "near to incompressible for the digits of the computer; make the patch shallower, "
            "plate.solid.edge_element larger or plate.poisson_ratio smaller"
        )
    if len(schur):
        below = blas.dtrsm(1.0, own, below, side=1, lower=1, trans_a=1, overwrite_b=1)
        schur = schur - below @ below.T
    return own, below, schur
