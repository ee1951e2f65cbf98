"""A plate with a liquid on one face against the frequencies of its modes in closed form."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, linalg

from simulator.errors import SpecimenError
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, LiquidParameters, PlateParameters
from simulator.plate.mindlin.liquid_layer import choose_sine_terms, integrate_hats_times_sines, layer_mass
from simulator.plate.mindlin.plate import assemble_plate, build_plate, evaluate_thinning
from simulator.plate.mindlin.reduction import reduce_plate
from simulator.shot.model import ShotModel

PATCH = CorrosionParameters(size_m=0.3)
PATCH_ANYWHERE = CorrosionParameters(size_m=0.5)
"""Where its edges lie does not matter."""
THIN = PlateParameters(width_m=0.6, height_m=0.5, thickness_m=1e-3)
WATER_KG_PER_M3 = 1000.0
PAPER_WET = PlateParameters(liquid=LiquidParameters(depth_m=0.1))


def with_terms(plate, corrosion, highest):
    """The quarter plate with its liquid's sines up to `highest` along both edges."""
    parts = build_plate(plate, corrosion)
    mass = layer_mass(
        plate.liquid,
        plate,
        parts.x_m,
        parts.y_m,
        parts.free,
        symmetric=(True, True),
        terms=(highest, highest),
    )
    return replace(parts, added_mass=mass)


def shots(parts, depths):
    model = ShotModel(
        ChainParameters(), PlateParameters(), CorrosionParameters(), prepared_plate=reduce_plate(parts)
    )
    return [model.shot(depth_fraction=depth) for depth in depths]


def test_integrals_of_hats_and_sines_are_exact():
    lines = np.array([0.0, 1e-4, 3e-4, 0.01, 0.05, 0.1])
    orders = np.array([1.0, 3.0, 40.0])
    found = integrate_hats_times_sines(lines, -0.02, 0.25, orders)
    for row, m in enumerate(orders):
        for column in range(len(lines)):
            hat = np.eye(len(lines))[column]
            exact = sum(
                integrate.quad(
                    lambda x, hat=hat, m=m: np.interp(x, lines, hat) * np.sin(m * np.pi * (x + 0.02) / 0.25),
                    *element,
                    epsabs=1e-15,
                )[0]
                for element in itertools.pairwise(lines)
            )
            # Absolute: differences of cosines on the shortest element cost digits.
            assert found[row, column] == pytest.approx(np.sqrt(2 / 0.25) * exact, abs=1e-13)


@pytest.mark.parametrize("depth_m", [0.01, 0.1, pytest.param(10.0, marks=pytest.mark.slow)])
def test_every_mode_of_a_simply_supported_plate_falls_by_the_closed_form(depth_m):
    """Each mode is one sine: ``sqrt(m / (m + rho_f tanh(k H) / k))``."""
    plate = replace(THIN, liquid=LiquidParameters(density_kg_per_m3=WATER_KG_PER_M3, depth_m=depth_m))
    odd = np.arange(1, 8, 2) * np.pi
    k = np.sqrt(np.sort(((odd[:, None] / 0.6) ** 2 + (odd / 0.5) ** 2).ravel())[:5])
    mass_per_area = plate.density_kg_per_m3 * plate.thickness_m
    exact = np.sqrt(mass_per_area / (mass_per_area + WATER_KG_PER_M3 * np.tanh(k * depth_m) / k))
    assert exact.max() < 0.7  # the liquid is no detail
    errors = []
    for elements in (6, 12):
        x, y = np.linspace(0.0, 0.3, elements + 1), np.linspace(0.0, 0.25, elements + 1)
        parts = assemble_plate(plate, x, y, evaluate_thinning(x, y, PATCH), symmetric=(True, True))
        stiffness, mass = (matrix.toarray() for matrix in parts.evaluate_at_depth(0.0))
        wet_mass = mass + parts.added_mass @ np.eye(len(parts.load))
        dry, wet = (np.sqrt(linalg.eigh(stiffness, m, eigvals_only=True)[: len(k)]) for m in (mass, wet_mass))
        errors.append(np.max(np.abs(wet / dry / exact - 1.0)))
    # The mesh's error is nearly the same with and without the liquid; the rest converges away, down to
    # what the eigenvalues of so thin a plate allow.
    assert errors[1] < 1.5e-4
    assert errors[1] < 0.5 * errors[0]


def test_modes_do_not_depend_on_where_the_chain_stands():
    """Whole plate, contact off its centre: even and odd waves, first ones in closed form."""
    plate = replace(
        THIN, liquid=LiquidParameters(depth_m=0.1), contact_x_m=0.075, contact_y_m=-0.0625, thickness_m=3e-3
    )
    x, y = np.linspace(-0.375, 0.225, 17), np.linspace(-0.1875, 0.3125, 17)
    x[np.argmin(np.abs(x))] = y[np.argmin(np.abs(y))] = 0.0
    parts = assemble_plate(plate, x, y, evaluate_thinning(x, y, PATCH_ANYWHERE), symmetric=(False, False))
    stiffness, mass = (matrix.toarray() for matrix in parts.evaluate_at_depth(0.0))
    wet_mass = mass + parts.added_mass @ np.eye(len(parts.load))
    dry, wet = (
        np.sqrt(linalg.eigh(stiffness, m, subset_by_index=(0, 3), eigvals_only=True))
        for m in (mass, wet_mass)
    )
    waves = np.arange(1, 4) * np.pi
    k = np.sqrt(np.sort(((waves[:, None] / 0.6) ** 2 + (waves / 0.5) ** 2).ravel())[:4])
    exact = np.sqrt(23.4 / (23.4 + 1023.0 * np.tanh(0.1 * k) / k))
    np.testing.assert_allclose(wet / dry, exact, rtol=2e-3)  # the coarse mesh; a shifted wave is far off


@pytest.mark.parametrize("support", ["simply_supported", "clamped", "free"])
@pytest.mark.parametrize("symmetric", [(True, True), (True, False), (False, False)])
def test_added_mass_is_symmetric_and_positive(support, symmetric):
    plate = replace(
        THIN,
        thickness_m=5e-3,
        support=support,
        liquid=LiquidParameters(depth_m=0.05),
        contact_x_m=0.0 if symmetric[0] else 0.05,
        contact_y_m=0.0 if symmetric[1] else -0.05,
    )
    x = np.linspace(0.0 if symmetric[0] else -0.35, 0.3 if symmetric[0] else 0.25, 9)
    y = np.linspace(0.0 if symmetric[1] else -0.2, 0.25 if symmetric[1] else 0.3, 8)
    x[np.argmin(np.abs(x))] = y[np.argmin(np.abs(y))] = 0.0
    parts = assemble_plate(plate, x, y, evaluate_thinning(x, y, PATCH_ANYWHERE), symmetric=symmetric)
    added = parts.added_mass @ np.eye(len(parts.load))
    assert np.max(np.abs(added - added.T)) <= 1e-14 * np.max(np.abs(added))  # rounding
    deflections = parts.free % 3 == 0
    assert np.all(added[~deflections] == 0.0)
    assert linalg.eigvalsh(added[np.ix_(deflections, deflections)]).min() > 0.0
    # One column at a time or all at once is the same.
    column = np.zeros(len(parts.load))
    column[int(np.flatnonzero(deflections)[7])] = 1.0
    np.testing.assert_array_equal(parts.added_mass @ column, added[:, np.flatnonzero(deflections)[7]])


def test_waveform_converges_in_the_number_of_sines():
    assert choose_sine_terms(PAPER_WET) == (256, 256)
    coarse = replace(PAPER_WET, elements_per_edge=48)
    depths = (0.0, 0.8)
    reference = shots(with_terms(coarse, CorrosionParameters(), 768), depths)
    errors = {}
    for highest in (64, 128, 256):
        found = shots(with_terms(coarse, CorrosionParameters(), highest), depths)
        for depth, one, other in zip(depths, found, reference, strict=True):
            n = min(len(one.force_n), len(other.force_n))
            difference = np.linalg.norm(one.force_n[:n] - other.force_n[:n])
            errors[highest, depth] = difference / np.linalg.norm(other.force_n[:n])
    assert errors[64, 0.8] > 1e-4 > 10 * errors[128, 0.8]
    # The usual number leaves less than a twentieth of the waveform's allowance, also over a deep patch; part
    # of it is that each liquid has a basis of its own.
    assert errors[256, 0.0] < 5e-6
    assert errors[256, 0.8] < 5e-6


def test_a_plate_too_long_for_its_thickness_is_refused():
    with pytest.raises(
        SpecimenError, match=r"needs \d+ sines along an edge, at most 4096 .* at most 1.536 m"
    ):
        choose_sine_terms(replace(THIN, width_m=3.0))
