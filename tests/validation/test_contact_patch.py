"""Contact spread over a circle: independent of the mesh, as the exact series says; a node is not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from simulator.materials import bending_stiffness_n_m, shear_modulus_pa
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.element import SHEAR_CORRECTION
from simulator.plate.mindlin.plate import build_plate
from simulator.shot.model import ShotModel
from simulator.shot.pulse_summary import summarise_pulses

PLATE = PlateParameters(
    width_m=0.6,
    height_m=0.5,
    thickness_m=6e-3,
    contact="patch",
    contact_radius_m=5e-3,
    contact_element_m=1e-3,
)
PATCH = CorrosionParameters(size_m=0.1)
MESHES = ((24, 5e-3), (48, 2.5e-3), (96, 1.25e-3))
"""Elements along an edge and at the contact, all halved together."""


def shear_stiffness_n_per_m(plate):
    shear_pa = shear_modulus_pa(plate.youngs_modulus_pa, plate.poisson_ratio)
    return SHEAR_CORRECTION * plate.thickness_m * shear_pa


def exact_compliance(plate):
    """Navier's series of a Mindlin plate, load and mean deflection weighted with Hertz's pressure.

    Its Fourier transform is ``3 (sin q - q cos q) / q^3``, q = k a.
    """
    radius_m = plate.contact_radius_m
    bending = bending_stiffness_n_m(plate.youngs_modulus_pa, plate.poisson_ratio, plate.thickness_m)
    # Up to k a = 60 what is left out falls with the fifth power: below 1e-8.
    orders = np.arange(1, 60 / radius_m * plate.width_m / np.pi, 2) * np.pi
    k = np.hypot(orders[:, None] / plate.width_m, orders / plate.height_m)
    q = k * radius_m
    weight = 3.0 * (np.sin(q) - q * np.cos(q)) / q**3
    terms = weight**2 * (1.0 / (bending * k**4) + 1.0 / (shear_stiffness_n_per_m(plate) * k**2))
    return 4.0 / (plate.width_m * plate.height_m) * terms.sum()


def compliance(plate, *, whole=False):
    parts = build_plate(plate, PATCH, whole=whole)
    stiffness, _ = parts.evaluate_at_depth(0.0)
    return float(parts.load @ splu(stiffness).solve(parts.load))


@pytest.mark.parametrize("radius_m", [5e-3, 2e-2])
def test_compliance_converges_to_the_exact_one_with_order_two(radius_m):
    plate = replace(PLATE, contact_radius_m=radius_m)
    exact = exact_compliance(plate)
    errors = [
        compliance(replace(plate, elements_per_edge=n, contact_element_m=size)) / exact - 1.0
        for n, size in MESHES
    ]
    assert abs(errors[-1]) < 2e-4
    np.testing.assert_allclose(np.log2(np.array(errors[:-1]) / errors[1:]), 2.0, atol=0.2)


@pytest.mark.slow
def test_a_node_never_converges():
    """Each halving adds ``ln 2 / (2 pi kappa G h)``, for ever."""
    values = [
        compliance(replace(PLATE, contact="node", elements_per_edge=n, contact_element_m=size))
        for n, size in (*MESHES, (192, 0.625e-3))
    ]
    halving = np.log(2.0) / (2 * np.pi * shear_stiffness_n_per_m(PLATE))
    # The rest of the mesh converges meanwhile, which the first steps show.
    np.testing.assert_allclose(np.diff(values)[1:], halving, rtol=0.5)
    assert np.diff(values)[-1] == pytest.approx(halving, rel=0.15)


def test_off_centre_compliance_is_the_series_at_that_place():
    """The series with ``sin^2`` at the contact instead of 1 for odd and 0 for even waves."""
    plate = replace(PLATE, contact_x_m=0.12, contact_y_m=-0.07, contact_radius_m=1e-2)
    a, b = plate.width_m, plate.height_m
    bending = bending_stiffness_n_m(plate.youngs_modulus_pa, plate.poisson_ratio, plate.thickness_m)
    orders = np.arange(1, 60 / plate.contact_radius_m * a / np.pi) * np.pi
    k = np.hypot(orders[:, None] / a, orders / b)
    q = k * plate.contact_radius_m
    weight = 3.0 * (np.sin(q) - q * np.cos(q)) / q**3
    weight *= np.outer(np.sin(orders * (0.5 + 0.12 / a)), np.sin(orders * (0.5 - 0.07 / b)))
    terms = weight**2 * (1.0 / (bending * k**4) + 1.0 / (shear_stiffness_n_per_m(plate) * k**2))
    exact = 4.0 / (a * b) * terms.sum()
    errors = [
        compliance(replace(plate, elements_per_edge=n, contact_element_m=240e-3 / n)) / exact - 1.0
        for n in (32, 64)
    ]
    assert abs(errors[1]) < 1e-3
    # Elements are shared out among the lines in whole numbers: order two, but roughly.
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.5)


def test_shot_on_a_circle_does_not_depend_on_the_mesh(reduction_folder):
    tof_us = {}
    for contact in ("patch", "node"):
        for size_m in (2.5e-4, 1e-4):
            plate = PlateParameters(contact=contact, contact_radius_m=5e-4, contact_element_m=size_m)
            model = ShotModel(ChainParameters(), plate, CorrosionParameters(), cache_folder=reduction_folder)
            tof_us[contact, size_m] = summarise_pulses(model.shot(depth_fraction=0.5)).tof_us
    moved = {c: tof_us[c, 1e-4] - tof_us[c, 2.5e-4] for c in ("patch", "node")}
    assert abs(moved["patch"]) < 0.05 * moved["node"]
