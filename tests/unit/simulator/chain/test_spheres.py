"""Hertz constants, static equilibrium and the sensor of the chain."""

import math
from dataclasses import replace

import numpy as np
import pytest

from simulator.chain.hertz_contact import (
    Surface,
    contact_stiffness,
    indentation_m,
    sphere_on_flat_stiffness,
    sphere_on_sphere_stiffness,
)
from simulator.chain.spheres import build_chain, tilted_damping
from simulator.parameters.chain import ChainParameters, SphereParameters
from simulator.parameters.plate import PlateParameters

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


STEEL = Surface(radius_m=9.525e-3, youngs_modulus_pa=200e9, poisson_ratio=0.3)
BRASS = Surface(radius_m=4e-3, youngs_modulus_pa=103e9, poisson_ratio=0.34)


def test_contact_of_unlike_spheres_by_hertz():
    # By hand: R = 2.81700e-3 m, compliance 4.55e-12 + 0.8844 / 103e9 = 1.31364e-11 1/Pa.
    assert contact_stiffness(STEEL, BRASS) == pytest.approx(5.38710e9, rel=1e-5)
    assert contact_stiffness(STEEL, BRASS) == pytest.approx(contact_stiffness(BRASS, STEEL), rel=1e-15)


def test_contact_of_nearly_equal_spheres_is_that_of_equal_ones():
    nearly = replace(STEEL, radius_m=STEEL.radius_m * (1.0 + 1e-13))
    assert contact_stiffness(STEEL, nearly) == pytest.approx(contact_stiffness(STEEL, STEEL), rel=1e-12)
    flat = replace(STEEL, radius_m=math.inf)
    wide = replace(STEEL, radius_m=1e12)
    assert contact_stiffness(STEEL, wide) == pytest.approx(contact_stiffness(STEEL, flat), rel=1e-12)
    assert contact_stiffness(flat, BRASS) == contact_stiffness(BRASS, flat)


def test_two_flats_have_no_contact_of_hertz():
    flat = replace(STEEL, radius_m=math.inf)
    with pytest.raises(ValueError, match="two flat faces touch"):
        contact_stiffness(flat, replace(flat, poisson_ratio=0.2))


def test_spheres_described_one_by_one_are_the_uniform_chain():
    all_alike = SphereParameters(
        body=0, last_body=8, radius_m=9.525e-3, mass_kg=28.2e-3, youngs_modulus_pa=200e9, poisson_ratio=0.3
    )
    uniform, described = (build_chain(replace(SPHERE, spheres=s), PLATE) for s in ((), (all_alike,)))
    for name in ("mass_kg", "stiffness_n_per_m15", "static_force_n", "static_overlap_m"):
        np.testing.assert_array_equal(getattr(uniform, name), getattr(described, name))


def test_a_described_sphere_changes_its_own_contacts():
    chain = build_chain(replace(DISK, spheres=(SphereParameters(body=2, radius_m=4e-3),)), PLATE)
    plain = build_chain(DISK, PLATE)
    assert np.flatnonzero(chain.stiffness_n_per_m15 != plain.stiffness_n_per_m15).tolist() == [1, 2]
    # The density stays that of the chain's other spheres.
    assert chain.mass_kg[2] == pytest.approx(28.2e-3 * (4 / 9.525) ** 3, rel=1e-14)
    lead = SphereParameters(body=8, density_kg_per_m3=11340.0, youngs_modulus_pa=16e9)
    chain = build_chain(replace(DISK, spheres=(lead,)), PLATE)
    assert chain.mass_kg[8] == pytest.approx(11340.0 * 4 / 3 * math.pi * 9.525e-3**3, rel=1e-14)
    assert chain.stiffness_n_per_m15[-1] == sphere_on_flat_stiffness(9.525e-3, 16e9, 0.3, 200e9, 0.3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"spheres": (SphereParameters(body=9),)}, "describes body 9; the chain has bodies 0 to 8"),
        ({"spheres": (SphereParameters(body=1, last_body=3), SphereParameters(body=3))}, "body 3 twice"),
        ({"spheres": (SphereParameters(body=4, radius_m=1e-2),)}, "the sensor disk; set sensor_mass_kg"),
        ({"spheres": (SphereParameters(body=2, radius_m=1e-4, mass_kg=1.0),)}, "mass_kg of body 2 is 1.0"),
        ({"spheres_below": 0}, "a flat disk on a flat plate has no contact"),
        ({"precompression_n": -1.0}, "precompression_n is -1.0; it must be at least 0"),
        ({"damping_reference_overlap_m": 0.0}, "damping_reference_overlap_m is 0.0; it must be at least"),
        (
            {"temperature_c": 900.0, "youngs_modulus_change_per_k": -2e-3},
            "at temperature_c = 900.0; at least 100000 Pa",
        ),
    ],
)
def test_impossible_chains_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        replace(DISK, **changes)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"body": 3, "last_body": 2}, "last_body is 2; it must be at least body = 3"),
        ({"body": 3, "mass_kg": 0.1, "density_kg_per_m3": 7800.0}, "give one of them"),
        ({"body": -1}, "body is -1; it must be at least 0"),
        ({"body": 1, "radius_m": 0.0}, "radius_m is 0.0; it must be greater than 0"),
        ({"body": 1, "youngs_modulus_pa": math.nan}, "youngs_modulus_pa is nan; it must be a finite number"),
    ],
)
def test_descriptions_of_spheres_obey_their_bounds(keys, message):
    with pytest.raises(ValueError, match=message):
        SphereParameters(**keys)


def test_precompression_presses_every_contact_below_the_striker():
    plain, pressed = (build_chain(replace(DISK, precompression_n=p), PLATE) for p in (0.0, 30.0))
    np.testing.assert_allclose(pressed.static_force_n - plain.static_force_n, [0.0] + 8 * [30.0], rtol=1e-14)
    held = pressed.stiffness_n_per_m15 * pressed.static_overlap_m**1.5
    np.testing.assert_allclose(held, pressed.static_force_n, rtol=1e-13)


def test_a_warm_chain_is_softer_and_at_20_degrees_nothing_changes():
    steep = replace(DISK, youngs_modulus_change_per_k=-1e-3)
    np.testing.assert_array_equal(
        build_chain(steep, PLATE).stiffness_n_per_m15, build_chain(DISK, PLATE).stiffness_n_per_m15
    )
    # 80 K above the reference at the handbook's -2.7e-4 a kelvin.
    warm = build_chain(replace(DISK, temperature_c=100.0), PLATE)
    cold = build_chain(replace(DISK, youngs_modulus_pa=200e9 * (1 - 80 * 2.7e-4)), PLATE)
    np.testing.assert_allclose(warm.stiffness_n_per_m15, cold.stiffness_n_per_m15, rtol=1e-14)
    assert warm.stiffness_n_per_m15[0] / build_chain(DISK, PLATE).stiffness_n_per_m15[0] == pytest.approx(
        0.9784, rel=1e-12
    )


def test_worn_contacts_keep_the_masses():
    mixed = (SphereParameters(body=2, radius_m=7e-3), SphereParameters(body=6, density_kg_per_m3=4500.0))
    new = replace(DISK, spheres=mixed)
    before, after = build_chain(new, PLATE), build_chain(new.with_worn_contacts(1.44), PLATE)
    np.testing.assert_allclose(after.mass_kg, before.mass_kg, rtol=1e-14)
    np.testing.assert_allclose(after.stiffness_n_per_m15, 1.2 * before.stiffness_n_per_m15, rtol=1e-14)


def test_a_warm_plate_softens_its_contact():
    warm = build_chain(SPHERE, replace(PLATE, temperature_c=120.0, youngs_modulus_change_per_k=-1e-3))
    expected = sphere_on_flat_stiffness(9.525e-3, 200e9, 0.3, 180e9, 0.3)
    assert warm.stiffness_n_per_m15[-1] == pytest.approx(expected, rel=1e-14)
    np.testing.assert_array_equal(
        warm.stiffness_n_per_m15[:-1], build_chain(SPHERE, PLATE).stiffness_n_per_m15[:-1]
    )
