"""Shots side by side: each has, to the last bit, what it has alone."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.chain.spheres import Contacts
from simulator.errors import IntegrationError
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.kernel import WIDEST
from simulator.shot.model import Impact, ShotModel

PLATE = PlateParameters(elements_per_edge=32, contact_element_m=1e-3)
PATCH = CorrosionParameters()
SEATS = [
    Contacts(
        stiffness_factor=1.0 + 0.05 * np.sin(np.arange(9.0) + k),
        damping_factor=1.0 + 0.5 * np.cos(np.arange(9.0) * k),
    )
    for k in range(40)
]
IMPACTS = [
    Impact(
        depth_fraction=(0.0, 0.45, 0.8)[k % 3],
        drop_height_m=3e-3 + 2e-4 * k,
        tilt_rad=None if k % 4 == 0 else 1e-3 * k,
        through_hole=k % 7 == 6,
        contacts=SEATS[k] if k % 5 > 1 else None,
        plate_modulus_factor=1.0 if k % 2 else 0.99,
    )
    for k in range(40)
]


@pytest.fixture(scope="module")
def model(reduction_folder):
    return ShotModel(ChainParameters(), PLATE, PATCH, cache_folder=reduction_folder)


def same(a, b):
    np.testing.assert_array_equal(a.force_n, b.force_n)
    assert (a.energy_residual, a.step_s, a.preload_n) == (b.energy_residual, b.step_s, b.preload_n)
    assert a.reflection_time_s == b.reflection_time_s


def alone(model, impact):
    return model.shots([impact])[0]


def test_a_shot_in_a_batch_has_the_bits_that_it_has_alone(model):
    singles = [alone(model, impact) for impact in IMPACTS]
    for found, single in zip(model.shots(IMPACTS), singles, strict=True):
        same(found, single)
    # In other company, in another order, in groups that fill no pass.
    for found, single in zip(model.shots(IMPACTS[::-1]), singles[::-1], strict=True):
        same(found, single)
    for count in (1, 2, 3, WIDEST - 1, WIDEST + 1):
        for found, single in zip(model.shots(IMPACTS[:count]), singles, strict=False):
            same(found, single)


@pytest.mark.parametrize(
    "law",
    [
        "linear",
        "hunt_crossley",
        *(pytest.param(law, marks=pytest.mark.slow) for law in ("tsuji", "kuwabara_kono")),
    ],
)
def test_a_shot_in_a_batch_equals_it_alone_under_every_law_of_damping(law):
    chain = ChainParameters(damping_law=law, damping_n_s_per_m=30.0, spheres_above=2, precompression_n=3.0)
    model = ShotModel(chain, PlateParameters(model="infinite_kirchhoff"), PATCH, duration_s=6e-4)
    impacts = [Impact(drop_height_m=h) for h in np.linspace(1e-3, 9e-3, 6)]
    for found, impact in zip(model.shots(impacts, contact_forces=True), impacts, strict=True):
        single = model.shot(drop_height_m=impact.drop_height_m, contact_forces=True)
        same(found, single)
        np.testing.assert_array_equal(found.contact_force_n, single.contact_force_n)


def test_shots_that_need_more_are_treated_by_themselves(model):
    """A deep patch is recorded longer; a coarse step is halved for those only whose energy asks for it."""
    impacts = [Impact(depth_fraction=0.95, drop_height_m=h) for h in np.linspace(4e-3, 6e-3, 5)]
    for found, impact in zip(model.shots(impacts), impacts, strict=True):
        same(found, alone(model, impact))
        assert found.time_s[-1] > 1.4e-3
    coarse = ShotModel(
        ChainParameters(), PlateParameters(model="rigid_wall"), PATCH, step_s=2e-6, duration_s=8e-4
    )
    impacts = [Impact(drop_height_m=h) for h in np.geomspace(1e-6, 0.9, 12)]
    forces = coarse.shots(impacts)
    assert len({force.step_s for force in forces}) > 1
    for found, impact in zip(forces, impacts, strict=True):
        same(found, alone(coarse, impact))


def test_no_strikes_give_no_shots(model):
    assert model.shots([]) == []


def test_one_bad_strike_is_an_error_of_the_batch(reduction_folder, model):
    with pytest.raises(ValueError, match=r"depth_fraction is 0.99; it must be at most 0.95"):
        model.shots([Impact(), Impact(depth_fraction=0.99)])
    strict = ShotModel(ChainParameters(), PLATE, PATCH, cache_folder=reduction_folder, energy_tolerance=1e-12)
    with pytest.raises(IntegrationError, match="energy balance is off by"):
        strict.shots([Impact(), Impact(drop_height_m=4e-3)])


def test_another_chain_on_the_same_plate_equals_a_model_of_its_own(reduction_folder, model):
    for changes in (
        {"contact_damping_n_s_per_m": 300.0},
        {"spheres_below": 7},
        {"radius_m": 1e-3, "mass_kg": 33e-6, "sensor": "sphere"},  # needs a smaller step
    ):
        chain = replace(ChainParameters(), **changes)
        own = ShotModel(chain, PLATE, PATCH, cache_folder=reduction_folder)
        same(model.with_chain(chain).shot(depth_fraction=0.3), own.shot(depth_fraction=0.3))
    same(model.with_chain(ChainParameters()).shot(), model.shot())
