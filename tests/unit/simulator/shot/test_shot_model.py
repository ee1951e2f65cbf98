"""The interface of a shot: overrides, bounds, errors, threads, record length, holes."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from simulator.chain.spheres import build_chain
from simulator.errors import IntegrationError, SpecimenError
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot import model as shot_model
from simulator.shot.model import ShotModel, choose_record_duration_s
from simulator.shot.pulse_summary import summarise_pulses

CHAIN = ChainParameters()
PLATE = PlateParameters(elements_per_edge=32, contact_element_m=1e-3)
PATCH = CorrosionParameters()
WALL = PlateParameters(model="rigid_wall")


@pytest.fixture(scope="module")
def model(reduction_folder):
    return ShotModel(CHAIN, PLATE, PATCH, cache_folder=reduction_folder)


def test_a_shot_is_a_uniform_record_from_first_touch(model):
    force = model.shot()
    assert force.time_s[0] == 0.0
    np.testing.assert_allclose(np.diff(force.time_s), 0.5e-6, rtol=1e-9)
    assert force.time_s.shape == force.force_n.shape
    assert force.force_n[0] == force.preload_n
    assert force.step_s == 0.5e-6
    assert force.energy_residual <= shot_model.ENERGY_TOLERANCE


def test_overrides_equal_parameters(reduction_folder, model):
    fixed = ShotModel(
        replace(CHAIN, drop_height_m=6e-3, tilt_rad=0.02),
        PLATE,
        replace(PATCH, depth_fraction=0.4),
        cache_folder=reduction_folder,
    )
    overridden = model.shot(depth_fraction=0.4, drop_height_m=6e-3, tilt_rad=0.02)
    np.testing.assert_array_equal(fixed.shot().force_n, overridden.force_n)
    assert not np.array_equal(overridden.force_n, model.shot().force_n)


def test_depths_come_back_the_same_after_many_others(model):
    first = model.shot(depth_fraction=0.25).force_n
    for k in range(shot_model.DEPTHS_KEPT + 1):
        model.shot(depth_fraction=0.3 + 1e-3 * k)
    assert len(model._prepared) == shot_model.DEPTHS_KEPT
    np.testing.assert_array_equal(model.shot(depth_fraction=0.25).force_n, first)


def test_threads_give_what_one_thread_gives(reduction_folder, model):
    depths = np.linspace(0.0, 0.8, 12)
    alone = [model.shot(depth_fraction=d).force_n for d in depths]
    fresh = ShotModel(CHAIN, PLATE, PATCH, cache_folder=reduction_folder)
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda d: fresh.shot(depth_fraction=d).force_n, np.repeat(depths, 3)))
    for k, force in enumerate(together):
        np.testing.assert_array_equal(force, alone[k // 3])


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ({"depth_fraction": 0.96}, "depth_fraction is 0.96; it must be at most 0.95"),
        ({"depth_fraction": -0.1}, "depth_fraction is -0.1; it must be at least 0"),
        ({"depth_fraction": float("nan")}, "must be a finite number"),
        ({"drop_height_m": 0.0}, "drop_height_m is 0.0; it must be greater than 0"),
        ({"tilt_rad": 0.3}, "tilt_rad is 0.3; it must be at most 0.2"),
    ],
)
def test_overrides_obey_the_bounds_of_their_parameters(model, override, message):
    with pytest.raises(ValueError, match=message):
        model.shot(**override)


@pytest.mark.parametrize("name", ["duration_s", "step_s"])
def test_a_record_needs_a_positive_length_and_step(name):
    with pytest.raises(SpecimenError, match=f"{name} is 0.0; it must be positive"):
        ShotModel(CHAIN, WALL, PATCH, **{name: 0.0})


def test_specimens_without_a_patch_refuse_a_depth():
    with pytest.raises(SpecimenError, match="rigid_wall has no patch"):
        ShotModel(CHAIN, WALL, replace(PATCH, depth_fraction=0.1))
    with pytest.raises(SpecimenError, match="infinite_kirchhoff has no patch"):
        ShotModel(CHAIN, PlateParameters(model="infinite_kirchhoff"), PATCH).shot(depth_fraction=0.1)


def test_energy_that_does_not_balance_is_an_error_not_a_number():
    with pytest.raises(IntegrationError, match="energy balance is off"):
        ShotModel(CHAIN, WALL, PATCH, energy_tolerance=1e-12).shot()


def test_a_diverging_shot_is_an_error_not_a_number():
    """A step of 0.4 ms cannot follow a contact of 0.1 ms, nor can a sixteenth of it."""
    with pytest.raises(IntegrationError, match="energy balance is off by"):
        ShotModel(CHAIN, WALL, PATCH, step_s=4e-4, duration_s=4e-2).shot()


def test_a_coarse_step_is_halved_until_energy_balances():
    coarse = ShotModel(CHAIN, WALL, PATCH, step_s=5e-6, duration_s=1e-3).shot()
    assert coarse.step_s < 5e-6
    assert coarse.energy_residual <= shot_model.ENERGY_TOLERANCE
    np.testing.assert_allclose(np.diff(coarse.time_s), 5e-6, rtol=1e-9)


def test_hole_has_the_same_isw_and_no_reflected_wave(model):
    hole, solid = model.shot(through_hole=True), model.shot()
    assert hole.preload_n == solid.preload_n
    assert hole.reflection_time_s is None
    assert hole.energy_residual <= shot_model.ENERGY_TOLERANCE
    # Nothing is known before the wave has been to the plate; its foremost tail decays exponentially.
    early = hole.time_s < 200e-6
    np.testing.assert_allclose(hole.force_n[early], solid.force_n[early], atol=1e-6)
    assert np.max(hole.force_n[hole.time_s > 420e-6]) < 0.05 * np.max(hole.force_n)
    assert summarise_pulses(hole).psw_time_us is None
    assert summarise_pulses(hole).isw_peak_n == pytest.approx(summarise_pulses(solid).isw_peak_n, rel=1e-9)


def test_record_length_is_taken_as_given(reduction_folder):
    force = ShotModel(CHAIN, PLATE, PATCH, duration_s=0.3e-3, cache_folder=reduction_folder).shot()
    assert force.time_s[-1] == pytest.approx(0.3e-3, rel=1e-12)


@pytest.mark.parametrize(
    "chain",
    [
        ChainParameters(spheres_above=12, spheres_below=25),
        ChainParameters(spheres_above=1, spheres_below=20),
        ChainParameters(spheres_above=1, spheres_below=1),
        ChainParameters(youngs_modulus_pa=3e9, mass_kg=4e-3, sensor_mass_kg=5e-3),
        ChainParameters(radius_m=2.4e-3, mass_kg=0.45e-3, sensor="sphere"),
    ],
    ids=["long", "sensor on top", "three bodies", "polymer", "small"],
)
def test_a_record_of_automatic_length_holds_the_reflected_wave(chain):
    force = ShotModel(chain, WALL, PATCH).shot()
    found = summarise_pulses(force)
    assert 0.5 < found.amplitude_ratio < 1.0
    # Down and back takes at least as long as the contacts passed twice, at most a little more.
    assert 2.0 * (1e6 * force.reflection_time_s - found.isw_time_us) == pytest.approx(found.tof_us, rel=0.2)


def test_length_estimated_from_the_chain_leaves_room_behind_the_reflected_wave():
    assert choose_record_duration_s(build_chain(CHAIN, WALL)) == 1.4e-3
    long = ChainParameters(spheres_above=12, spheres_below=25)
    estimate = choose_record_duration_s(build_chain(long, WALL))
    psw_time_us = summarise_pulses(ShotModel(long, WALL, PATCH).shot()).psw_time_us
    assert 2.0 < 1e6 * estimate / psw_time_us < 3.0  # 2.5 times the estimated way there and back


def test_a_soft_patch_gets_a_longer_record(model):
    deep = model.shot(depth_fraction=0.95)
    assert deep.time_s[-1] > model.shot().time_s[-1]
    assert summarise_pulses(deep).psw_time_us > 1400.0


def test_work_goes_on_where_no_machine_code_can_be_kept(tmp_path):
    """Numba finds no folder to cache in: an unwritable package and no home."""
    code = (
        "import numba.core.caching as c\n"
        "c.CacheImpl._locator_classes = []\n"
        "import simulator.shot.kernel as k\n"
        "assert k.compile_time_loop(2, True).__class__.__name__ == 'CPUDispatcher'\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, cwd=tmp_path, timeout=120)
