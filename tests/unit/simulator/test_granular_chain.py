"""Hertz constants, static equilibrium and the sensor of the chain."""

import math
from dataclasses import replace

import numpy as np
import pytest

from simulator.chain_parameters import ChainParameters
from simulator.granular_chain import build_chain, tilted_damping
from simulator.hertz_contact import indentation_m, sphere_on_flat_stiffness, sphere_on_sphere_stiffness
from simulator.plate_parameters import PlateParameters

PLATE = PlateParameters()
SPHERE = ChainParameters(sensor="sphere")
DISK = ChainParameters(sensor="disk")


def test_contact_stiffness_of_the_papers_spheres():
    # Equation 2 by hand (bracket to the power -1): 200e9 / 2.73 * 0.138022; twice 200e9 * 0.0975961 / 2.73.
    assert sphere_on_sphere_stiffness(9.525e-3, 200e9, 0.3) == pytest.approx(1.01115e10, rel=1e-5)
    assert sphere_on_flat_stiffness(9.525e-3, 200e9, 0.3, 200e9, 0.3) == pytest.approx(1.42998e10, rel=1e-5)


def test_a_softer_flat_softens_the_contact():
    steel = sphere_on_flat_stiffness(9.525e-3, 200e9, 0.3, 200e9, 0.3)
    rigid = sphere_on_flat_stiffness(9.525e-3, 200e9, 0.3, 1e30, 0.3)
    assert rigid == pytest.approx(2.0 * steel, rel=1e-12)  # half of the compliance was the flat's


def test_indentation_inverts_hertz():
    assert 1.43e10 * indentation_m(2.2, 1.43e10) ** 1.5 == pytest.approx(2.2, rel=1e-14)
    assert indentation_m(0.0, 1.43e10) == 0.0


@pytest.mark.parametrize("parameters", [SPHERE, DISK], ids=["sphere", "disk"])
def test_bodies_below_the_striker_are_in_equilibrium(parameters):
    chain = build_chain(parameters, PLATE)
    pressed = chain.stiffness_n_per_m15 * chain.static_overlap_m**1.5
    np.testing.assert_allclose(pressed, chain.static_force_n, rtol=1e-13)
    net = pressed[:-1] - pressed[1:] + chain.mass_kg[1:] * 9.81
    np.testing.assert_allclose(net, 0.0, atol=1e-14)
    assert chain.static_overlap_m[0] == 0.0
    assert len(chain.mass_kg) == 9


def test_preload_is_the_weight_above_the_middle_of_the_sensor():
    assert build_chain(SPHERE, PLATE).preload_n == pytest.approx(3.5 * 28.2e-3 * 9.81, rel=1e-14)
    assert build_chain(DISK, PLATE).preload_n == pytest.approx(
        (3 * 28.2e-3 + 0.5 * 26.9e-3) * 9.81, rel=1e-14
    )


def test_without_gravity_nothing_is_pressed_but_the_striker_still_falls():
    chain = build_chain(replace(DISK, gravity_m_per_s2=0.0), PLATE)
    assert not chain.static_overlap_m.any()
    assert chain.impact_speed_m_per_s == math.sqrt(2 * 9.81 * 5e-3)


def test_the_disk_changes_its_mass_and_faces_only():
    sphere, disk = build_chain(SPHERE, PLATE), build_chain(DISK, PLATE)
    assert np.flatnonzero(sphere.mass_kg != disk.mass_kg).tolist() == [4]
    assert np.flatnonzero(sphere.stiffness_n_per_m15 != disk.stiffness_n_per_m15).tolist() == [3, 4]
    assert disk.mass_kg[4] == 26.9e-3


def test_sensor_place_and_numbers_of_spheres_are_free():
    chain = build_chain(ChainParameters(spheres_above=2, spheres_below=7), PLATE)
    assert len(chain.mass_kg) == 10
    assert chain.sensor == 2
    assert chain.damping_n_s_per_m.tolist() == [4.5] * 9 + [34.05]


def test_tilt_adds_damping_at_the_sensors_faces_only():
    upright, tilted = build_chain(DISK, PLATE), build_chain(replace(DISK, tilt_rad=0.02), PLATE)
    assert np.flatnonzero(upright.damping_n_s_per_m != tilted.damping_n_s_per_m).tolist() == [3, 4]
    assert tilted.damping_n_s_per_m[3] == tilted_damping(4.5, 0.02) > 4.5
    np.testing.assert_array_equal(upright.static_force_n, tilted.static_force_n)
    assert tilted_damping(4.5, 0.0) == 4.5
