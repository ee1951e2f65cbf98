"""A striker that strikes twice: the second time on a chain that still moves."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simulator.chain.spheres import build_chain
from simulator.parameters.chain import ChainParameters
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.shot.model import ENERGY_TOLERANCE, Impact, ShotModel

PATCH = CorrosionParameters()
WALL = PlateParameters(model="rigid_wall")
DELAYS_S = (100e-6, 250e-6, 400e-6, 600e-6)


def relative_l2(values, reference):
    return np.linalg.norm(values - reference) / np.linalg.norm(reference)


def bare_law_struck_twice(chain, time_s, delay_s, second_speed):
    """Force at the sensor from the bare law, DOP853; the striker is put back and launched at `delay_s`."""
    n, sensor = len(chain.mass_kg), chain.sensor

    def forces(y):
        d = y[:n] - np.append(y[1:n], 0.0)
        rate = y[n:] - np.append(y[n + 1 :], 0.0)
        law = chain.stiffness_n_per_m15 * np.maximum(d, 0.0) ** 1.5 + chain.damping_n_s_per_m * rate
        return np.where(d > 0.0, law, 0.0)

    def derivative(_, y):
        force = forces(y)
        pull = chain.gravity_m_per_s2 + (np.append(0.0, force[:-1]) - force) / chain.mass_kg
        return np.concatenate((y[n:], pull))

    y = np.zeros(2 * n)
    y[:n] = np.cumsum(chain.static_overlap_m[::-1])[::-1]
    y[n] = chain.impact_speed_m_per_s
    found = []
    for span in (time_s[time_s <= delay_s + 1e-12], time_s[time_s >= delay_s - 1e-12]):
        part = solve_ivp(
            derivative, (span[0], span[-1]), y, "DOP853", t_eval=span, rtol=1e-10, atol=1e-14, max_step=1e-6
        )
        assert part.success
        found.append(np.array([0.5 * forces(each)[sensor - 1 : sensor + 1].sum() for each in part.y.T]))
        y = part.y[:, -1].copy()
        y[0], y[n] = y[1], second_speed
    return np.concatenate((found[0], found[1][1:]))


@pytest.mark.parametrize(
    "delay_s", [250e-6, 600e-6, *(pytest.param(d, marks=pytest.mark.slow) for d in (100e-6, 400e-6))]
)
def test_agrees_with_an_integration_of_the_bare_law(delay_s):
    parameters = ChainParameters()
    impact = Impact(second_delay_s=delay_s, second_drop_height_m=3e-3)
    (force,) = ShotModel(parameters, WALL, PATCH, duration_s=1e-3).shots([impact])
    speed = math.sqrt(2 * 9.81 * 3e-3)
    expected = bare_law_struck_twice(build_chain(parameters, WALL), force.time_s, delay_s, speed)
    assert force.energy_residual <= ENERGY_TOLERANCE
    assert relative_l2(force.force_n, expected) < 1e-4  # the allowance of a waveform
    once = ShotModel(parameters, WALL, PATCH, duration_s=1e-3).shot()
    before = force.time_s <= delay_s
    np.testing.assert_array_equal(force.force_n[before], once.force_n[before])


def test_energy_balances_on_a_plate_for_any_delay(reduction_folder):
    plate = PlateParameters(elements_per_edge=32, contact_element_m=1e-3)
    model = ShotModel(ChainParameters(), plate, PATCH, cache_folder=reduction_folder)
    impacts = [
        Impact(second_delay_s=d, second_drop_height_m=h) for d in (20e-6, *DELAYS_S) for h in (1.5e-3, 5e-3)
    ]
    for force, impact in zip(model.shots(impacts), impacts, strict=True):
        assert force.energy_residual <= ENERGY_TOLERANCE
        np.testing.assert_array_equal(force.force_n, model.shots([impact])[0].force_n)


def test_a_strike_on_a_resting_chain_repeats_the_first_one():
    """After 40 ms with dashpots nothing moves: same wave, but for the sag of the striker's own weight."""
    heavy = ChainParameters(damping_n_s_per_m=300.0, contact_damping_n_s_per_m=300.0)
    model = ShotModel(heavy, WALL, PATCH, duration_s=42e-3, step_s=5e-7)
    (force,) = model.shots([Impact(second_delay_s=40e-3)])
    first = force.force_n[:1000] - force.preload_n
    second = force.force_n[80_000:81_000] - force.preload_n
    # The chain, no longer under the striker's weight, swings back a little: 0.3 N of 50 N.
    assert relative_l2(second, first) < 0.02


def test_the_sum_of_two_impacts_would_not_do(reduction_folder):
    """Waves shift each other where they meet, and the striker meets a chain that moves: tens of per cent."""
    model = ShotModel(
        ChainParameters(), PlateParameters(), PATCH, cache_folder=reduction_folder, duration_s=1.2e-3
    )
    first, second = model.shots([Impact(), Impact(drop_height_m=3e-3)])
    errors = {}
    for delay_s in DELAYS_S:
        (true,) = model.shots([Impact(second_delay_s=delay_s, second_drop_height_m=3e-3)])
        dynamic = [force.force_n - force.preload_n for force in (first, second, true)]
        later = round(delay_s / first.time_s[1])
        summed = dynamic[0] + np.append(np.zeros(later), dynamic[1][:-later])
        errors[delay_s] = relative_l2(summed, dynamic[2])
    assert all(0.1 < error < 0.5 for error in errors.values())


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"second_delay_s": 0.0}, "second_delay_s is 0.0; it must be positive"),
        ({"second_delay_s": math.nan}, "second_delay_s is nan"),
        ({"second_drop_height_m": 1e-3}, "without second_delay_s"),
    ],
)
def test_a_second_impact_needs_a_delay(keys, message):
    with pytest.raises(ValueError, match=message):
        Impact(**keys)


def test_the_second_height_obeys_the_bound_of_the_first():
    with pytest.raises(ValueError, match=r"drop_height_m is 2.0; it must be at most 1.0"):
        ShotModel(ChainParameters(), WALL, PATCH).shots(
            [Impact(second_delay_s=1e-4, second_drop_height_m=2.0)]
        )
