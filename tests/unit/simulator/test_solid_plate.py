"""Mesh, thinning, supports, symmetry and the spread load of the solid plate."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from simulator import solid_plate
from simulator.errors import SpecimenError
from simulator.plate_parameters import CorrosionParameters, PlateParameters
from simulator.plate_reduction import PlateModes
from simulator.solid_plate import (
    SolidMesh,
    assemble_solid,
    build_solid_plate,
    capped_half_edge,
    hertz_nodal_weights,
    passive_modes,
    solid_modes,
)

SMALL = PlateParameters(width_m=0.06, height_m=0.05, thickness_m=6e-3)
PATCH = CorrosionParameters(size_m=0.02)
MESH = SolidMesh(elements_per_edge=10, layers=3, contact_element_m=1.5e-3, contact_radius_m=2e-3, growth=2.5)


def compliance(plate, frequency_hz=0.0):
    dynamic = (plate.stiffness - (2 * np.pi * frequency_hz) ** 2 * plate.mass).toarray()
    return plate.load @ linalg.solve(dynamic, plate.load)


@pytest.mark.parametrize("edge_m", [12.7e-3, 25.4e-3, 0.1, 0.3048])
def test_elements_grow_up_to_one_size_and_a_line_lies_on_the_patch(edge_m):
    mesh = SolidMesh()
    lines = capped_half_edge(0.3048, mesh, edge_m)
    sizes = np.diff(lines)
    assert len(sizes) == mesh.elements_per_edge // 2
    assert lines[0] == 0.0
    assert lines[-1] == 0.3048
    assert edge_m in lines
    # Moving a line to the patch changes sizes by part of an element, spread over all lines between.
    assert sizes[0] == pytest.approx(mesh.contact_element_m, rel=0.13)
    assert sizes.max() < 2.0 * 0.3048 / len(sizes)
    assert np.all(sizes[1:] / sizes[:-1] < 1.25 * mesh.growth)
    assert np.all(sizes[1:] / sizes[:-1] > 0.75)


@pytest.mark.parametrize("edge_m", [3e-4, 1e-3, 0.3, 0.3047])
def test_a_patch_near_the_contact_or_the_edge_gets_its_line_too(edge_m):
    lines = capped_half_edge(0.3048, SolidMesh(), edge_m)
    assert edge_m in lines
    assert np.all(np.diff(lines) > 0.0)


@pytest.mark.parametrize("depth", [0.0, 0.05, 0.37, 0.6])
def test_grid_lines_lie_on_the_patch_and_on_its_remaining_thickness(depth):
    plate = build_solid_plate(SMALL, replace(PATCH, depth_fraction=depth), MESH)
    assert np.min(np.abs(plate.x_m - 0.01)) < 1e-12
    assert np.min(np.abs(plate.y_m - 0.01)) < 1e-12
    assert np.min(np.abs(plate.z_m - (1 - depth) * 6e-3)) < 1e-12
    assert plate.z_m[-1] == 6e-3
    # The contact is resolved alike at any depth.
    assert np.sum(plate.z_m <= (1 - depth) * 6e-3 * (1 + 1e-9)) == MESH.layers + 1
    assert plate.z_m[1] == pytest.approx(MESH.contact_element_m, rel=1e-9)
    assert np.all(np.diff(plate.z_m) > 0.0)


def test_elements_below_the_patch_are_gone_and_their_nodes_with_them():
    plate = build_solid_plate(SMALL, replace(PATCH, depth_fraction=0.4), MESH)
    moves = np.zeros((len(plate.x_m), len(plate.y_m), len(plate.z_m), 3), dtype=bool)
    moves.reshape(-1)[plate.free] = True
    inside = plate.x_m < 0.01 - 1e-9
    below = plate.z_m > 0.6 * 6e-3 + 1e-9
    assert not moves[np.ix_(inside, inside, below)].any()
    assert moves[np.ix_(inside, inside, ~below)][1:, 1:].all()
    assert moves[~inside][:-1, 1:-1].all()


@pytest.mark.parametrize("shape", ["square", "round"])
def test_mass_is_that_of_the_thinned_plate(shape):
    patch = replace(PATCH, shape=shape, depth_fraction=0.5)
    whole = replace(SMALL, width_m=0.06, height_m=0.06)
    plate = build_solid_plate(whole, patch, MESH)
    inner = build_solid_plate(whole, replace(patch, depth_fraction=0.0), MESH)
    lost = np.pi * 0.01**2 if shape == "round" else 0.02**2
    difference = _upward_mass(inner) - _upward_mass(plate)
    assert difference == pytest.approx(7800.0 * lost * 3e-3, rel=1e-9)


def _upward_mass(plate):
    """Mass of a motion along the chain that fades to nothing in the elements at the edge."""
    motion = np.zeros((len(plate.x_m), len(plate.y_m), len(plate.z_m), 3))
    motion[:-1, :-1, :, 2] = 1.0
    free = motion.ravel()[plate.free]
    return free @ (plate.mass @ free)


def test_a_patch_over_the_whole_plate_is_a_thinner_plate():
    square = replace(SMALL, height_m=0.06)
    thinned = build_solid_plate(square, CorrosionParameters(size_m=0.06, depth_fraction=0.4), MESH)
    remaining = thinned.z_m[thinned.z_m < 0.6 * 6e-3 + 1e-9]
    kept = np.ones((5, 5, len(remaining) - 1))
    thin = assemble_solid(
        square, thinned.x_m, thinned.y_m, remaining, kept, contact_radius_m=2e-3, quarter=True
    )
    assert compliance(thinned, 500.0) == pytest.approx(compliance(thin, 500.0), rel=1e-9)


@pytest.mark.parametrize("shape", ["square", "round"])
@pytest.mark.parametrize("support", ["simply_supported", "clamped"])
def test_quarter_model_is_exact_for_the_centred_load(shape, support):
    parameters = replace(SMALL, support=support)
    patch = replace(PATCH, shape=shape, depth_fraction=0.5)
    mesh = replace(MESH, elements_per_edge=8, layers=2)
    quarter, whole = (build_solid_plate(parameters, patch, mesh, quarter=q) for q in (True, False))
    # Both solve the same equations; the condition number costs some digits.
    assert compliance(quarter, 2e3) == pytest.approx(compliance(whole, 2e3), rel=1e-9)


def test_a_deeper_patch_yields_more_and_clamped_edges_less():
    values = [
        compliance(build_solid_plate(SMALL, replace(PATCH, depth_fraction=d), MESH)) for d in (0, 0.3, 0.6)
    ]
    assert values[0] < values[1] < values[2]
    clamped = build_solid_plate(replace(SMALL, support="clamped"), PATCH, MESH)
    assert compliance(clamped) < 0.7 * values[0]


def test_a_shallow_patch_is_next_to_none():
    pristine, shallow = (
        build_solid_plate(SMALL, replace(PATCH, depth_fraction=d), MESH) for d in (0.0, 1e-5)
    )
    # The patch is a tenth of the plate; losing 1e-5 of its thickness cannot change more than 3e-5.
    assert compliance(shallow, 2e3) == pytest.approx(compliance(pristine, 2e3), rel=3e-5)


def test_a_patch_too_shallow_to_compute_is_none():
    pristine, none = (build_solid_plate(SMALL, replace(PATCH, depth_fraction=d), MESH) for d in (0.0, 9e-6))
    assert abs(none.stiffness - pristine.stiffness).max() == 0.0


def test_material_scales_stiffness_and_mass():
    usual = build_solid_plate(SMALL, PATCH, MESH)
    other = build_solid_plate(replace(SMALL, youngs_modulus_pa=70e9, density_kg_per_m3=2700.0), PATCH, MESH)
    assert abs(other.stiffness - 0.35 * usual.stiffness).max() <= 1e-12 * abs(usual.stiffness).max()
    assert abs(other.mass - 2700 / 7800 * usual.mass).max() <= 1e-12 * abs(usual.mass).max()
    assert other.indentation_m_per_n == pytest.approx(usual.indentation_m_per_n / 0.35, rel=1e-12)
    softer = build_solid_plate(replace(SMALL, poisson_ratio=0.0), PATCH, MESH)
    assert compliance(softer) > compliance(usual)


def test_matrices_are_symmetric():
    plate = build_solid_plate(SMALL, replace(PATCH, shape="round", depth_fraction=0.5), MESH)
    for matrix in (plate.stiffness, plate.mass):
        assert abs(matrix - matrix.T).max() <= 1e-12 * abs(matrix).max()
        linalg.cholesky(matrix.toarray())  # raises unless positive definite


def test_hertz_weights_are_a_unit_force_and_exact_for_linear_deflections():
    """Mean of ``|x|`` under Hertz's pressure: ``3 a / 8``. Bilinear surfaces hold x exactly."""
    x = np.linspace(0.0, 3e-3, 14)
    y = np.linspace(0.0, 3e-3, 9)
    weights = hertz_nodal_weights(x, y, 2e-3, quarter=True)
    assert weights.sum() == pytest.approx(1.0, rel=1e-14)
    assert weights.sum(axis=1) @ x == pytest.approx(0.75e-3, rel=1e-5)  # 48 points of a square root
    assert weights.sum(axis=0) @ y == pytest.approx(0.75e-3, rel=1e-5)
    assert weights[x > 2e-3 + x[1]].max() == 0.0


def test_hertz_weights_average_the_square_of_the_radius_to_two_fifths():
    x = np.linspace(0.0, 1e-3, 201)
    weights = hertz_nodal_weights(x, x, 1e-3, quarter=True)
    mean = np.sum(weights * (x[:, None] ** 2 + x[None, :] ** 2))
    # Straight lines between nodes lie above the parabola, by less than (5 um)^2 / 4 along each axis.
    assert 0.0 < mean - 0.4e-6 < 2 * (5e-6) ** 2 / 4


def test_whole_plates_weights_are_the_quarters_mirrored():
    half = np.array([0.0, 0.5e-3, 1.2e-3, 3e-3])
    whole = np.concatenate((-half[:0:-1], half))
    quarter = hertz_nodal_weights(half, half, 1e-3, quarter=True)
    share = np.where(half == 0.0, 1.0, 0.5)
    expected = quarter * np.outer(share, share)
    np.testing.assert_allclose(
        hertz_nodal_weights(whole, whole, 1e-3, quarter=False)[3:, 3:], expected, atol=1e-14
    )


def test_more_points_hardly_change_the_weights(monkeypatch):
    x = np.linspace(0.0, 3e-3, 13)
    usual = hertz_nodal_weights(x, x, 5e-4, quarter=True)
    monkeypatch.setattr(solid_plate, "RADIAL_POINTS", 400)
    monkeypatch.setattr(solid_plate, "ANGULAR_POINTS", 400)
    many = hertz_nodal_weights(x, x, 5e-4, quarter=True)
    assert np.abs(usual - many).max() <= 3e-4 * many.max()  # kinks of the bilinear functions


@pytest.mark.parametrize("depth", [0.0, 0.5])
def test_modes_keep_the_response_and_leave_the_indentation_out(depth):
    """Static, growing and swinging force, the whole plate's response against that of 20 vectors."""
    plate = build_solid_plate(SMALL, replace(PATCH, depth_fraction=depth), MESH)
    modes = solid_modes(plate, 20)
    for s in (0.0, 2e4, 1e4 + 6e4j):
        reduced = np.sum(modes.participation**2 / (modes.omega_rad_per_s**2 + s**2))
        exact = plate.load @ linalg.solve((plate.stiffness + s**2 * plate.mass).toarray(), plate.load)
        assert abs(reduced - exact) <= 1e-9 * abs(exact)
    net = compliance(plate) - plate.indentation_m_per_n
    assert modes.static_compliance_m_per_n == pytest.approx(net, rel=1e-8)


def test_cutting_fast_modes_keeps_the_statics():
    mesh = replace(MESH, elements_per_edge=20, layers=4, contact_element_m=2.5e-4, contact_radius_m=5e-4)
    modes = solid_modes(build_solid_plate(SMALL, PATCH, mesh))
    cut = modes.cut_above(2 * np.pi * 250e3, yielding_per_kg=np.inf)
    assert len(cut.omega_rad_per_s) < len(modes.omega_rad_per_s)
    assert cut.static_compliance_m_per_n == pytest.approx(modes.static_compliance_m_per_n, rel=1e-12)
    # Dimple and half-space cancel but for what the plate's other face changes, of the order of a / h.
    assert abs(cut.residual_compliance_m_per_n) < 0.25 * abs(modes.residual_compliance_m_per_n)


def test_passive_modes_give_up_the_fastest_until_nothing_is_negative():
    modes = PlateModes(
        omega_rad_per_s=np.array([1.0, 2.0, 4.0, 8.0]),
        participation=np.array([1.0, 2.0, 4.0, 8.0]),
        residual_compliance_m_per_n=-1.5,
    )
    passive = passive_modes(modes)
    assert passive.omega_rad_per_s.tolist() == [1.0, 2.0]
    assert passive.residual_compliance_m_per_n == pytest.approx(0.5, rel=1e-15)
    assert passive.static_compliance_m_per_n == pytest.approx(modes.static_compliance_m_per_n, rel=1e-15)
    unchanged = passive_modes(replace(modes, residual_compliance_m_per_n=0.0))
    assert unchanged.omega_rad_per_s.tolist() == [1.0, 2.0, 4.0, 8.0]
    with pytest.raises(SpecimenError, match="yields 1 m/N less than a half-space"):
        passive_modes(replace(modes, residual_compliance_m_per_n=-5.0))


@pytest.mark.parametrize(
    ("patch", "mesh", "message"),
    [
        (replace(PATCH, size_m=0.055), MESH, "0.055 m wide, the plate only 0.05 m"),
        (replace(PATCH, size_m=1e-3), MESH, "half the patch is 0.0005 m"),
        (replace(PATCH, depth_fraction=0.9), MESH, "leaves 0.0006 m, less than the elements"),
        (
            replace(PATCH, depth_fraction=0.8),
            replace(MESH, contact_element_m=1e-3),
            "contact_radius_m is 0.002 m, more than the 0.0012 m",
        ),
        (PATCH, replace(MESH, contact_radius_m=0.03), "the plate leaves 0.025 m"),
        (PATCH, replace(MESH, growth=1.25), r"reach 0.01231 m of 0.03 m; make elements_per_edge, growth"),
        (PATCH, replace(MESH, elements_per_edge=40), "must be at most 0.00125 m"),
    ],
)
def test_what_does_not_fit_is_refused(patch, mesh, message):
    with pytest.raises(SpecimenError, match=message):
        build_solid_plate(SMALL, patch, mesh)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"elements_per_edge": 9}, "must be even"),
        ({"contact_element_m": 3e-3}, "at most contact_radius_m"),
        ({"layers": 0}, "layers is 0"),
    ],
)
def test_mesh_out_of_bounds_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(MESH, **change)
