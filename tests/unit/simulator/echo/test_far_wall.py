"""The rough far wall: its field, how it grows with the depth, and what a sum over its facets returns."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from simulator.echo.far_wall import FarWall, draw_gaussian_field, draw_rough_spot
from simulator.echo.pulse import simulate_echo
from simulator.parameters.echo import EchoParameters

ROUGH = EchoParameters()
PRISTINE_M = 6.35e-3


def test_the_field_has_its_variance_and_correlation():
    length_m = 2e-3
    x_m = np.array([0.0, 1e-3, 2e-3, 3e-3])
    fields = np.array(
        [draw_gaussian_field(x_m, x_m, length_m, np.random.default_rng(seed)) for seed in range(1_500)]
    )
    products = (fields * fields[:, :1, :1]).mean(axis=0)
    distance_m = np.hypot(*np.meshgrid(x_m, x_m, indexing="ij"))
    # A mean of 1,500 products of unit normals scatters by at most sqrt(2 / 1500) = .037; four of those.
    np.testing.assert_allclose(products, np.exp(-((distance_m / length_m) ** 2)), atol=0.15)
    assert abs(fields.mean()) < 0.1
    # The fourth moment of 512 plane waves is 3 (1 - 1 / 1024); 24,000 correlated numbers know it to .3.
    assert (fields**4).mean() == pytest.approx(3.0, abs=0.3)


def test_the_mean_loss_under_the_beam_is_the_position_s_depth():
    spot = draw_rough_spot(ROUGH, seed=3, position="A")
    wall = spot.at(PRISTINE_M, 0.4)
    assert wall.mean_m == pytest.approx(0.6 * PRISTINE_M, rel=1e-12)
    assert np.all(spot.relative_loss > 0.0)
    assert spot.weights.sum() == pytest.approx(1.0, rel=1e-12)
    assert wall.least_m < wall.mean_m < wall.thickness_m.max() < PRISTINE_M


def test_the_wall_roughens_as_it_thins_and_no_spot_grows_back():
    spot = draw_rough_spot(ROUGH, seed=3, position="A")
    walls = [spot.at(PRISTINE_M, depth) for depth in (0.0, 0.1, 0.2, 0.4)]
    assert walls[0].rms_m == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose([wall.rms_m / walls[1].rms_m for wall in walls[2:]], [2.0, 4.0], rtol=1e-9)
    for earlier, later in itertools.pairwise(walls):
        assert np.all(later.thickness_m < earlier.thickness_m)


def test_the_loss_scatters_as_asked_for():
    logs = [
        np.log(draw_rough_spot(ROUGH, seed=seed, position="A").relative_loss[::500]) for seed in range(100)
    ]
    # Scaled to the mean under the beam, a spot keeps the part of the variance that varies within it.
    assert 0.5 * ROUGH.roughness_fraction < np.std(logs) < 1.1 * ROUGH.roughness_fraction


def test_every_seed_and_position_has_its_own_reproducible_wall():
    first = draw_rough_spot(ROUGH, seed=1, position="A").relative_loss
    np.testing.assert_array_equal(first, draw_rough_spot(ROUGH, seed=1, position="A").relative_loss)
    assert not np.array_equal(first, draw_rough_spot(ROUGH, seed=2, position="A").relative_loss)
    assert not np.array_equal(first, draw_rough_spot(ROUGH, seed=1, position="E").relative_loss)
    assert draw_rough_spot(replace(ROUGH, roughness_fraction=0.0), seed=1, position="A") is None


def test_the_facets_are_fine_enough():
    finer = draw_rough_spot(ROUGH, seed=1, position="A", facets_across=240).at(PRISTINE_M, 0.4)
    volts = simulate_echo(draw_rough_spot(ROUGH, seed=1, position="A").at(PRISTINE_M, 0.4), ROUGH)
    expected = simulate_echo(finer, ROUGH)
    # At the end of the paper's test: a hundredth of the echo.
    assert np.max(np.abs(volts - expected)) < 0.01 * np.max(np.abs(expected))


@pytest.mark.parametrize("sigma_m", [0.03e-3, 0.06e-3, 0.1e-3])
def test_the_coherent_echo_falls_as_the_kirchhoff_approximation_says(sigma_m):
    echo = replace(
        ROUGH, element_separation_m=0.0, multiple_ratio=0.0, front_wall_v=0.0, attenuation_db_per_m=0.0
    )
    n = 40_000
    heights_m = sigma_m * np.random.default_rng(5).standard_normal(n)
    weights = np.full(n, 1.0 / n)
    rough = np.fft.rfft(simulate_echo(FarWall(thickness_m=5e-3 + heights_m, weights=weights), echo))
    smooth = np.fft.rfft(simulate_echo(5e-3, echo))
    frequency_hz = np.fft.rfftfreq(echo.record_samples, 1.0 / echo.sample_rate_hz)
    band = np.abs(frequency_hz - 5e6) < 1.5e6
    wavenumber = 2.0 * np.pi * frequency_hz[band] / echo.velocity_m_per_s
    # The mean of n random phases scatters by at most 1 / sqrt(n) = .005; four of those.
    np.testing.assert_allclose(
        np.abs(rough[band] / smooth[band]),
        np.exp(-2.0 * (wavenumber * sigma_m) ** 2),
        atol=4.0 / math.sqrt(n),
    )


def test_facets_through_which_the_wall_is_gone_send_nothing_back():
    echo = replace(ROUGH, front_wall_v=0.0)
    half = FarWall(thickness_m=np.array([4e-3, 0.0]), weights=np.array([0.5, 0.5]))
    full = FarWall(thickness_m=np.array([4e-3]), weights=np.array([1.0]))
    np.testing.assert_allclose(simulate_echo(half, echo), 0.5 * simulate_echo(full, echo), atol=1e-12)
    gone = FarWall(thickness_m=np.zeros(2), weights=np.array([0.5, 0.5]))
    assert not np.any(simulate_echo(gone, echo))
