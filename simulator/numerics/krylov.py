"""Krylov spaces: the response of a structure to one force within a record.

The vectors ``x_0 = (K + sigma^2 M)^-1 b``, ``x_(j+1) = (K + sigma^2 M)^-1 M x_j`` (Lanczos, shifted and
inverted) hold the response to the force b for times of some dozen ``1 / sigma``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from simulator.numerics.arrays import FloatArray

SHIFT_RAD_PER_S = 6e4
"""sigma: about the circular frequency of a solitary wave of the paper's chain (10 kHz). A shift of the
order of the wave's own frequencies needs far fewer vectors than none."""

REORTHOGONALISED_EVERY = 6
"""Steps between which `lanczos` lets rounding grow."""


def lanczos(
    solve: Callable[[FloatArray], FloatArray],
    mass: Callable[[FloatArray], FloatArray],
    load: FloatArray,
    vectors: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Build the Krylov space of the operator `solve` after `mass`, in which it is symmetric.

    A vector is made orthogonal to the two before it; rounding brings the others back slowly, and only
    every few steps two of them are made orthogonal to all (periodic reorthogonalisation).

    Parameters
    ----------
    solve, mass
        What inverts the shifted stiffness and what multiplies with the mass.
    load
        float64, shape (n,).
    vectors
        float64, shape (count, n): filled with the vectors, normalised in the mass; the first is
        ``solve(load)``.

    Returns
    -------
    diagonal, off_diagonal
        float64, shape (count,) and (count - 1,): the operator in this basis, a tridiagonal matrix.
    """
    count = len(vectors)
    mass_vectors = np.empty_like(vectors)
    diagonal, norms = np.empty(count), np.empty(count)
    x = solve(load)
    for j in range(count):
        mass_x = mass(x)
        norms[j] = np.sqrt(x @ mass_x)
        np.divide(x, norms[j], out=vectors[j])
        np.divide(mass_x, norms[j], out=mass_vectors[j])
        x = solve(mass_vectors[j])
        if j > 0:
            x -= norms[j] * vectors[j - 1]
        diagonal[j] = mass_vectors[j] @ x
        x -= diagonal[j] * vectors[j]
        if j % REORTHOGONALISED_EVERY < 2:
            x -= vectors[: j + 1].T @ (mass_vectors[: j + 1] @ x)
    return diagonal, norms[1:]
