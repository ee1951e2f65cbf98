"""Mesh, thinning, supports, symmetry and the spread load of the solid plate."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from simulator.errors import SpecimenError
from simulator.numerics.tensor_basis import Axis
from simulator.parameters.plate import CorrosionParameters, PatchParameters, PlateParameters, SolidMesh
from simulator.plate.solid.integrals import (
    compute_in_plane_elasticity,
    hertz_nodal_weights,
    integrate_in_plane,
)
from simulator.plate.solid.plate import UPPER_LINES, build_solid_plate
from simulator.plate.solid.reduction import (
    compute_column_matrix,
    make_mass_product,
    make_shifted_solver,
    map_column_unknowns,
)

MESH = SolidMesh(degree=3, edge_element=0.5, contact_element=1.0, largest_element=4.0)
SMALL = PlateParameters(
    width_m=0.06, height_m=0.06, thickness_m=6e-3, contact_radius_m=1e-3, solid=MESH, model="solid"
)
PATCH = CorrosionParameters(size_m=0.02)


def assembled(plate):
    size = len(plate.load)
    stiffness, mass = np.zeros((size, size)), np.zeros((size, size))
    for column, (unknowns, fold) in enumerate(map_column_unknowns(plate)):
        for total, factors in ((stiffness, (1.0, 0.0)), (mass, (0.0, 1.0))):
            total[np.ix_(unknowns, unknowns)] += compute_column_matrix(plate, column, fold, *factors)
    return stiffness, mass


def compliance(plate, frequency_hz=0.0):
    stiffness, mass = assembled(plate)
    return plate.load @ linalg.solve(stiffness - (2 * np.pi * frequency_hz) ** 2 * mass, plate.load)


@pytest.mark.parametrize("strain", [*np.eye(6), np.array([1.0, -2.0, 3.0, 0.5, 4.0, -1.0])])
def test_patch_test_of_a_column(strain):
    """A state of constant strain has the energy of its volume, and forces on the element's faces only."""
    nu = 0.3
    x, y, z = (
        Axis(breaks_m=np.array([1.0, 1.0 + length]), degrees=(degree,))
        for length, degree in ((0.7, 3), (1.3, 4), (0.4, 3))
    )
    plate = replace(SMALL, poisson_ratio=nu)
    a, b, c, _ = compute_in_plane_elasticity(plate, integrate_in_plane(x, y, 0, 0))
    mass, slope, stiffness = z.interval_matrices(0)
    matrix = np.kron(a, mass) + np.kron(b, stiffness) + np.kron(c, slope) + np.kron(c, slope).T
    tensor = np.diag(strain[:3])
    for value, (i, j) in zip(strain[3:], ((1, 2), (0, 2), (0, 1)), strict=True):
        tensor[i, j] = tensor[j, i] = value / 2.0
    points = np.stack(np.meshgrid(x.nodes_m, y.nodes_m, z.nodes_m, indexing="ij"), axis=-1)
    field = np.moveaxis(points @ tensor, 3, 2)  # (x, y, component, z)
    forces = (matrix @ field.ravel()).reshape(field.shape)
    e = plate.youngs_modulus_pa
    law = e / 2.6 * np.diag([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    law[:3, :3] += e * nu / ((1 + nu) * (1 - 2 * nu))
    # Rounding, of terms that nearly cancel.
    assert np.sum(field * forces) == pytest.approx(strain @ law @ strain * 0.7 * 1.3 * 0.4, rel=1e-11)
    size = np.abs(forces).max()
    assert np.abs(forces[1:-1, 1:-1, :, 1:-1]).max() <= 1e-11 * size
    rigid = np.zeros_like(field)
    rigid[:, :, 0], rigid[:, :, 1] = -points[..., 1], points[..., 0]
    assert np.abs(matrix @ rigid.ravel()).max() <= 1e-11 * np.abs(matrix).max()


@pytest.mark.parametrize("depth", [0.0, 0.05, 0.37, 0.8])
def test_grid_lines_lie_on_the_patch_and_on_its_remaining_thickness(depth):
    plate = build_solid_plate(SMALL, replace(PATCH, depth_fraction=depth))
    assert 0.01 in plate.x.breaks_m
    np.testing.assert_allclose(plate.z.breaks_m[:4], (1 - depth) * 6e-3 * np.array(UPPER_LINES), rtol=1e-12)
    assert plate.z.breaks_m[-1] == pytest.approx(6e-3, rel=1e-12)
    assert np.all(np.diff(plate.z.breaks_m) > 0.0)


@pytest.mark.parametrize("shape", ["square", "round"])
def test_mass_is_that_of_the_thinned_plate(shape):
    patch = replace(PATCH, shape=shape)
    masses = [
        _upward_mass(build_solid_plate(SMALL, replace(patch, depth_fraction=depth))) for depth in (0.0, 0.5)
    ]
    lost = np.pi * 0.01**2 if shape == "round" else 0.02**2
    # The integrals over what a circle leaves are good to 1e-7 of an element.
    assert masses[0] - masses[1] == pytest.approx(7800.0 * lost * 3e-3, rel=1e-6)


def _upward_mass(plate):
    """Mass of a motion along the chain that fades to nothing in the elements at the edge."""
    moving = np.zeros(plate.numbers.shape[:3], dtype=bool)
    inner = plate.x.first[-2] + 1
    moving[:inner, :inner] = True
    numbers = plate.numbers[..., 2]
    motion = np.zeros(len(plate.load))
    motion[numbers[moving & (numbers >= 0)]] = 1.0
    return motion @ make_mass_product(plate)(motion)


def test_mass_product_is_that_of_the_assembled_mass():
    plate = build_solid_plate(SMALL, replace(PATCH, shape="round", depth_fraction=0.5))
    x = np.random.default_rng(1).normal(size=len(plate.load))
    expected = assembled(plate)[1] @ x
    np.testing.assert_allclose(make_mass_product(plate)(x), expected, atol=1e-12 * np.abs(expected).max())


def test_a_patch_over_the_whole_plate_is_a_thinner_plate():
    thinned = build_solid_plate(SMALL, CorrosionParameters(size_m=0.06, depth_fraction=0.4))
    scaled = replace(
        MESH,
        **{
            name: getattr(MESH, name) / 0.6 for name in ("edge_element", "contact_element", "largest_element")
        },
    )
    thin = build_solid_plate(
        replace(SMALL, thickness_m=3.6e-3, solid=scaled), CorrosionParameters(size_m=0.06)
    )
    # Near the edge, kinds of nodes differ with the thickness.
    assert compliance(thinned, 500.0) == pytest.approx(compliance(thin, 500.0), rel=1e-4)


@pytest.mark.parametrize("shape", ["square", "round"])
@pytest.mark.parametrize("support", ["simply_supported", "clamped"])
def test_an_eighth_a_quarter_and_the_whole_plate_are_one_model(shape, support):
    parameters = replace(SMALL, support=support, solid=replace(MESH, largest_element=6.0, edge_element=1.0))
    patch = replace(PATCH, shape=shape, depth_fraction=0.5)
    eighth, quarter, whole = (
        build_solid_plate(parameters, patch, symmetry=part) for part in ("eighth", "quarter", "none")
    )
    assert len(eighth.load) < 0.6 * len(quarter.load)
    expected = compliance(quarter, 2e3)
    # All solve the same equations; the condition number costs some digits.
    assert compliance(eighth, 2e3) == pytest.approx(expected, rel=1e-9)
    solve = make_shifted_solver(whole, 2e4)
    assert whole.load @ solve(whole.load) == pytest.approx(
        quarter.load @ make_shifted_solver(quarter, 2e4)(quarter.load), rel=1e-9
    )


def test_a_rectangle_lies_as_it_is_given():
    plate = replace(SMALL, height_m=0.05)
    along_x, along_y = (
        build_solid_plate(
            p, CorrosionParameters(shape="rectangular", size_m=a, size_y_m=b, depth_fraction=0.5)
        )
        for p, a, b in ((plate, 0.03, 0.02), (replace(plate, width_m=0.05, height_m=0.06), 0.02, 0.03))
    )
    assert compliance(along_x) == pytest.approx(compliance(along_y), rel=1e-9)


def test_a_deeper_patch_yields_more_and_clamped_edges_less():
    values = [compliance(build_solid_plate(SMALL, replace(PATCH, depth_fraction=d))) for d in (0, 0.3, 0.6)]
    assert values[0] < values[1] < values[2]
    clamped = build_solid_plate(replace(SMALL, support="clamped"), PATCH)
    assert compliance(clamped) < 0.7 * values[0]


def test_a_round_patch_is_met_more_exactly_by_smaller_elements():
    meshes = (MESH, replace(MESH, edge_element=0.25, contact_element=0.5, growth=1.0))
    patch = replace(PATCH, shape="round", depth_fraction=0.6)
    plates = [build_solid_plate(replace(SMALL, solid=mesh), patch) for mesh in meshes]
    values = [plate.load @ make_shifted_solver(plate, 0.0)(plate.load) for plate in plates]
    inner, outer = (
        compliance(build_solid_plate(SMALL, replace(patch, shape="square", size_m=side)))
        for side in (0.02 / np.sqrt(2.0), 0.02)
    )
    assert inner < values[0] < values[1] < outer
    assert values[0] == pytest.approx(values[1], rel=0.02)


def test_material_scales_stiffness_and_mass():
    usual = assembled(build_solid_plate(SMALL, PATCH))
    changed = replace(SMALL, youngs_modulus_pa=70e9, density_kg_per_m3=2700.0)
    other = assembled(build_solid_plate(changed, PATCH))
    assert np.abs(other[0] - 0.35 * usual[0]).max() <= 1e-12 * np.abs(usual[0]).max()
    assert np.abs(other[1] - 2700 / 7800 * usual[1]).max() <= 1e-12 * np.abs(usual[1]).max()
    warm = assembled(build_solid_plate(replace(SMALL, temperature_c=120.0), PATCH))
    assert np.abs(warm[0] - (1 - 0.027) * usual[0]).max() <= 1e-12 * np.abs(usual[0]).max()


def test_hertz_weights_are_a_unit_force_and_hold_its_moments():
    """Mean of ``|x|`` under Hertz's pressure: ``3 a / 8``, of ``r^2``: ``2 a^2 / 5``."""
    axis = Axis(breaks_m=np.array([0.0, 0.7e-3, 3e-3]), degrees=(3, 4))
    weights = hertz_nodal_weights(axis, axis, 2e-3, whole=False)
    at = axis.nodes_m
    assert weights.sum() == pytest.approx(1.0, rel=1e-13)
    assert weights.sum(axis=1) @ at == pytest.approx(0.75e-3, rel=1e-5)  # 48 points of a square root
    assert np.sum(weights * (at[:, None] ** 2 + at**2)) == pytest.approx(1.6e-6, rel=1e-5)


@pytest.mark.parametrize(
    ("plate", "patch", "message"),
    [
        ({}, {"size_m": 0.07}, "0.07 m wide, the plate only 0.06 m"),
        ({}, {"size_m": 1e-3}, "half the patch only 0.0005 m"),
        ({}, {"depth_fraction": 0.9}, "contact_radius_m is 0.001 m, more than the 0.0006 m"),
        ({"support": "free"}, {}, "plate.support is 'free'"),
        ({"contact_x_m": 0.01}, {}, "plate.contact_x_m is 0.01"),
        ({}, {"offset_y_m": 0.01}, "corrosion.offset_y_m is 0.01"),
        ({}, {"profile": "bowl"}, "corrosion.profile is 'bowl'"),
        ({}, {"further": (PatchParameters(offset_x_m=0.02),)}, "corrosion.further has 1 patches"),
        ({"width_m": 12.0, "height_m": 12.0}, {}, "at most 3000000 are possible: make"),
    ],
)
def test_parameters_that_the_model_does_not_support_are_refused(plate, patch, message):
    with pytest.raises(SpecimenError, match=message):
        build_solid_plate(replace(SMALL, **plate), replace(PATCH, **{"depth_fraction": 0.3, **patch}))


@pytest.mark.parametrize(
    ("change", "message"), [({"degree": 2}, "degree is 2"), ({"growth": 0.0}, "growth is 0.0")]
)
def test_mesh_out_of_bounds_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(MESH, **change)
