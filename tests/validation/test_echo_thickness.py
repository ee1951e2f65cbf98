"""From the twin's wall through the record back to a thickness: bias, scatter, interval, refusal.

The rates are those that `benchmarks/echo_bias.py` prints with 200 walls a row; here other walls are drawn.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from support.benchmark_modules import benchmark_module

from analysis.ultrasound.thickness import compute_thickness, thickness_interval, travel_time
from simulator.echo.far_wall import FarWall
from simulator.echo.pulse import simulate_bubbles, simulate_echo

N_WALLS = 60


@pytest.fixture(scope="module")
def bias():
    return benchmark_module("echo_bias")


@pytest.mark.parametrize(
    "thickness_mm",
    [6.35, 3.8, 2.0, 1.5, *(pytest.param(t, marks=pytest.mark.slow) for t in (6.0, 5.0, 4.2, 3.0))],
)
def test_a_smooth_wall_is_read_without_bias_and_as_well_as_noise_allows(bias, thickness_mm):
    found = list(bias.readings(bias.SMOOTH, thickness_mm * 1e-3, N_WALLS))
    errors_m = np.array([reading.error_m for reading in found])
    assert {reading.found.quality for reading in found} == {"good"}
    # Rounding and the parabola move a pick by up to .1 um; at 1.5 mm the second echo runs into the first.
    bound_m = bias.pick_bound_m(bias.SMOOTH, thickness_mm * 1e-3)
    limit_m = (0.1e-6 if thickness_mm >= 2.0 else 1.5e-6) + 4.0 * bound_m / math.sqrt(N_WALLS)
    assert abs(errors_m.mean()) < limit_m
    # 60 draws know an SD to 9 %: four of those; the template's end at 5 % costs some more.
    assert 0.64 * bound_m < errors_m.std(ddof=1) < 1.4 * bound_m
    # What the reader says of its noise is this bound, from the record alone; echoes fill a part of the
    # record and add to its median difference: up to a quarter more, never much less.
    sds_m = [0.5 * 5900.0 * reading.found.travel_time_sd_s for reading in found]
    assert 0.9 * bound_m < min(sds_m) < max(sds_m) < 1.35 * bound_m
    assert np.mean([reading.held for reading in found]) >= 0.9


@pytest.mark.parametrize("exponent", [1.0, 4.0])
@pytest.mark.parametrize("attenuation_db_per_m", [0.0, 200.0, 1_000.0])
def test_attenuation_does_not_move_the_reading(bias, attenuation_db_per_m, exponent):
    echo = replace(bias.SMOOTH, attenuation_db_per_m=attenuation_db_per_m, attenuation_exponent=exponent)
    for thickness_m in (5e-3, 3.8e-3, 2e-3):
        found = travel_time(bias.waveform_of(simulate_echo(thickness_m, echo), echo), bias.sound_wall(echo))
        read_m = compute_thickness(
            found.travel_time_s, bias.sound_wall(echo).travel_time_s, 8e-6, 6.35e-3
        ).thickness_m
        # The pulse's centre falls with the way; its envelope stays where it is. Rounding: 4 codes in 100.
        assert read_m == pytest.approx(thickness_m, abs=1e-6)


def test_the_v_shaped_path_reads_too_thick_by_its_geometry(bias):
    echo = replace(bias.DEFAULT, roughness_fraction=0.0)
    reference = bias.sound_wall(echo)
    s = echo.element_separation_m
    for thickness_m in (6.0e-3, 4.2e-3, 3.8e-3, 2.0e-3):
        found = travel_time(bias.waveform_of(simulate_echo(thickness_m, echo), echo), reference)
        times = (found.travel_time_s, reference.travel_time_s, 8e-6, 6.35e-3)
        by_equation_17_m = 6.35e-3 * math.hypot(2 * thickness_m, s) / math.hypot(12.7e-3, s)
        # Neighbour echoes come at other multiples of the way than on a straight path: half a micrometre.
        assert compute_thickness(*times).thickness_m == pytest.approx(by_equation_17_m, abs=0.5e-6)
        assert compute_thickness(*times, s).thickness_m == pytest.approx(thickness_m, abs=1e-6)
    assert math.isnan(compute_thickness(8e-6 + 0.2e-6, reference.travel_time_s, 8e-6, 6.35e-3, s).thickness_m)


@pytest.mark.parametrize(
    ("fraction", "length_m", "thickness_m", "sd_m"),
    [
        (0.1, 2.4e-3, 3.8e-3, 0.21e-3),
        (0.2, 1.2e-3, 3.8e-3, 0.45e-3),
        pytest.param(0.2, 2.4e-3, 3.8e-3, 0.40e-3, marks=pytest.mark.slow),
    ],
)
def test_a_rough_wall_scatters_the_reading_and_widens_the_interval(
    bias, fraction, length_m, thickness_m, sd_m
):
    echo = replace(bias.STRAIGHT, roughness_fraction=fraction, correlation_length_m=length_m)
    found = [r for r in bias.readings(echo, thickness_m, 80, first_seed=1_000) if r.found.quality != "bad"]
    errors_m = np.array([reading.error_m for reading in found])
    # The errors are not normal: half-waves apart. Their mean of 60 is known to sd / 7.7, four of those.
    assert abs(errors_m.mean()) < 4.0 * sd_m / math.sqrt(errors_m.size)
    assert 0.5 * sd_m < errors_m.std(ddof=1) < 1.6 * sd_m
    low, _ = stats.binom.interval(1.0 - 1e-3, errors_m.size, 0.95)
    assert np.count_nonzero([reading.held for reading in found]) >= low


def test_where_the_echo_keeps_its_amplitude_the_roughness_is_read_from_it(bias):
    echo = replace(bias.STRAIGHT, roughness_fraction=0.1, attenuation_db_per_m=0.0)
    reference = bias.sound_wall(echo)
    for reading in bias.readings(echo, 5e-3, 20):
        interval = thickness_interval(reading.found, reference, 6.35e-3)
        # Heights under a beam are not quite Gaussian, and what is smeared adds a little to the crest.
        assert interval.roughness_rms_m == pytest.approx(reading.roughness_rms_m, rel=0.15)


@pytest.mark.parametrize("front_wall_v", [0.0, 0.02])
def test_without_a_back_wall_there_is_no_number(bias, front_wall_v):
    """With and without cross-talk: noise alone, and noise and bubbles."""
    echo = replace(bias.DEFAULT, front_wall_v=front_wall_v)
    reference = bias.sound_wall(echo)
    nothing = simulate_echo(FarWall(thickness_m=np.zeros(1), weights=np.ones(1)), echo)
    for seed in range(200):
        random = np.random.default_rng(seed)
        volts = nothing + 2.5e-3 * random.standard_normal(nothing.size)
        if seed % 2:
            volts += simulate_bubbles(3.8e-3, echo, random, 16).mean(axis=0)
        found = travel_time(bias.waveform_of(volts, echo), reference)
        assert found.quality == "bad"
        assert math.isnan(found.travel_time_s)
        interval = thickness_interval(found, reference, 6.35e-3)
        assert math.isnan(interval.low_m)
        assert math.isnan(interval.high_m)


def test_bubbles_move_a_reading_by_less_than_its_noise(bias):
    bubbly = replace(bias.SMOOTH, bubble_probability=1.0)
    calm = replace(bias.SMOOTH, bubble_probability=0.0)
    moved_m = [
        there.read_m - here.read_m
        for there, here in zip(
            bias.readings(bubbly, 3.8e-3, 40), bias.readings(calm, 3.8e-3, 40), strict=True
        )
    ]
    assert 0.0 < np.std(moved_m) < bias.pick_bound_m(bias.SMOOTH, 3.8e-3)


def test_a_lost_coupling_widens_the_interval_and_moves_nothing(bias):
    reference = bias.sound_wall(bias.SMOOTH)
    volts = simulate_echo(4e-3, bias.SMOOTH)
    found = [travel_time(bias.waveform_of(gain * volts, bias.SMOOTH), reference) for gain in (1.0, 0.3)]
    intervals = [thickness_interval(each, reference, 6.35e-3) for each in found]
    assert found[1].travel_time_s == pytest.approx(found[0].travel_time_s, abs=0.1e-9)
    assert found[1].amplitude_ratio == pytest.approx(0.3 * found[0].amplitude_ratio, rel=1e-3)
    assert intervals[1].high_m - intervals[1].low_m > 10.0 * (intervals[0].high_m - intervals[0].low_m)
