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
from simulator.shot.pulse_summary import summarise_pulses

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
        stiffness, mass = (matrix.toarray() for matrix in parts.at_depth(0.0))
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
    stiffness, mass = (matrix.toarray() for matrix in parts.at_depth(0.0))
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


def test_shallow_layer_moves_with_the_plate_and_deep_ones_are_alike():
    values = {}
    for depth_m in (1e-4, 0.3, 3.0):
        plate = replace(THIN, liquid=LiquidParameters(density_kg_per_m3=1000.0, depth_m=depth_m))
        parts = build_plate(replace(plate, elements_per_edge=24, contact_element_m=0.02), PATCH)
        x, y = np.meshgrid(parts.x_m, parts.y_m, indexing="ij")
        w = np.zeros((*x.shape, 3))
        w[:, :, 0] = np.cos(3 * np.pi * x / 0.6) * np.cos(np.pi * y / 0.5)
        shape = w.ravel()[parts.free]
        values[depth_m] = shape @ (parts.added_mass @ shape)
    # In proportion to the plate's own mass; (k H)^2 / 3 is below 1e-6, the rest are the sines left out.
    own = shape @ (parts.at_depth(0.0)[1] @ shape) / (plate.density_kg_per_m3 * plate.thickness_m)
    assert values[1e-4] == pytest.approx(own * 1000.0 * 1e-4, rel=1e-3)
    assert values[0.3] == pytest.approx(values[3.0], rel=1e-3)


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


def test_a_wet_shot_balances_its_energy_and_differs_from_a_dry_one(reduction_folder):
    dry, wet = (
        ShotModel(ChainParameters(), plate, CorrosionParameters(), cache_folder=reduction_folder)
        for plate in (PlateParameters(), PAPER_WET)
    )
    for depth in (0.0, 0.95):
        assert wet.shot(depth_fraction=depth).energy_residual <= 1e-5  # a tenth of what is demanded
    without, with_liquid = summarise_pulses(dry.shot()), summarise_pulses(wet.shot())
    # A heavier plate takes less energy and gives the wave back earlier.
    assert with_liquid.tof_us < without.tof_us - 1.0
    assert with_liquid.amplitude_ratio > 1.05 * without.amplitude_ratio
    deep = replace(PAPER_WET, liquid=LiquidParameters(depth_m=1.0))
    deeper = ShotModel(ChainParameters(), deep, CorrosionParameters(), cache_folder=reduction_folder)
    assert summarise_pulses(deeper.shot()).tof_us == pytest.approx(with_liquid.tof_us, abs=0.1)


def test_infinite_wet_thin_plate_is_approached():
    """Driving-point mobility of an infinite plate whose mass grows with the wave length.

    ``1 / (2 pi) int k dk i w / (D k^4 - w^2 (m + rho_f / k))`` with the growth rate of the Laplace domain.
    The finite plate answers alike as long as nothing comes back from its edges.
    """
    plate = replace(
        PAPER_WET,
        contact="patch",
        contact_radius_m=0.02,
        contact_element_m=2.5e-3,
        elements_per_edge=96,
        liquid=LiquidParameters(density_kg_per_m3=1000.0, depth_m=5.0),
    )
    parts = build_plate(plate, PATCH)
    modes = reduce_plate(parts).modes(0.0)
    bending, mass = 200e9 * 6.35e-3**3 / 12 / 0.91, 7800 * 6.35e-3
    shear = 5 / 6 * 6.35e-3 * 200e9 / 2.6
    for rate in (5e3, 2e4):

        def response(k, rate=rate):
            q = 0.02 * k
            weight = (3 * (np.sin(q) - q * np.cos(q)) / q**3) ** 2
            # Quasi-static shear; rotary inertia adds less than (k h)^2 / 12 of the mass.
            stiffness = 1.0 / (1.0 / (bending * k**4) + 1.0 / (shear * k**2))
            return weight * k / (stiffness + rate**2 * (mass + 1000.0 / k)) / (2 * np.pi)

        exact = integrate.quad(response, 1e-6, 3e3, limit=2000)[0]
        found = np.sum(modes.participation**2 / (modes.omega_rad_per_s**2 + rate**2))
        # What is left: rotary inertia and, at the lower rate, the edges.
        assert found == pytest.approx(exact, rel=5e-3)


def test_a_plate_too_long_for_its_thickness_is_refused():
    with pytest.raises(
        SpecimenError, match=r"needs \d+ sines along an edge, at most 4096 .* at most 1.536 m"
    ):
        choose_sine_terms(replace(THIN, width_m=3.0))
