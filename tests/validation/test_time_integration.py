"""Order of accuracy in time, energy, and limits that have exact answers."""

import numpy as np
import pytest

from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import ShotModel

PATCH = CorrosionParameters()
WALL = PlateParameters(model="rigid_wall")
THIN = PlateParameters(model="infinite_kirchhoff")
DURATION_S = 1.2e-3
STEPS_S = (1e-6, 5e-7, 2.5e-7, 1.25e-7)
REFERENCE_STEP_S = 3.125e-8


def shot(chain, plate, step_s, folder=None, depth=0.0, patch=PATCH):
    model = ShotModel(chain, plate, patch, duration_s=DURATION_S, cache_folder=folder, step_s=step_s)
    force = model.shot(depth_fraction=depth)
    assert force.step_s == step_s, "the step was halved: no study of convergence"
    return force


def slope(steps_s, errors):
    return np.polyfit(np.log(steps_s), np.log(errors), 1)[0]


def waveform_errors(chain, plate, steps_s, folder=None, depth=0.0, patch=PATCH):
    reference = shot(chain, plate, REFERENCE_STEP_S, folder, depth, patch).force_n
    errors = []
    for step_s in steps_s:
        thinned = reference[:: round(step_s / REFERENCE_STEP_S)]
        force = shot(chain, plate, step_s, folder, depth, patch).force_n
        errors.append(np.linalg.norm(force - thinned) / np.linalg.norm(thinned))
    return np.array(errors)


@pytest.mark.parametrize(
    ("chain", "plate"),
    [
        (ChainParameters(), WALL),
        (ChainParameters(sensor="sphere"), WALL),
        (ChainParameters(), THIN),
        (ChainParameters(damping_n_s_per_m=0.0, contact_damping_n_s_per_m=0.0), WALL),
    ],
    ids=["disk, wall", "sphere, wall", "disk, thin plate", "no dashpots"],
)
def test_waveform_converges_with_order_two_or_better(chain, plate):
    """Fourth order between events; the kink of [d]_+ at touch and release allows two."""
    errors = waveform_errors(chain, plate, STEPS_S)
    assert slope(STEPS_S, errors) > 2.0
    assert errors[STEPS_S.index(5e-7)] < 5e-6  # the default step: a twentieth of the allowance


@pytest.mark.parametrize("depth", [0.0, 0.4, 0.8])
def test_waveform_on_the_papers_plate_converges(reduction_folder, depth):
    errors = waveform_errors(ChainParameters(), PlateParameters(), STEPS_S, reduction_folder, depth)
    assert slope(STEPS_S, errors) > 1.9
    assert errors[1] < 1e-5


@pytest.mark.parametrize("plate", [WALL, THIN], ids=["wall", "thin plate"])
def test_energy_residual_falls_with_order_two(plate):
    """The dashpots' loss, ``gamma (d[d]_+)(dd) / h`` a step, is a mid-point rule."""
    residuals = [shot(ChainParameters(), plate, step_s).energy_residual for step_s in STEPS_S]
    assert slope(STEPS_S, residuals) == pytest.approx(2.0, abs=0.4)  # ragged: where events fall in a step
    assert residuals[1] < 2e-5


def test_without_dashpots_energy_is_conserved_to_higher_order():
    chain = ChainParameters(damping_n_s_per_m=0.0, contact_damping_n_s_per_m=0.0)
    residuals = [shot(chain, WALL, step_s).energy_residual for step_s in STEPS_S]
    # The kink of d^(3/2) allows 5/2; ragged, because few events fall anywhere in a step.
    assert slope(STEPS_S, residuals) == pytest.approx(2.5, abs=0.5)
    assert residuals[-1] < 1e-6


def test_a_chain_that_is_never_struck_hard_stays_in_equilibrium():
    """Striker released from a nanometre: everything but the first tail stays at the preload."""
    chain = ChainParameters(drop_height_m=1e-12)
    force = ShotModel(chain, WALL, PATCH, duration_s=5e-5, step_s=5e-7).shot()
    np.testing.assert_allclose(force.force_n, force.preload_n, rtol=1e-3)
