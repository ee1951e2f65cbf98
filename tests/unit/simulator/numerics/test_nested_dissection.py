"""Elimination by nested dissection against dense linear algebra."""

import numpy as np
import pytest

from simulator.errors import SpecimenError
from simulator.numerics.nested_dissection import factorize, order_elimination


def cells_of(n_x, n_y):
    """A grid of cells that share the unknowns of their common corners, two at each, one in the middle."""
    places, unknowns = [], []
    corner = np.arange(2 * (n_x + 1) * (n_y + 1)).reshape(n_x + 1, n_y + 1, 2)
    for i, j in np.ndindex(n_x, n_y):
        places.append((i, j))
        middle = corner.size + i * n_y + j
        unknowns.append(np.unique(np.append(corner[i : i + 2, j : j + 2].ravel(), middle)))
    return np.array(places), unknowns, corner.size + n_x * n_y


@pytest.mark.parametrize(("n_x", "n_y"), [(1, 1), (4, 3), (1, 7), (6, 6)])
def test_solution_is_that_of_the_whole_matrix(n_x, n_y):
    random = np.random.default_rng(3)
    places, unknowns, size = cells_of(n_x, n_y)
    pieces = []
    whole = np.zeros((size, size))
    for own in unknowns:
        root = random.normal(size=(len(own), len(own)))
        pieces.append(root @ root.T + np.eye(len(own)))
        whole[np.ix_(own, own)] += pieces[-1]
    right = random.normal(size=size)

    def matrix(cell, order):
        at = np.searchsorted(unknowns[cell], order)
        return pieces[cell][np.ix_(at, at)]

    x = factorize(order_elimination(places, unknowns), matrix).solve(right)
    # Condition numbers here are some 1e4.
    np.testing.assert_allclose(whole @ x, right, atol=1e-10)


def test_a_matrix_that_is_not_positive_definite_is_refused():
    places, unknowns, _ = cells_of(2, 2)
    with pytest.raises(SpecimenError, match="not positive definite"):
        factorize(order_elimination(places, unknowns), lambda cell, order: -np.eye(len(order)))
