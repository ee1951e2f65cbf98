"""A strong dashpot at the plate: every depth is computed, and agrees with an independent integration."""

import numpy as np
import pytest

from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import ENERGY_TOLERANCE, ShotModel

PAPER = PlateParameters()
ALUMINIUM_1_MM = PlateParameters(
    thickness_m=1e-3, youngs_modulus_pa=70e9, poisson_ratio=0.33, density_kg_per_m3=2700.0
)
SIZES_M = (25.4e-3, 50.8e-3)
DURATION_S = 1.4e-3
STEP_S = 0.5e-6
DEPTHS = (*(k / 20 for k in range(20)), 0.2375, 0.475, 0.7125)


def strong(contact_damping_n_s_per_m):
    return ChainParameters(contact_damping_n_s_per_m=contact_damping_n_s_per_m)


def relative_l2(values, reference):
    return np.linalg.norm(values - reference) / np.linalg.norm(reference)


DASHPOTS = {
    "1e3": (1e3, PAPER, 50.8e-3),
    "3e3": (3e3, PAPER, 25.4e-3),
    "1e4": (1e4, PAPER, 50.8e-3),
    "1e5": (1e5, PAPER, 25.4e-3),
    "34, 1 mm aluminium": (34.05, ALUMINIUM_1_MM, 50.8e-3),
    "1e4, 1 mm aluminium": (1e4, ALUMINIUM_1_MM, 25.4e-3),
}
"""Each with the patch that the default run takes; the slow run takes the other one, too."""


@pytest.mark.parametrize(
    ("gamma", "plate", "size_m"),
    [
        pytest.param(
            gamma, plate, size_m, id=f"{name}-{size_m}", marks=[pytest.mark.slow] * (size_m != default_m)
        )
        for name, (gamma, plate, default_m) in DASHPOTS.items()
        for size_m in SIZES_M
    ],
)
def test_every_depth_gives_a_converged_shot(reduction_folder, gamma, plate, size_m):
    """Half the step changes the waveform by less than the allowance of 1e-4."""
    whole, half = (
        ShotModel(
            strong(gamma),
            plate,
            CorrosionParameters(size_m=size_m),
            duration_s=DURATION_S,
            cache_folder=reduction_folder,
            step_s=step_s,
        )
        for step_s in (STEP_S, STEP_S / 2)
    )
    for depth in DEPTHS:
        force = whole.shot(depth_fraction=depth)
        assert force.energy_residual <= ENERGY_TOLERANCE
        assert relative_l2(force.force_n, half.shot(depth_fraction=depth).force_n[::2]) < 1e-4, depth
        if gamma <= 1e3:
            assert force.step_s == STEP_S, "a dashpot the paper uses must not cost a smaller step"
