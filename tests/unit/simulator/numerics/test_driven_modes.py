"""Modes as the load sees them, against a general eigenvalue solver."""

import math

import numpy as np
import pytest
from scipy import linalg

from simulator.numerics.driven_modes import find_driven_modes


def system(size, slowest=300.0, fastest=3e7):
    """Stiffness, mass, frequencies and last components of the mass-normalised shapes; all known."""
    numbers = np.random.default_rng(size)
    omega = np.geomspace(slowest, fastest, size)
    shapes = np.linalg.qr(numbers.normal(size=(size, size)))[0] @ np.diag(numbers.uniform(0.5, 2.0, size))
    inverse = np.linalg.inv(shapes)
    stiffness, mass = (inverse.T * omega**2) @ inverse, inverse.T @ inverse
    return 0.5 * (stiffness + stiffness.T), 0.5 * (mass + mass.T), omega, np.abs(shapes[-1])


@pytest.mark.parametrize("size", [1, 2, 3, 40, 101])
def test_modes_are_those_that_made_the_matrices(size):
    stiffness, mass, omega, last = system(size)
    found, participation, residual = find_driven_modes(stiffness, mass, 3.0, size)
    # Rounding of the matrices, relative to the fastest mode: they span a factor of 1e10 in omega^2.
    np.testing.assert_allclose(found, omega, rtol=1e-5)
    np.testing.assert_allclose(participation, 3.0 * last, rtol=1e-5)
    assert residual == 0.0


@pytest.mark.parametrize("steps", [1, 5, 30])
def test_fewer_steps_keep_the_whole_static_deflection_and_are_a_krylov_space(steps):
    stiffness, mass, _, _ = system(40)
    load = np.zeros(40)
    load[-1] = 2.0
    omega, participation, _ = find_driven_modes(stiffness.copy(), mass.copy(), 2.0, steps)
    assert len(omega) == steps
    exact = load @ np.linalg.solve(stiffness, load)
    assert np.sum((participation / omega) ** 2) == pytest.approx(exact, rel=1e-10)
    space = [np.linalg.solve(stiffness, load)]
    for _ in range(steps - 1):
        space.append(np.linalg.solve(stiffness, mass @ (space[-1] / np.linalg.norm(space[-1]))))
        space[-1] -= np.linalg.qr(np.array(space[:-1]).T)[0] @ (
            np.linalg.qr(np.array(space[:-1]).T)[0].T @ space[-1]
        )
    basis = np.linalg.qr(np.array(space).T)[0]
    slowest = math.sqrt(linalg.eigh(basis.T @ stiffness @ basis, basis.T @ mass @ basis)[0][0])
    assert omega[0] == pytest.approx(slowest, rel=1e-6)


def test_modes_hidden_by_rounding_stay_as_compliance():
    """Deflections (0.6, 0.8) and (-0.8, 0.6), equally stiff, omega a factor 1e8 apart."""
    turned = np.array([[0.6, -0.8], [0.8, 0.6]])
    mass = turned @ np.diag([1.0, 1e-16]) @ turned.T
    omega, participation, residual = find_driven_modes(np.eye(2), mass, 1.0, 2)
    np.testing.assert_allclose(omega, [1.0], rtol=1e-12)
    np.testing.assert_allclose(participation, [0.8], rtol=1e-12)
    assert residual == pytest.approx(0.36, rel=1e-12)


@pytest.mark.parametrize(
    ("stiffness", "mass"),
    [
        (np.diag([1.0, -1.0]), np.eye(2)),
        (np.eye(2), np.diag([-1.0, 1.0])),
        (np.eye(2), np.diag([-1.0, -1.0])),
        (np.eye(2), np.array([[1.0, np.nan], [np.nan, 1.0]])),
    ],
    ids=["stiffness", "one mass", "both masses", "not a number"],
)
def test_invalid_stiffness_and_mass_are_refused(stiffness, mass):
    with pytest.raises(np.linalg.LinAlgError):
        find_driven_modes(stiffness, mass, 1.0, 2)
