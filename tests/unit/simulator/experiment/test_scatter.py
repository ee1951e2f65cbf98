"""Scatter and drift: sizes as asked for, scaled, switched off, keyed."""

from dataclasses import replace

import numpy as np
import pytest

from hardware_drivers.measurement import ShotKey
from simulator.experiment.scatter import draw_room_temperature, draw_scattered_strike
from simulator.parameters.chain import ChainParameters
from simulator.parameters.electronics import SensorParameters
from simulator.parameters.experiment import DriftParameters, ScatterParameters

SETS, SHOTS = 400, 10
CHAIN, SENSOR, DRIFT = ChainParameters(), SensorParameters(), DriftParameters()


def strike(key, *, seed=1, chain=CHAIN, scatter=None, temperature_c=DRIFT.mean_temperature_c):
    return draw_scattered_strike(
        key,
        seed=seed,
        chain=chain,
        scatter=scatter or ScatterParameters(),
        drift=DRIFT,
        sensor=SENSOR,
        temperature_c=temperature_c,
    )


def key(set_index=0, shot_index=0, position="B", attempt=0):
    return ShotKey(position=position, set_index=set_index, shot_index=shot_index, attempt=attempt)


def table(scatter):
    """Logarithm of drop height over nominal, and tilt: shape (2, SETS, SHOTS)."""
    strikes = [[strike(key(i, j), scatter=scatter) for j in range(SHOTS)] for i in range(SETS)]
    drop = np.log([[s.drop_height_m for s in row] for row in strikes]) - np.log(CHAIN.drop_height_m)
    return np.array([drop, [[s.tilt_rad for s in row] for row in strikes]])


def test_set_and_shot_parts_have_the_standard_deviations_asked_for():
    scatter = ScatterParameters()
    drop, tilt = table(scatter)
    for values, set_sd, shot_sd in (
        (drop, scatter.set_drop_height_sd_fraction, scatter.shot_drop_height_sd_fraction),
        (tilt, scatter.set_tilt_sd_rad, scatter.shot_tilt_sd_rad),
    ):
        # A standard deviation from n draws scatters by 1 / sqrt(2 n) of itself: 4 of these.
        within = np.sqrt(values.var(axis=1, ddof=1).mean())
        assert within == pytest.approx(shot_sd, rel=4.0 / np.sqrt(2 * SETS * (SHOTS - 1)))
        between = np.sqrt(set_sd**2 + shot_sd**2 / SHOTS)
        assert values.mean(axis=1).std(ddof=1) == pytest.approx(between, rel=4.0 / np.sqrt(2 * SETS))


def test_scale_multiplies_every_deviation():
    once, twice = table(ScatterParameters(scale=1.0)), table(ScatterParameters(scale=2.0))
    np.testing.assert_allclose(twice[0], 2.0 * once[0], rtol=1e-9, atol=1e-15)
    mean = ScatterParameters().mean_tilt_rad
    upright = mean + 2.0 * (once[1] - mean)
    # Past upright the disk leans to the other side; rounding is a few ulp of the mean.
    np.testing.assert_allclose(twice[1], np.abs(upright), rtol=1e-12, atol=1e-15)


def test_scale_zero_is_the_nominal_strike():
    off = ScatterParameters(scale=0.0)
    for j in range(3):
        assert strike(key(5, j), scatter=off).drop_height_m == CHAIN.drop_height_m
        assert strike(key(5, j), scatter=off).tilt_rad == off.mean_tilt_rad
    tilted = replace(CHAIN, tilt_rad=0.01)
    assert strike(key(), chain=tilted, scatter=off).tilt_rad == pytest.approx(
        0.01 + off.mean_tilt_rad, rel=1e-15
    )


def test_strikes_depend_on_their_key_alone():
    assert strike(key(3, 4)) == strike(key(3, 4))
    others = [strike(key(3, 4), seed=2), strike(key(3, 5)), strike(key(4, 4)), strike(key(3, 4, "C"))]
    others.append(strike(key(3, 4, attempt=1)))
    assert len({s.drop_height_m for s in [strike(key(3, 4)), *others]}) == 6
    assert len({s.tilt_rad for s in [strike(key(3, 4)), *others]}) == 6


def test_extreme_scatter_stays_within_the_chains_bounds():
    wild = ScatterParameters(
        scale=10.0, set_drop_height_sd_fraction=0.2, set_tilt_sd_rad=0.05, mean_tilt_rad=0.1
    )
    strikes = [strike(key(i), scatter=wild) for i in range(300)]
    assert all(0.0 < s.drop_height_m <= 1.0 for s in strikes)
    assert all(0.0 <= s.tilt_rad <= 0.2 for s in strikes)
    assert max(s.tilt_rad for s in strikes) == 0.2


def test_temperature_acts_on_drop_height_and_sensitivity_only():
    cold, warm = strike(key()), strike(key(), temperature_c=DRIFT.mean_temperature_c + 5.0)
    growth_m = DRIFT.guide_length_m * DRIFT.guide_expansion_per_k * 5.0
    # Rounding: heights near 5 mm differ by some 50 um, known to 1e-18 m.
    assert warm.drop_height_m - cold.drop_height_m == pytest.approx(growth_m, rel=1e-12)
    ratio = warm.sensor_gain_v_per_n / cold.sensor_gain_v_per_n
    assert ratio == pytest.approx(np.exp(5.0 * DRIFT.sensitivity_per_k), rel=1e-14)
    assert warm.tilt_rad == cold.tilt_rad


def test_tilt_lowers_the_sensitivity():
    off = ScatterParameters(scale=0.0, mean_tilt_rad=0.0)
    straight = strike(key(), scatter=off).sensor_gain_v_per_n
    tilted = strike(key(), scatter=replace(off, mean_tilt_rad=0.02)).sensor_gain_v_per_n
    assert straight == SENSOR.sensitivity_v_per_n
    assert tilted == pytest.approx(straight * np.exp(-0.02 * SENSOR.tilt_loss_per_rad), rel=1e-14)


def test_temperature_has_a_day_and_a_slow_wander():
    hours = np.arange(0.0, 350.0, 0.25)
    room = draw_room_temperature(DRIFT, seed=1)
    readings = np.array([room.at(h) for h in hours])
    day = DRIFT.diurnal_amplitude_k * np.cos(2.0 * np.pi * (hours - DRIFT.warmest_hour_h) / 24.0)
    wander = readings - DRIFT.mean_temperature_c - day
    slowest_rate = 2.0 * np.pi / DRIFT.shortest_wander_h * DRIFT.wander_sd_k * np.sqrt(2.0 * 8)
    assert np.max(np.abs(np.diff(wander))) <= 0.25 * slowest_rate
    assert readings[30] == room.at(float(hours[30]))
    assert not np.allclose(
        readings, [draw_room_temperature(DRIFT, seed=2).at(h) for h in hours], rtol=0.0, atol=0.1
    )


def test_the_slow_drift_has_the_configured_standard_deviation():
    still = replace(DRIFT, diurnal_amplitude_k=0.0)
    readings = np.array(
        [draw_room_temperature(still, seed=s).at(100.0) - still.mean_temperature_c for s in range(2_000)]
    )
    # Four standard errors of a standard deviation of n draws.
    assert readings.std() == pytest.approx(still.wander_sd_k, rel=4.0 / np.sqrt(2 * 2_000))


def test_drift_off_is_the_mean_temperature():
    room = draw_room_temperature(replace(DRIFT, enabled=False), seed=1)
    assert {room.at(h) for h in (0.0, 7.3, 300.0)} == {DRIFT.mean_temperature_c}
