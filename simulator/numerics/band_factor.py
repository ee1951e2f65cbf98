"""Banded Cholesky factors (LAPACK), and what the factors of a family of matrices share.

The matrices of a plate at different depths of its patches differ only there. With the unknowns far from
the contact first, the first columns of the factor are the same for all; only the rest is factored again,
with what the elimination so far has taken from it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import lapack

from simulator.numerics.arrays import FloatArray, IntArray


def factorize_band(band: FloatArray) -> FloatArray:
    """Compute the Cholesky factor of a positive definite band matrix in place (LAPACK's lower storage).

    Raises
    ------
    numpy.linalg.LinAlgError
        The matrix is not positive definite.
    """
    factor, info = lapack.dpbtrf(band, lower=1, overwrite_ab=1)
    if info != 0:
        raise np.linalg.LinAlgError(f"the matrix is not positive definite: pivot {info} is not positive")
    return np.asarray(factor)


def solve_band(factor: FloatArray, right: FloatArray) -> FloatArray:
    """Solve a linear system with a factor of `factorize_band`; `right` and result have the shape (n,)."""
    solution, _ = lapack.dpbtrs(factor, right, lower=1)
    return np.asarray(solution)


def to_lower_band(matrix: sparse.spmatrix) -> FloatArray:
    """Convert a symmetric matrix to LAPACK's lower band storage, ``band[i - j, j] = matrix[i, j]``."""
    entries = _LowerEntries.of(matrix, np.arange(matrix.shape[0]))
    band = np.zeros((int(entries.below.max()) + 1, matrix.shape[0]), order="F")
    band[entries.below, entries.column] = entries.value
    return band


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _LowerEntries:
    """Lower triangle of a symmetric matrix whose unknown k is at ``place[k]``."""

    below: IntArray
    column: IntArray
    value: FloatArray

    @classmethod
    def of(cls, matrix: sparse.spmatrix, place: IntArray) -> _LowerEntries:
        """Create the lower-triangle entries of a matrix whose unknown k moves to ``place[k]``."""
        entries = matrix.tocoo()
        row, column = place[entries.row], place[entries.col]
        lower = row >= column
        return cls(below=(row - column)[lower], column=column[lower], value=entries.data[lower])

    def cut_block(self, start: int, stop: int) -> _LowerEntries:
        """Return the entries in rows and columns from `start` to `stop`, numbered from zero."""
        inside = (self.column >= start) & (self.column + self.below < stop)
        return _LowerEntries(
            below=self.below[inside], column=self.column[inside] - start, value=self.value[inside]
        )


class FactorFamily:
    """Factors of ``A(s) = A_0 + s A_1 + s^2 A_2 + s^3 A_3`` for many s, all positive definite.

    Parameters
    ----------
    coefficients
        A_0 to A_3: sparse, symmetric, shape (n, n).
    order
        Numbers of the unknowns in the order of their elimination. The longer the part before the first
        unknown that A_1, A_2 or A_3 touch, the less there is to do for each s.
    """

    def __init__(self, coefficients: tuple[sparse.spmatrix, ...], order: IntArray) -> None:
        """Factorize what is the same for all s; raise LinAlgError if that part is not positive definite."""
        n = len(order)
        self._order = order
        self._place = np.empty(n, dtype=np.int64)
        self._place[order] = np.arange(n)
        entries = [_LowerEntries.of(matrix, self._place) for matrix in coefficients]
        self._bandwidth = max(int(one.below.max(initial=0)) for one in entries)
        self._fixed = min(int(one.column.min(initial=n)) for one in entries[1:])
        self._rest = [one.cut_block(self._fixed, n) for one in entries]
        window = min(self._bandwidth, n - self._fixed)  # what the first columns reach into
        self._factor = np.empty((self._bandwidth + 1, n), order="F")
        end = self._fixed + window
        head = self._assemble_band([one.cut_block(0, end) for one in entries], 1.0, end)
        before = _extract_lower_corner(head[:, self._fixed :])
        head = factorize_band(head)
        self._factor[:, : self._fixed] = head[:, : self._fixed]
        corner = _extract_lower_corner(head[:, self._fixed :])
        self._taken = before - np.tril(corner @ corner.T)

    def factor(self, s: float) -> FloatArray:
        """Compute the Cholesky factor of A(s); the next call overwrites it.

        Raises
        ------
        numpy.linalg.LinAlgError
            A(s) is not positive definite.
        """
        rest = self._assemble_band(self._rest, s, len(self._order) - self._fixed)
        for column in range(len(self._taken)):
            rest[: len(self._taken) - column, column] -= self._taken[column:, column]
        self._factor[:, self._fixed :] = factorize_band(rest)
        return self._factor

    def solve(self, factor: FloatArray, right: FloatArray) -> FloatArray:
        """Solve a linear system for one right-hand side, shape (n,), with a result of `factor`.

        `right` and the result have the matrices' own order.
        """
        return np.asarray(solve_band(factor, right[self._order])[self._place])

    def _assemble_band(self, entries: list[_LowerEntries], s: float, size: int) -> FloatArray:
        """Assemble the lower band storage of A(s), shape (bandwidth + 1, size)."""
        band = np.zeros((self._bandwidth + 1, size), order="F")
        for power, one in enumerate(entries):
            band[one.below, one.column] += s**power * one.value
        return band


def _extract_lower_corner(band: FloatArray) -> FloatArray:
    """Return the lower triangle of a band matrix's columns as a square matrix; zeros above."""
    size = band.shape[1]
    corner = np.zeros((size, size))
    for column in range(size):
        corner[column:, column] = band[: size - column, column]
    return corner
