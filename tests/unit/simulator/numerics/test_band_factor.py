"""Banded factors, shared columns and all, against dense solutions."""

import numpy as np
import pytest
from scipy import sparse

from simulator.numerics.band_factor import FactorFamily, factorize_band, solve_band, to_lower_band

SIZE = 60


def chain_matrix(start, stop, reach=4):
    """Positive semidefinite, couples unknowns `start` to `stop` with up to `reach` others."""
    numbers = np.random.default_rng(start + 100 * stop)
    matrix = np.zeros((SIZE, SIZE))
    for i in range(start, stop - reach):
        row = numbers.normal(size=reach + 1)
        matrix[i : i + reach + 1, i : i + reach + 1] += np.outer(row, row)
    return sparse.csc_matrix(matrix)


def test_a_band_is_solved():
    matrix = chain_matrix(0, SIZE) + sparse.identity(SIZE, format="csc")
    right = np.arange(1.0, SIZE + 1)
    np.testing.assert_allclose(
        matrix @ solve_band(factorize_band(to_lower_band(matrix)), right), right, rtol=1e-12
    )


@pytest.mark.parametrize("first", [0, 2, 20, 55, SIZE], ids=lambda first: f"from {first}")
@pytest.mark.parametrize("s", [1.0, 0.5, 0.05])
def test_every_member_of_a_family_is_solved(first, s):
    """Also if all unknowns change, or none does."""
    fixed = chain_matrix(0, SIZE) + 0.1 * sparse.identity(SIZE, format="csc")
    nothing = sparse.csc_matrix((SIZE, SIZE))
    changing = chain_matrix(first, SIZE)
    shuffled = np.random.default_rng(1).permutation(SIZE)
    place = np.argsort(shuffled)
    terms = [m[place][:, place] for m in (fixed, changing, nothing, 3.0 * changing)]
    family = FactorFamily(tuple(terms), shuffled)
    matrix = sum(s**power * term.toarray() for power, term in enumerate(terms))
    right = np.linspace(-1.0, 1.0, SIZE)
    family.factor(0.7)  # an earlier member leaves nothing behind
    found = family.solve(family.factor(s), right)
    np.testing.assert_allclose(found, np.linalg.solve(matrix, right), rtol=1e-9)


def test_a_matrix_that_is_not_positive_definite_is_rejected():
    with pytest.raises(np.linalg.LinAlgError, match="pivot 3"):
        factorize_band(to_lower_band(sparse.diags([1.0, 1.0, -1.0], format="csc")))
