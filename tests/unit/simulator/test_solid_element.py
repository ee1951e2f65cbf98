"""The brick: patch test on distorted meshes, rigid bodies, bending without locking, mass."""

import numpy as np
import pytest

from simulator.errors import SpecimenError
from simulator.solid_element import CORNER_SIGNS, brick_mass, brick_stiffness, elasticity_pa

E_PA, NU = 200e9, 0.3


def grid(x, y, z):
    """Nodes of a tensor grid, shape (n, 3), and the corners of its elements, shape (elements, 8)."""
    number = np.arange(len(x) * len(y) * len(z)).reshape(len(x), len(y), len(z))
    first = number[:-1, :-1, :-1].ravel()
    steps = [i * len(y) * len(z) + j * len(z) + k for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    nodes = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=3).reshape(-1, 3)
    return nodes, first[:, None] + np.array(steps)


def assembled(nodes, elements, poisson_ratio=NU):
    stiffness = np.zeros((len(nodes) * 3, len(nodes) * 3))
    for corners, element in zip(elements, brick_stiffness(nodes[elements], E_PA, poisson_ratio), strict=True):
        dof = (3 * corners[:, None] + np.arange(3)).ravel()
        stiffness[np.ix_(dof, dof)] += element
    return stiffness


@pytest.fixture(scope="module")
def distorted():
    """A unit cube of 27 bricks, every node moved by up to a sixth of an element's edge."""
    line = np.linspace(0.0, 1.0, 4)
    nodes, elements = grid(line, line, line)
    return nodes + np.random.default_rng(4).uniform(-1.0, 1.0, nodes.shape) / 18.0, elements


def test_elasticity_gives_youngs_modulus_and_poissons_ratio():
    compliance = np.linalg.inv(elasticity_pa(E_PA, NU))
    assert compliance[0, 0] == pytest.approx(1.0 / E_PA, rel=1e-12)
    assert compliance[0, 1] == pytest.approx(-NU / E_PA, rel=1e-12)
    assert compliance[3, 3] == pytest.approx(2.6 / E_PA, rel=1e-12)


@pytest.mark.parametrize("component", range(6))
def test_patch_test_on_a_distorted_mesh(distorted, component):
    """A state of constant strain leaves inner nodes in balance and has the energy of its volume."""
    nodes, elements = distorted
    strain = np.zeros(6)
    strain[component] = 1.0
    tensor = np.diag(strain[:3])
    for value, (i, j) in zip(strain[3:], ((1, 2), (0, 2), (0, 1)), strict=True):
        tensor[i, j] = tensor[j, i] = value / 2.0
    field = nodes @ tensor
    stiffness = assembled(nodes, elements)
    forces = (stiffness @ field.ravel()).reshape(-1, 3)
    number = np.arange(64).reshape(4, 4, 4)
    inner = number[1:-1, 1:-1, 1:-1].ravel()
    # Rounding: the terms of a row cancel to machine precision of their absolute sum.
    size = (abs(stiffness) @ np.abs(field).ravel()).max()
    assert np.abs(forces[inner]).max() <= 1e-14 * size
    assert np.abs(forces).max() > 1e-3 * size  # the outer ones carry the stress

    energies = np.einsum(
        "ei,eij,ej->e",
        field[elements].reshape(len(elements), -1),
        brick_stiffness(nodes[elements], E_PA, NU),
        field[elements].reshape(len(elements), -1),
    )
    volumes = brick_mass(nodes[elements], 1.0).sum(axis=(1, 2))
    np.testing.assert_allclose(energies, volumes * elasticity_pa(E_PA, NU)[component, component], rtol=1e-12)


def test_an_element_has_six_rigid_body_modes_and_no_other_without_energy(distorted):
    nodes, elements = distorted
    for stiffness in brick_stiffness(nodes[elements], E_PA, NU):
        values = np.linalg.eigvalsh(stiffness)
        assert np.abs(values[:6]).max() <= 1e-14 * values[-1]  # rounding
        assert values[6] > 1e-3 * values[-1]


def cantilever_tip(length_elements, slenderness, forces, poisson_ratio):
    """Mean tip deflection along z of a beam one element wide and high, in units of its height."""
    x = np.linspace(0.0, slenderness, length_elements + 1)
    nodes, elements = grid(x, np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    load = np.zeros((len(nodes), 3))
    load[-4:] = forces
    root = nodes[:, 0] == 0.0
    held = np.zeros((len(nodes), 3), dtype=bool)
    held[root, 0] = True  # the section stays plane and may contract sideways
    held[0, 1:] = True
    held[2, 2] = True
    if poisson_ratio == 0.0:
        held[root] = True
    free = ~held.ravel()
    displacement = np.zeros(3 * len(nodes))
    stiffness = assembled(nodes, elements, poisson_ratio)
    displacement[free] = np.linalg.solve(stiffness[np.ix_(free, free)], load.ravel()[free])
    return displacement.reshape(-1, 3)[-4:, 2].mean()


@pytest.mark.parametrize("slenderness", [10.0, 100.0])
@pytest.mark.parametrize("length_elements", [1, 4])
def test_pure_bending_is_exact_with_one_element_through_the_height(slenderness, length_elements):
    """Euler-Bernoulli, ``M L^2 / (2 E I)``; sections stay free to curve sideways.

    All corners of a section lie equally far from its axes, so that anticlastic curvature moves them alike.
    """
    forces = np.zeros((4, 3))
    forces[:, 0] = [0.5, -0.5, 0.5, -0.5]  # z = 0 pulled, z = 1 pushed: a moment of one
    tip = cantilever_tip(length_elements, slenderness, forces, NU)
    exact = slenderness**2 / (2.0 * E_PA / 12.0)
    # Exact but for rounding: the condition number grows with the fourth power of the slenderness.
    assert tip == pytest.approx(exact, rel=1e-15 * slenderness**4)


def test_a_tip_force_converges_to_timoshenko():
    """``P L^3 / (3 E I) + P L / (kappa G A)``; without sideways contraction a clamped root is exact."""
    forces = np.zeros((4, 3))
    forces[:, 2] = 0.25
    length = 20.0
    bending = length**3 / (3.0 * E_PA / 12.0)
    errors = [cantilever_tip(n, length, forces, 0.0) / bending - 1.0 for n in (2, 4, 8, 16)]
    # In an element the deflection is parabolic and the curvature constant: a straight moment is met
    # with 1 / (4 n^2) too little deflection. A section of one element shears evenly: kappa = 1.
    shear = length / (E_PA / 2.0) / bending
    np.testing.assert_allclose(errors, [shear - 0.25 / n**2 for n in (2, 4, 8, 16)], atol=1e-10)


def test_mass_is_the_volumes_and_carries_linear_velocities_exactly():
    nodes = CORNER_SIGNS / 2.0 * np.array([1.0, 2.0, 3.0])
    mass = brick_mass(nodes[None], 7800.0)[0]
    assert mass.sum() == pytest.approx(7800.0 * 6.0, rel=1e-14)
    inertia = nodes[:, 0] @ mass @ nodes[:, 0]
    assert inertia == pytest.approx(7800.0 * 6.0 * 1.0 / 12.0, rel=1e-14)
    np.testing.assert_allclose(mass, mass.T, rtol=1e-14)


def test_an_element_turned_inside_out_is_refused():
    corners = CORNER_SIGNS.copy()
    corners[[0, 1]] = corners[[1, 0]]
    with pytest.raises(SpecimenError, match="must be positive"):
        brick_stiffness(corners[None], E_PA, NU)
