"""Pressures of Hertz in the contacts of a shot, and the pressure of first yield."""

import math
from dataclasses import replace

import numpy as np
import pytest

from simulator.chain.contact_pressure import peak_pressure_pa, peak_pressures_pa, yield_pressures_pa
from simulator.chain.hertz_contact import Surface, combined_radius_m, contact_stiffness
from simulator.parameters.chain import ChainParameters, SphereParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import ShotModel

STEEL = Surface(radius_m=9.525e-3, youngs_modulus_pa=200e9, poisson_ratio=0.3)
FLAT = replace(STEEL, radius_m=math.inf)
BRASS = Surface(radius_m=4e-3, youngs_modulus_pa=103e9, poisson_ratio=0.34)
BALL = SphereParameters(body=2, radius_m=6e-3, youngs_modulus_pa=110e9, poisson_ratio=0.34)
CHAIN, PLATE = ChainParameters(spheres=(BALL,)), PlateParameters(youngs_modulus_pa=70e9, poisson_ratio=0.33)


def hertz_pa(force_n, above, below):
    """Return p0 by Johnson's equation 4.24, from moduli and radii alone."""
    modulus = 1.0 / sum((1.0 - side.poisson_ratio**2) / side.youngs_modulus_pa for side in (above, below))
    curvature = 1.0 / above.radius_m + 1.0 / below.radius_m
    return (6.0 * force_n * modulus**2 * curvature**2 / math.pi**3) ** (1.0 / 3.0)


@pytest.mark.parametrize("pair", [(STEEL, FLAT), (FLAT, STEEL), (STEEL, STEEL), (STEEL, BRASS)])
def test_the_pressure_is_that_of_hertz(pair):
    pressure_pa = peak_pressure_pa(250.0, contact_stiffness(*pair), combined_radius_m(*pair))
    assert pressure_pa == pytest.approx(hertz_pa(250.0, *pair), rel=1e-12)


@pytest.mark.parametrize("force_n", [0.0, -0.5])
def test_a_contact_without_force_has_no_pressure(force_n):
    assert peak_pressure_pa(force_n, 1e10, 5e-3) == 0.0


def test_the_papers_array_presses_with_less_than_two_gigapascals_on_its_plate():
    chain, plate = ChainParameters(), PlateParameters()
    force = ShotModel(chain, plate, CorrosionParameters()).shot(contact_forces=True)
    found = peak_pressures_pa(chain, plate, force.contact_force_n)
    # By hand: 252.87 N on a circle of (3 * 252.87 * 9.525e-3 / (4 * 1.0989e11))^(1/3) = 0.25426 mm.
    assert found[-1] == pytest.approx(1.8675e9, rel=1e-3)
    assert found[:-1].argmax() == 0, "the striker presses hardest"


def test_each_contact_has_its_own_pair_and_the_strongest_force_of_its_history():
    force = ShotModel(CHAIN, PLATE, CorrosionParameters()).shot(contact_forces=True)
    strongest_n = force.contact_force_n.max(axis=1)
    steel, plate = replace(STEEL), replace(FLAT, youngs_modulus_pa=70e9, poisson_ratio=0.33)
    ball = Surface(radius_m=6e-3, youngs_modulus_pa=110e9, poisson_ratio=0.34)
    bodies = [steel, steel, ball, steel, FLAT, steel, steel, steel, steel, plate]
    expected = [hertz_pa(f, *pair) for f, *pair in zip(strongest_n, bodies, bodies[1:], strict=False)]
    found = peak_pressures_pa(CHAIN, PLATE, force.contact_force_n)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_precompression_counts_in_the_pressure():
    pressed = replace(ChainParameters(), precompression_n=50.0)
    static_n = np.zeros((pressed.bodies, 1))
    static_n[1:] = 50.0
    found = peak_pressures_pa(pressed, PlateParameters(), static_n)
    assert found[0] == 0.0
    assert found[-1] == pytest.approx(hertz_pa(50.0, STEEL, FLAT), rel=1e-12)


def test_the_softer_body_of_a_contact_yields_first():
    soft = SphereParameters(body=1, last_body=2, yield_strength_pa=1e9)
    found = yield_pressures_pa(ChainParameters(spheres=(soft,)), PlateParameters(yield_strength_pa=3e9))
    assert found.tolist() == pytest.approx([1.6e9, 1.6e9, 1.6e9, *[3.04e9] * 6], rel=1e-15)
    assert yield_pressures_pa(ChainParameters(), PlateParameters())[-1] == pytest.approx(4e8, rel=1e-15)
