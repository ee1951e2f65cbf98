"""Grid, patch and the affine family of matrices."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.errors import SpecimenError
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.element import GAUSS_POINTS, compute_thinned_coefficients, element_matrices
from simulator.plate.mindlin.grid import make_graded_half_edge
from simulator.plate.mindlin.patches import patch_fraction
from simulator.plate.mindlin.plate import build_plate

SMALL = PlateParameters(
    width_m=0.3, height_m=0.2, thickness_m=4e-3, elements_per_edge=12, contact_element_m=2e-3
)
PATCH = CorrosionParameters(size_m=0.05)


@pytest.mark.parametrize("edge_m", [12.7e-3, 25.4e-3, 0.1, 0.3])
def test_grid_starts_fine_meets_the_patch_and_grows_smoothly(edge_m):
    lines = make_graded_half_edge(0.3048, 48, 1e-4, edge_m)
    sizes = np.diff(lines)
    assert len(sizes) == 48
    assert lines[0] == 0.0
    assert lines[-1] == 0.3048
    assert sizes[0] == pytest.approx(1e-4, rel=1e-9)  # the root of the growth factor
    assert np.min(np.abs(lines - edge_m)) < 1e-12
    # Smooth: neighbours differ by less than a third even where one progression gives way to the other.
    assert np.all(np.abs(np.log(sizes[1:-1] / sizes[:-2])) < np.log(1.34))


def test_paper_mesh_is_graded_evenly():
    sizes = np.diff(make_graded_half_edge(0.3048, 48, 1e-4, 12.7e-3))
    growth = sizes[1:] / sizes[:-1]
    assert growth.max() / growth.min() < 1.005  # this patch happens to fit one progression


def test_a_patch_as_large_as_the_plate_needs_no_inner_line():
    assert make_graded_half_edge(0.3048, 48, 1e-4, 0.3048)[-1] == 0.3048


def test_patch_must_fit():
    with pytest.raises(SpecimenError, match=r"0.25 m wide, the plate only 0.2 m"):
        build_plate(SMALL, CorrosionParameters(size_m=0.25))
    with pytest.raises(SpecimenError, match="contact_element_m smaller"):
        build_plate(SMALL, CorrosionParameters(size_m=3e-3))


def test_affine_family_equals_direct_assembly_element_by_element():
    depth = 0.37
    plate = build_plate(SMALL, PATCH, whole=True)
    covered = patch_fraction(plate.x_m, plate.y_m, PATCH).ravel() > 0.5
    sizes = np.diff(plate.x_m), np.diff(plate.y_m)
    thick = element_matrices(SMALL, *sizes)
    thin = element_matrices(replace(SMALL, thickness_m=(1 - depth) * SMALL.thickness_m), *sizes)

    values = np.zeros(3 * len(plate.x_m) * len(plate.y_m))
    values[plate.free] = np.random.default_rng(1).standard_normal(len(plate.free))
    nodes = values.reshape(len(plate.x_m), len(plate.y_m), 3)
    corners = np.stack((nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]), axis=2)
    local = corners.reshape(-1, 12)
    for matrix, kinds in zip(plate.evaluate_at_depth(depth), ((0, 1), (2, 3)), strict=True):
        energy = 0.0
        for kind in kinds:
            elements = np.where(covered[:, None, None], thin[kind], thick[kind])
            energy += np.einsum("ei,eij,ej->", local, elements, local)
        free = values[plate.free]
        assert free @ (matrix @ free) == pytest.approx(energy, rel=1e-12)  # sums of 144 elements


def test_matrices_are_symmetric_and_mass_is_the_plates():
    plate = build_plate(replace(SMALL, support="simply_supported"), PATCH, whole=True)
    stiffness, mass = plate.evaluate_at_depth(0.5)
    assert abs(stiffness - stiffness.T).max() <= 1e-12 * abs(stiffness).max()
    assert abs(mass - mass.T).max() <= 1e-12 * abs(mass).max()
    _, _, translation, _ = element_matrices(SMALL, np.diff(plate.x_m), np.diff(plate.y_m))
    rigid = np.tile([1.0, 0.0, 0.0], 4)
    total = np.einsum("i,eij,j->", rigid, translation, rigid)
    assert total == pytest.approx(7800 * 0.3 * 0.2 * 4e-3, rel=1e-12)


@pytest.mark.parametrize("s", [1.0, 0.4, 0.05])
def test_elements_thinned_alike_at_all_points_are_thinner_elements(s):
    sizes, p = (np.array([0.01, 0.03]), np.array([0.02, 0.05])), 0.37
    linear, cubic = (
        np.zeros((4, 4, 4)) + np.array(terms)[:, None, None]
        for terms in ((1 - p, p, 0, 0), ((1 - p) ** 3, 3 * (1 - p) ** 2 * p, 3 * (1 - p) * p**2, p**3))
    )
    a, b = (side.ravel() for side in np.meshgrid(*sizes, indexing="ij"))
    coefficients = compute_thinned_coefficients(SMALL, a, b, linear, cubic)
    thinner = replace(SMALL, thickness_m=SMALL.thickness_m * (1 - p + s * p))
    bending, shear, translation, rotation = element_matrices(thinner, *sizes)
    for found, direct in zip(coefficients, (bending + shear, translation + rotation), strict=True):
        at_s = np.tensordot(s ** np.arange(4), found, axes=1)
        assert np.max(np.abs(at_s - direct)) <= 1e-14 * np.max(np.abs(direct))  # rounding


@pytest.mark.parametrize("axis", [0, 1])
def test_points_of_an_element_are_thinned_where_they_lie(axis):
    """One half of the element is gone; rotations of the nodes beyond bend mostly that half."""
    present = np.array([point[axis] < 0.0 for point in GAUSS_POINTS], dtype=np.float64)
    terms = np.zeros((4, 4, 1))
    terms[0, :, 0] = present
    bent = np.zeros(12)
    # The nodes at the upper end of the axis, their rotation across it: curvature grows with 1 + xi.
    nodes, rotation = (((1, 2), 2), ((2, 3), 1))[axis]
    for sign, node in zip((-1.0, 1.0) if axis == 0 else (1.0, -1.0), nodes, strict=True):
        bent[3 * node + rotation] = sign
    thin = replace(SMALL, thickness_m=1e-3)
    one = np.array([0.02])
    none = np.zeros_like(terms)
    stiffness, _ = compute_thinned_coefficients(thin, one, one, none, terms)  # bending alone
    direct = bent @ element_matrices(thin, one, one)[0][0] @ bent
    near, far = (1 - 3**-0.5) ** 2, (1 + 3**-0.5) ** 2
    found = bent @ stiffness[0, 0] @ bent
    # The twist along the axis, the same at all points, takes part as well.
    twist = (1.0 - SMALL.poisson_ratio) / 2.0 / 3.0
    assert found / direct == pytest.approx((near + twist) / (near + far + 2 * twist), rel=1e-12)
