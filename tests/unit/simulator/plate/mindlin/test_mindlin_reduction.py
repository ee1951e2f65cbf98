"""The reduced plate compared with the complete plate."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.plate import build_plate
from simulator.plate.mindlin.reduction import BASIS, reduce_plate
from simulator.plate.reduced import PlateModes

PLATE = PlateParameters(elements_per_edge=32, contact_element_m=1e-3)
UNLISTED_DEPTHS = (0.1, 0.45, 0.7, 0.85)

# A twentieth of the waveform's allowance.
USUAL_ERROR = 5e-6


@pytest.fixture(scope="module", params=["square", "round"])
def plate(request):
    return build_plate(PLATE, CorrosionParameters(shape=request.param, size_m=50.8e-3))


@pytest.fixture(scope="module")
def reduction(plate):
    return reduce_plate(plate)


@pytest.mark.parametrize("depth", [depth for depth, _ in BASIS] + list(UNLISTED_DEPTHS))
def test_static_compliance_is_kept(plate, reduction, depth):
    stiffness, _ = plate.evaluate_at_depth(depth)
    exact = plate.load @ splu(stiffness).solve(plate.load)
    kept = reduction.modes(depth).static_compliance_m_per_n
    assert kept == pytest.approx(exact, rel=USUAL_ERROR)
    assert kept <= exact * (1 + 1e-8)  # Galerkin is never too soft; rounding of the projection


@pytest.mark.parametrize("depth", UNLISTED_DEPTHS)
def test_response_in_time_is_kept_where_no_vector_was_taken(plate, reduction, depth):
    """Laplace domain: growth rates 1/tau weigh the response over the last tau, as a shot does."""
    stiffness, mass = plate.evaluate_at_depth(depth)
    modes = reduction.modes(depth)
    for frequency_hz in (0.0, 2e3, 1e4, 2e4):
        s = 1e4 + 2j * np.pi * frequency_hz
        exact = plate.load @ splu((stiffness + s**2 * mass).tocsc()).solve(plate.load.astype(complex))
        reduced = np.sum(modes.participation**2 / (modes.omega_rad_per_s**2 + s**2))
        assert abs(reduced - exact) <= USUAL_ERROR * abs(exact)


def test_a_depth_costs_a_small_eigenvalue_problem(plate, reduction):
    assert reduction.stiffness.shape[1] < 150 < len(plate.load)


def test_modes_above_the_cut_stay_as_residual_compliance():
    modes = PlateModes(
        omega_rad_per_s=np.array([1.0, 2.0, 4.0, 8.0]), participation=np.array([1.0, 2.0, 1e-9, 4.0])
    )
    cut = modes.cut_off_fast_modes(5.0, yielding_per_kg=np.inf)
    assert cut.omega_rad_per_s.tolist() == [1.0, 2.0]  # the third is not seen, the fourth too fast
    assert cut.static_compliance_m_per_n == pytest.approx(modes.static_compliance_m_per_n, rel=1e-15)
    yielding = modes.cut_off_fast_modes(np.inf, yielding_per_kg=4.9)
    assert yielding.omega_rad_per_s.tolist() == [1.0]
    assert yielding.residual_compliance_m_per_n == pytest.approx(1.25, rel=1e-15)


def test_thin_rectangular_clamped_plates_reduce_too():
    plate = build_plate(
        replace(PLATE, width_m=0.3, height_m=0.9, thickness_m=1e-3, support="clamped"), CorrosionParameters()
    )
    stiffness, _ = plate.evaluate_at_depth(0.5)
    exact = plate.load @ splu(stiffness).solve(plate.load)
    assert reduce_plate(plate).modes(0.5).static_compliance_m_per_n == pytest.approx(exact, rel=USUAL_ERROR)
