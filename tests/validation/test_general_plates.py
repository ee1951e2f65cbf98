"""Plates that the paper does not have: reduced against unreduced, and every shot's energy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.linalg import LinearOperator, gmres, splu

from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, LiquidParameters, PatchParameters, PlateParameters
from simulator.plate.mindlin.plate import build_plate
from simulator.plate.mindlin.reduction import reduce_plate
from simulator.shot.model import ShotModel
from simulator.shot.pulse_summary import summarise_pulses

BASE = PlateParameters(elements_per_edge=32, contact_element_m=1e-3)
PATCH = CorrosionParameters()
WATER = LiquidParameters(depth_m=0.1)
SEVERAL = CorrosionParameters(
    shape="rectangular",
    size_m=0.04,
    size_y_m=0.02,
    further=(
        PatchParameters(shape="round", size_m=0.03, offset_x_m=0.05, depth_factor=0.5),
        PatchParameters(profile="bowl", offset_y_m=-0.05),
    ),
)
ALUMINIUM = replace(
    BASE,
    width_m=0.3,
    height_m=0.9,
    thickness_m=10e-3,
    youngs_modulus_pa=70e9,
    density_kg_per_m3=2700.0,
    poisson_ratio=0.33,
)
CASES = {
    "free": (replace(BASE, support="free"), PATCH),
    "circle": (replace(BASE, contact="patch", contact_radius_m=2e-3), PATCH),
    "contact off the centre": (
        replace(BASE, contact_x_m=0.1, contact_y_m=-0.05, elements_per_edge=24),
        replace(PATCH, shape="round", offset_x_m=0.02),
    ),
    "several patches": (replace(BASE, elements_per_edge=28), SEVERAL),
    "bowl": (BASE, CorrosionParameters(size_m=0.05, shape="round", profile="bowl")),
    "cosine": (BASE, CorrosionParameters(size_m=0.05, profile="cosine")),
    "wet": (replace(BASE, liquid=WATER), PATCH),
    "wet, off the centre": (
        replace(BASE, liquid=replace(WATER, depth_m=0.01), contact_x_m=0.1, elements_per_edge=24),
        replace(PATCH, shape="round"),
    ),
    "aluminium": (ALUMINIUM, replace(PATCH, size_m=0.05)),
    "hot": (replace(BASE, temperature_c=300.0), PATCH),
}


def exact_response(parts, depth, s):
    """Deflection under the load at the complex frequency s, all unknowns."""
    stiffness, mass = parts.evaluate_at_depth(depth)
    dry = splu((stiffness + s**2 * mass).tocsc())
    load = parts.load.astype(complex)
    if parts.added_mass is None:
        return load @ dry.solve(load)

    def wet(v):
        added = parts.added_mass @ v.real + 1j * (parts.added_mass @ v.imag)
        return stiffness @ v + s**2 * (mass @ v + added)

    operator = LinearOperator(stiffness.shape, matvec=wet, dtype=complex)
    first = LinearOperator(stiffness.shape, matvec=dry.solve, dtype=complex)
    solution, failed = gmres(operator, load, M=first, rtol=1e-10, restart=200, maxiter=5)
    assert not failed
    return load @ solution


@pytest.mark.parametrize("case", CASES)
def test_reduced_plate_responds_like_all_unknowns(case):
    """Laplace domain: growth rates 1/tau weigh the response over the last tau, as a shot does.

    0 to 10 kHz hold nearly all of a shot; at 20 kHz its spectrum has fallen to some per cent.
    """
    parts = build_plate(*CASES[case])
    reduction = reduce_plate(parts)
    for depth in (0.1, 0.7, 0.93):
        modes = reduction.modes(depth)
        for frequency_hz, allowed in ((0.0, 5e-6), (1e4, 5e-6), (2e4, 1e-3)):
            s = 1e4 + 2j * np.pi * frequency_hz
            exact = exact_response(parts, depth, s)
            reduced = np.sum(modes.participation**2 / (modes.omega_rad_per_s**2 + s**2))
            assert abs(reduced - exact) <= allowed * abs(exact)


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=[pytest.mark.slow] * (case in {"circle", "bowl", "cosine", "wet", "hot"}))
        for case in CASES
    ],
)
def test_shots_balance_their_energy_and_equal_those_on_a_rich_basis(case, reduction_folder):
    plate, patch = CASES[case]
    parts = build_plate(plate, patch)
    usual = ShotModel(ChainParameters(), plate, patch, cache_folder=reduction_folder, duration_s=1.2e-3)
    for depth in (0.0, 0.8):
        reduced = reduce_plate(parts, basis=((depth, 120),))
        rich = ShotModel(ChainParameters(), plate, patch, prepared_plate=reduced, duration_s=1.2e-3)
        found, expected = (model.shot(depth_fraction=depth) for model in (usual, rich))
        assert found.energy_residual <= 2e-5  # a fifth of what is demanded
        difference = np.linalg.norm(found.force_n - expected.force_n)
        # A third of the allowance for the reduction.
        assert difference <= 3e-5 * np.linalg.norm(expected.force_n)


def test_an_eccentric_patch_and_a_smooth_one_change_less(reduction_folder):
    def tof_us(**changes):
        patch = CorrosionParameters(size_m=0.04, **changes)
        model = ShotModel(ChainParameters(), BASE, patch, cache_folder=reduction_folder)
        return summarise_pulses(model.shot(depth_fraction=0.6)).tof_us

    pristine = summarise_pulses(
        ShotModel(ChainParameters(), BASE, PATCH, cache_folder=reduction_folder).shot()
    ).tof_us
    below, next_to_it, far = tof_us(), tof_us(offset_x_m=0.03), tof_us(offset_x_m=0.15)
    assert pristine < next_to_it < below
    assert far == pytest.approx(pristine, abs=0.05)
    bowl, cosine = tof_us(profile="bowl"), tof_us(profile="cosine")
    assert pristine < cosine < bowl < below  # the less is lost, the earlier the wave is back
