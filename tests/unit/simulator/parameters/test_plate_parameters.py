"""Plates that cannot be are refused with the value, the limit and what to change."""

import pytest

from simulator.parameters.plate import CorrosionParameters, LiquidParameters, PatchParameters, PlateParameters
from simulator.plate.mindlin.cache import hash_reduction


@pytest.mark.parametrize(
    ("parameters", "values", "message"),
    [
        (PlateParameters, {"suspension_hz": 0.0}, "suspension_hz is 0.0; it must be greater than 0.0"),
        (
            PlateParameters,
            {"contact_x_m": 0.3048},
            r"contact_x_m is 0.3048 m; .* at most 0.3048 m from the centre",
        ),
        (PlateParameters, {"contact_y_m": -0.31}, "contact_y_m is -0.31 m"),
        (
            PlateParameters,
            {"contact": "patch", "contact_x_m": 0.3, "contact_radius_m": 0.01},
            r"the contact, 0.01 m to either side",
        ),
        (
            PlateParameters,
            {"contact": "patch", "contact_radius_m": 5e-5},
            "at most contact_radius_m, 5e-05 m",
        ),
        (PlateParameters, {"temperature_c": 1000.0, "youngs_modulus_change_per_k": -2e-3}, "would be -1.92e"),
        (PlateParameters, {"temperature_c": float("nan")}, "temperature_c is nan"),
        (
            PlateParameters,
            {"model": "rigid_wall", "liquid": LiquidParameters(depth_m=0.1)},
            "liquid is given for a plate of model rigid_wall",
        ),
        (LiquidParameters, {"depth_m": 0.0}, "depth_m is 0.0; it must be greater than 0.0"),
        (LiquidParameters, {"depth_m": 1.0, "density_kg_per_m3": -1.0}, "density_kg_per_m3 is -1.0"),
        (PatchParameters, {"shape": "rectangular"}, "size_y_m is None for a rectangular patch"),
        (PatchParameters, {"size_y_m": 0.01}, "size_y_m is 0.01 for a square patch"),
        (CorrosionParameters, {"shape": "rectangular"}, "size_y_m is None for a rectangular patch"),
        (CorrosionParameters, {"depth_factor": 1.2}, "depth_factor is 1.2; it must be at most 1.0"),
        (CorrosionParameters, {"depth_factor": 0.0}, "depth_factor is 0.0; it must be greater than 0.0"),
        (CorrosionParameters, {"further": (PatchParameters(),) * 33}, "further has 33 patches; at most 32"),
    ],
)
def test_an_impossible_plate_is_named(parameters, values, message):
    with pytest.raises(ValueError, match=message):
        parameters(**values)


def test_the_defaults_are_the_papers_plate():
    plate, patch = PlateParameters(), CorrosionParameters()
    assert (plate.liquid, plate.contact, plate.contact_x_m, plate.contact_y_m) == (None, "node", 0.0, 0.0)
    assert plate.warm_youngs_modulus_pa == plate.youngs_modulus_pa
    assert patch.patches == (PatchParameters(),)


@pytest.mark.parametrize(
    ("plate", "patch"),
    [
        ({"support": "free"}, {}),
        ({"support": "free", "suspension_hz": 5.0}, {}),
        ({"liquid": LiquidParameters(depth_m=0.1)}, {}),
        ({"liquid": LiquidParameters(depth_m=0.2)}, {}),
        ({"temperature_c": 30.0}, {}),
        ({"support": "clamped"}, {}),
        ({"thickness_m": 6e-3}, {}),
        ({}, {"size_m": 0.03}),
        ({}, {"shape": "round"}),
        ({"contact_x_m": 0.01}, {}),
        ({"contact_y_m": 0.01}, {}),
        ({"contact": "patch"}, {}),
        ({"contact": "patch", "contact_radius_m": 3e-4}, {}),
        ({}, {"shape": "rectangular", "size_y_m": 0.02}),
        ({}, {"offset_x_m": 0.01}),
        ({}, {"offset_y_m": 0.01}),
        ({}, {"profile": "bowl"}),
        ({}, {"depth_factor": 0.5}),
        ({}, {"further": (PatchParameters(offset_x_m=0.1),)}),
        ({}, {"further": (PatchParameters(offset_x_m=0.1, profile="cosine"),)}),
    ],
)
def test_every_key_of_plate_and_patches_has_a_reduction_of_its_own(plate, patch):
    usual = hash_reduction(PlateParameters(), CorrosionParameters())
    changed = hash_reduction(PlateParameters(**plate), CorrosionParameters(**patch))
    assert changed != usual
    assert changed == hash_reduction(
        PlateParameters(**plate), CorrosionParameters(**patch, depth_fraction=0.5)
    )


def test_youngs_modulus_falls_with_temperature():
    plate = PlateParameters(temperature_c=100.0)
    assert plate.warm_youngs_modulus_pa == pytest.approx(200e9 * (1.0 - 80.0 * 2.7e-4), rel=1e-14)
