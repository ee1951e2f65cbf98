"""Patches of any outline, place and profile: what they cover, what is refused, which part is enough."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from simulator.errors import SpecimenError
from simulator.parameters.plate import CorrosionParameters, LiquidParameters, PatchParameters, PlateParameters
from simulator.plate.mindlin.patches import find_symmetric_axes, patch_fraction
from simulator.plate.mindlin.plate import build_plate, evaluate_thinning

PLATE = PlateParameters(
    width_m=0.3, height_m=0.2, thickness_m=4e-3, elements_per_edge=20, contact_element_m=2e-3
)
PATCH = CorrosionParameters(size_m=0.03)
MIXED = CorrosionParameters(
    shape="rectangular",
    size_m=0.04,
    size_y_m=0.02,
    offset_x_m=0.01,
    offset_y_m=-0.02,
    depth_factor=0.6,
    further=(
        PatchParameters(shape="round", size_m=0.03, offset_x_m=-0.05, offset_y_m=0.03),
        PatchParameters(shape="round", size_m=0.04, offset_x_m=0.06, offset_y_m=0.02, profile="bowl"),
        PatchParameters(size_m=0.02, offset_x_m=-0.05, offset_y_m=-0.03, profile="cosine", depth_factor=0.4),
    ),
)
WET = replace(PLATE, liquid=LiquidParameters(depth_m=0.03))


def lost_volume_m3(plate, corrosion, depth):
    """From the mass: rigid motion along the chain, all nodes free."""
    free = replace(plate, support="free")
    parts = build_plate(free, corrosion, whole=True)
    deflection = np.zeros(3 * len(parts.x_m) * len(parts.y_m))
    deflection[::3] = 1.0
    moved = deflection[parts.free]
    masses = [moved @ (parts.evaluate_at_depth(d)[1] @ moved) for d in (0.0, depth)]
    return (masses[0] - masses[1]) / plate.density_kg_per_m3


def dynamic_compliance(plate, corrosion, *, whole=False, depth=0.6, frequency_hz=700.0):
    parts = build_plate(plate, corrosion, whole=whole)
    stiffness, mass = parts.evaluate_at_depth(depth)
    dynamic = stiffness - (2 * np.pi * frequency_hz) ** 2 * mass
    if parts.added_mass is None:
        return parts.load @ splu(dynamic.tocsc()).solve(parts.load)
    dynamic = dynamic.toarray() - (2 * np.pi * frequency_hz) ** 2 * (
        parts.added_mass @ np.eye(len(parts.load))
    )
    return parts.load @ np.linalg.solve(dynamic, parts.load)


@pytest.mark.parametrize(
    ("patch", "area_m2", "tolerance"),
    [
        ({"shape": "rectangular", "size_m": 0.05, "size_y_m": 0.03}, 0.05 * 0.03, 1e-9),
        ({"shape": "round", "size_m": 0.04}, np.pi * 0.02**2, 1e-9),
        ({"shape": "round", "size_m": 0.04, "depth_factor": 0.3}, 0.3 * np.pi * 0.02**2, 1e-9),
        # Paraboloid: half the cylinder. Two Gauss points an element cut its rim; 2 % with this mesh.
        ({"shape": "round", "size_m": 0.04, "profile": "bowl"}, 0.5 * np.pi * 0.02**2, 0.02),
        # (1/2 - 2/pi^2) of the cylinder.
        (
            {"shape": "round", "size_m": 0.04, "profile": "cosine"},
            np.pi * 0.02**2 * (0.5 - 2 / np.pi**2),
            0.02,
        ),
        # A parabola's mean is 2/3, exact with two Gauss points; a raised cosine's is 1/2.
        ({"size_m": 0.04, "profile": "bowl"}, 0.04**2 * 4 / 9, 1e-9),
        ({"size_m": 0.04, "profile": "cosine"}, 0.04**2 / 4, 0.01),
    ],
)
@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.03, -0.02)])
def test_a_patch_takes_the_volume_of_its_profile(patch, area_m2, tolerance, offset):
    corrosion = CorrosionParameters(**patch, offset_x_m=offset[0], offset_y_m=offset[1])
    lost = lost_volume_m3(PLATE, corrosion, depth=0.5)
    assert lost == pytest.approx(0.5 * PLATE.thickness_m * area_m2, rel=tolerance)


def test_several_patches_take_the_sum_of_their_volumes():
    areas = 0.6 * 0.04 * 0.02 + np.pi * 0.015**2 + 0.5 * np.pi * 0.02**2 + 0.4 * 0.25 * 0.02**2
    errors = [
        lost_volume_m3(replace(PLATE, elements_per_edge=n, contact_element_m=1e-3), MIXED, 0.7)
        / (0.7 * PLATE.thickness_m * areas)
        - 1.0
        for n in (24, 48, 96)
    ]
    # The smooth profiles lie in elements that grow with the distance from the contact.
    assert abs(errors[2]) < abs(errors[1]) < abs(errors[0]) < 0.02
    assert abs(errors[2]) < 1e-3


def _keys(patch):
    names = ("shape", "size_m", "size_y_m", "offset_x_m", "offset_y_m", "profile", "depth_factor")
    return {name: getattr(patch, name) for name in names}


def test_polynomial_equals_a_plate_assembled_at_that_thickness():
    """A profile that is the same everywhere is a plate of another thickness, at any depth."""
    whole = CorrosionParameters(shape="rectangular", size_m=0.3, size_y_m=0.2, depth_factor=0.5)
    for depth in (0.0, 0.4, 0.9):
        thinner = replace(PLATE, thickness_m=PLATE.thickness_m * (1.0 - 0.5 * depth))
        family, direct = build_plate(PLATE, whole), build_plate(thinner, whole)
        for one, other in zip(family.evaluate_at_depth(depth), direct.evaluate_at_depth(0.0), strict=True):
            assert abs(one - other).max() <= 1e-13 * abs(other).max()  # rounding of the cubes


@pytest.mark.parametrize("power", [1, 3])
def test_coefficients_are_the_thickness_at_every_point(power):
    x = y = np.linspace(-0.1, 0.1, 21)
    thinning = evaluate_thinning(x, y, MIXED)
    assert thinning.profile.any()
    for s in (1.0, 0.6, 0.1):
        value = np.tensordot(s ** np.arange(4), thinning.coefficients(power), axes=1)
        flat = sum(
            c * ((1 - f) + s * f) ** power
            for c, f in zip(thinning.covered, thinning.depth_factor, strict=True)
        )
        smooth = (1.0 - (1.0 - s) * thinning.profile) ** power
        expected = flat + (1.0 - thinning.covered.sum(axis=0)) * smooth
        np.testing.assert_allclose(value, expected, rtol=1e-13)  # rounding of the binomials
    # At s = 1 nothing is lost; at a point in the bowl's middle the local depth is the position's.
    assert np.max(thinning.profile) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    "plate",
    [PLATE, WET, replace(PLATE, support="free"), replace(PLATE, contact="patch", contact_radius_m=4e-3)],
)
@pytest.mark.parametrize(
    "corrosion",
    [
        replace(PATCH, shape="round", profile="bowl"),
        replace(PATCH, shape="rectangular", size_y_m=0.05, profile="cosine"),
        replace(
            PATCH,
            further=tuple(
                PatchParameters(size_m=0.02, offset_x_m=x, offset_y_m=y)
                for x in (-0.04, 0.04)
                for y in (-0.04, 0.04)
            ),
        ),
        replace(PATCH, further=(PatchParameters(shape="round", size_m=0.02, offset_y_m=0.04),)),
        replace(PATCH, offset_x_m=0.02),
    ],
    ids=["bowl", "cosine", "four more", "one above", "to the right"],
)  # fmt: skip
def test_part_of_a_symmetric_plate_is_exact(plate, corrosion):
    assert any(find_symmetric_axes(plate, corrosion))
    part, whole = (dynamic_compliance(plate, corrosion, whole=whole) for whole in (False, True))
    # Both solve the same equations; the condition number of the thin plate costs six digits.
    assert part == pytest.approx(whole, rel=1e-8)


def test_symmetry_is_lost_with_the_contact_or_a_patch_off_the_middle():
    assert find_symmetric_axes(PLATE, PATCH) == (True, True)
    assert find_symmetric_axes(replace(PLATE, contact_x_m=0.02), PATCH) == (False, True)
    assert find_symmetric_axes(replace(PLATE, contact_y_m=0.02), PATCH) == (True, False)
    assert find_symmetric_axes(PLATE, replace(PATCH, offset_y_m=0.02)) == (True, False)
    eccentric = PatchParameters(size_m=0.02, offset_x_m=0.06)
    pair = (eccentric, replace(eccentric, offset_x_m=-0.06))
    assert find_symmetric_axes(PLATE, replace(PATCH, further=pair)) == (True, True)
    unlike = (eccentric, replace(eccentric, offset_x_m=-0.06, depth_factor=0.5))
    assert find_symmetric_axes(PLATE, replace(PATCH, further=unlike)) == (False, True)


@pytest.mark.parametrize(
    ("support", "liquid"),
    [
        ("simply_supported", None),
        ("clamped", None),
        ("free", None),
        ("free", WET.liquid),
        pytest.param("simply_supported", WET.liquid, marks=pytest.mark.slow),
        pytest.param("clamped", WET.liquid, marks=pytest.mark.slow),
    ],
)
def test_mirror_images_give_the_same(support, liquid):
    plate = replace(PLATE, support=support, liquid=liquid, contact_x_m=0.02, contact_y_m=-0.03)
    assert find_symmetric_axes(plate, MIXED) == (False, False)
    expected = dynamic_compliance(plate, MIXED)
    mirrored = replace(
        MIXED,
        offset_x_m=-MIXED.offset_x_m,
        further=tuple(replace(p, offset_x_m=-p.offset_x_m) for p in MIXED.further),
    )
    # Same equations in another order: the condition number of the thin plate costs six digits.
    assert dynamic_compliance(replace(plate, contact_x_m=-0.02), mirrored) == pytest.approx(
        expected, rel=1e-8
    )


def test_turned_plate_gives_the_same():
    """x and y change places."""
    plate = replace(WET, contact_x_m=0.02, contact_y_m=-0.03)
    turned = replace(
        plate, width_m=plate.height_m, height_m=plate.width_m, contact_x_m=-0.03, contact_y_m=0.02
    )
    patches = CorrosionParameters(
        shape="rectangular",
        size_m=MIXED.size_y_m,
        size_y_m=MIXED.size_m,
        offset_x_m=MIXED.offset_y_m,
        offset_y_m=MIXED.offset_x_m,
        depth_factor=MIXED.depth_factor,
        further=tuple(replace(p, offset_x_m=p.offset_y_m, offset_y_m=p.offset_x_m) for p in MIXED.further),
    )
    assert dynamic_compliance(turned, patches) == pytest.approx(dynamic_compliance(plate, MIXED), rel=1e-8)


def test_depth_factor_of_the_only_patch_rescales_the_depth():
    half = dynamic_compliance(PLATE, replace(PATCH, depth_factor=0.5), depth=0.8)
    assert half == pytest.approx(dynamic_compliance(PLATE, PATCH, depth=0.4), rel=1e-9)
    assert half != pytest.approx(dynamic_compliance(PLATE, PATCH, depth=0.8), rel=1e-2)


@pytest.mark.parametrize(
    ("further", "message"),
    [
        ({"offset_x_m": 0.02, "size_m": 0.02}, r"patches at \(0.0, 0.0\) m and \(0.02, 0.0\) m"),
        ({"size_m": 0.01}, "overlap; move them apart"),
        # The corner of the square lies within the circle, 0.7 of its radius away along both axes.
        ({"shape": "round", "size_m": 0.02, "offset_x_m": 0.02, "offset_y_m": 0.02}, "overlap"),
        ({"offset_x_m": 0.15, "size_m": 0.02}, r"reaches 0.16 m .* along x, past its edge at 0.15 m"),
        ({"offset_y_m": -0.095, "size_m": 0.02}, r"along y, past its edge at 0.1 m"),
    ],
)
def test_impossible_patches_are_refused(further, message):
    with pytest.raises(SpecimenError, match=message):
        build_plate(PLATE, replace(PATCH, further=(PatchParameters(**further),)))


def test_touching_patches_are_no_overlap():
    """Squares side by side, circles side by side, and a circle beyond a square's corner."""
    with_second = replace(PATCH, further=(PatchParameters(size_m=0.03, offset_x_m=0.03),))
    wide = CorrosionParameters(shape="rectangular", size_m=0.06, size_y_m=0.03, offset_x_m=0.015)
    assert dynamic_compliance(PLATE, with_second, whole=True) == pytest.approx(
        dynamic_compliance(PLATE, wide, whole=True), rel=0.02
    )  # the same hole in the plate; only the mesh differs
    for other in (
        PatchParameters(shape="round", size_m=0.02, offset_x_m=0.0221, offset_y_m=0.0221),
        PatchParameters(shape="round", size_m=0.03, offset_y_m=0.03),
    ):
        build_plate(PLATE, replace(PATCH, further=(other,)))
    disks = replace(
        PATCH,
        shape="round",
        further=(PatchParameters(shape="round", size_m=0.03, offset_x_m=0.0213, offset_y_m=0.0213),),
    )
    build_plate(PLATE, disks)


def test_contact_may_be_next_to_a_patch_but_not_on_its_edge():
    with pytest.raises(SpecimenError, match=r"lies 0.001 m from the contact, within its elements of 0.002 m"):
        build_plate(PLATE, replace(PATCH, offset_x_m=0.014))
    on_the_line = build_plate(PLATE, replace(PATCH, offset_x_m=0.015))  # an edge through the contact itself
    assert np.any(on_the_line.x_m == 0.0)


def test_too_many_edges_for_the_mesh():
    further = tuple(PatchParameters(size_m=4e-3, offset_x_m=0.005 * k) for k in range(5, 15))
    with pytest.raises(SpecimenError, match=r"make plate.elements_per_edge at least \d+"):
        build_plate(PLATE, replace(PATCH, further=further))


def test_flat_rectangle_covers_whole_elements_wherever_it_lies():
    patch = PatchParameters(
        shape="rectangular", size_m=0.05, size_y_m=0.03, offset_x_m=0.031, offset_y_m=-0.017
    )
    parts = build_plate(PLATE, CorrosionParameters(**_keys(patch)))
    covered = patch_fraction(parts.x_m, parts.y_m, patch)
    assert set(np.unique(covered)) == {0.0, 1.0}
    areas = np.outer(np.diff(parts.x_m), np.diff(parts.y_m))
    assert np.sum(covered * areas) == pytest.approx(0.05 * 0.03, rel=1e-9)
