"""Krylov spaces of a plate: what they promise about their vectors."""

import numpy as np
import pytest

from simulator.numerics.band_factor import factorize_band, solve_band, to_lower_band
from simulator.numerics.krylov import SHIFT_RAD_PER_S, lanczos
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.plate import build_plate

PLATE = build_plate(PlateParameters(elements_per_edge=24, contact_element_m=1e-3), CorrosionParameters())


@pytest.fixture(scope="module")
def matrices():
    return PLATE.evaluate_at_depth(0.3)


def test_lanczos_makes_the_operator_tridiagonal(matrices):
    stiffness, mass = matrices
    factor = factorize_band(to_lower_band(stiffness + SHIFT_RAD_PER_S**2 * mass))
    vectors = np.empty((40, len(PLATE.load)))
    diagonal, off_diagonal = lanczos(lambda x: solve_band(factor, x), lambda x: mass @ x, PLATE.load, vectors)
    # Rounding grows for a few steps between reorthogonalisations.
    np.testing.assert_allclose(vectors @ (mass @ vectors.T), np.eye(40), atol=1e-8)
    images = np.array([solve_band(factor, mass @ vector) for vector in vectors])
    operator = images @ (mass @ vectors.T)
    expected = np.diag(diagonal) + np.diag(off_diagonal, 1) + np.diag(off_diagonal, -1)
    np.testing.assert_allclose(operator, expected, atol=1e-8 * diagonal.max())
    first = solve_band(factor, PLATE.load)
    np.testing.assert_allclose(vectors[0], first / np.sqrt(first @ (mass @ first)), rtol=1e-12)
