"""Processes with memory: the statistics that are stated, and each value alone as in any order."""

import numpy as np
import pytest
from scipy import stats

from hardware_drivers.measurement import SetKey
from simulator.experiment import processes
from simulator.experiment.processes import (
    LAGS,
    compute_ar1_weights,
    draw_autocorrelated_values,
    draw_slow_drift,
    draw_unit_t,
    draw_values_after_reseats,
    evaluate_slow_drift,
    is_noisy_hour,
)
from simulator.numerics.keyed_random import Purpose

WIDE, SETS = 1_000, 80
DRAWN = (
    processes._draw_innovations,
    processes._draw_reseats,
    processes.draw_slow_drift,
    processes.is_noisy_hour,
)


def series(memory, dof=5.0, seed=1, sets=SETS, first=0, unscheduled=0):
    """Shape (sets, WIDE): as many independent processes side by side."""
    weights = compute_ar1_weights(np.full(WIDE, memory))
    return np.array(
        [
            draw_autocorrelated_values(
                weights, dof, seed=seed, position="B", set_key=SetKey(first + k, unscheduled)
            )
            for k in range(sets)
        ]
    )


@pytest.mark.parametrize("memory", [0.0, 0.3, 0.6, 0.8])
def test_the_autocorrelation_of_sets_is_that_of_an_ar1_process(memory):
    # Across the first blocks' border, where a window takes its innovations from two of them.
    x = series(memory, first=LAGS - SETS // 2)
    # Products of t5 scatter more than those of a normal: 4 of 1 / sqrt(n), widened by kurtosis and memory.
    slack = 4.0 * np.sqrt(3.0 * (1.0 + memory) / (1.0 - memory) / x.size)
    assert x.mean() == pytest.approx(0.0, abs=slack)
    assert x.var() == pytest.approx(1.0, abs=slack)
    for lag in (1, 2, 5):
        assert (x[lag:] * x[:-lag]).mean() == pytest.approx(memory**lag, abs=slack)


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_an_unscheduled_set_is_correlated_with_the_scheduled_set_before_it(memory):
    last = LAGS - 1  # the next planned set lies in the next block
    planned, following = series(memory, sets=2, first=last)
    unscheduled, another = (series(memory, sets=1, first=last, unscheduled=n)[0] for n in (1, 2))
    # As between neighbouring planned sets. 4 of 1 / sqrt(n), widened by the kurtosis of t5.
    slack = 4.0 * np.sqrt(3.0 / WIDE)
    assert (unscheduled * planned).mean() == pytest.approx(memory, abs=slack)
    assert (unscheduled * following).mean() == pytest.approx(memory**2, abs=slack)
    assert (unscheduled * another).mean() == pytest.approx(memory**2, abs=slack)
    assert not np.any(unscheduled == following)


def test_the_tails_are_student_s():
    dof = 5.0
    x = series(0.0, dof).ravel()  # without memory a value is one innovation
    unit = stats.t(dof, scale=np.sqrt((dof - 2.0) / dof))
    assert stats.kstest(x, unit.cdf).pvalue > 1e-3
    beyond = np.abs(x) > 4.0
    low, high = stats.binom.interval(1.0 - 1e-4, x.size, 2.0 * unit.sf(4.0))
    assert low <= beyond.sum() <= high
    assert high > low > 20.0 * x.size * 2.0 * stats.norm.sf(4.0), "a normal one has not a twentieth of these"
    assert draw_unit_t(np.random.default_rng(1), 1e3, 200_000).std() == pytest.approx(
        1.0, abs=4.0 / np.sqrt(4e5)
    )


def test_a_slow_drift_has_its_standard_deviation():
    drawn = draw_slow_drift(Purpose.SEATING_WANDER, 1, "B", 4_000, 48.0, 1_000.0)
    now = evaluate_slow_drift(100.0, drawn)
    # Sums of eight sinusoids: their variance is 1 and scatters less than that of a normal.
    assert now.std() == pytest.approx(1.0, abs=4.0 / np.sqrt(2 * now.size))
    later = evaluate_slow_drift(101.0, drawn)
    steepest_per_h = 2.0 * np.pi / 48.0 * np.sqrt(2.0 * processes.WANDER_TERMS)
    assert np.abs(later - now).max() < steepest_per_h
    assert np.corrcoef(now, later)[0, 1] > 0.99
    assert abs(np.corrcoef(now, evaluate_slow_drift(5_000.0, drawn))[0, 1]) < 0.2


def test_re_seats_come_at_their_rate_go_either_way_and_stay():
    rate_per_h, hours = 0.002, 100_000.0
    count, _ = draw_values_after_reseats(hours, rate_per_h, seed=1, position="B", size=3)
    low, high = stats.poisson.interval(1.0 - 1e-4, rate_per_h * hours)
    assert low <= count <= high
    places, hour_of = [], []
    before, seen = np.zeros(3), 0
    for hour in np.arange(0.0, 20_000.0, 20.0):
        now_count, now = draw_values_after_reseats(float(hour), rate_per_h, seed=1, position="B", size=3)
        if now_count == seen:
            np.testing.assert_array_equal(now, before)
        else:
            places.append(now)
            hour_of.append(hour)
        before, seen = now, now_count
    above = np.array(places) > 0.0
    assert len(places) > 25
    low, high = stats.binom.interval(1.0 - 1e-4, above.size, 0.5)
    assert low <= above.sum() <= high
    first_h = min(hour_of)
    assert draw_values_after_reseats(first_h - 20.0, rate_per_h, seed=1, position="B", size=3)[0] == 0
    assert draw_values_after_reseats(hours, 0.0, seed=1, position="B", size=3)[0] == 0


def test_the_noisy_hours_have_their_rate_and_are_common_to_all_positions():
    found = [is_noisy_hour(1, hour, 0.1) for hour in range(2_000)]
    low, high = stats.binom.interval(1.0 - 1e-4, len(found), 0.1)
    assert low <= sum(found) <= high
    assert found != [is_noisy_hour(2, hour, 0.1) for hour in range(2_000)]


def test_every_value_is_independent_of_the_order_of_computation():
    def values_of(set_index):
        weights = compute_ar1_weights(np.linspace(0.0, 0.8, 5))
        return np.concatenate(
            [
                draw_autocorrelated_values(weights, 5.0, seed=3, position="C", set_key=SetKey(set_index)),
                evaluate_slow_drift(
                    0.5 * set_index, draw_slow_drift(Purpose.SEATING_WANDER, 3, "C", 5, 48.0, 1_000.0)
                ),
                draw_values_after_reseats(10.0 * set_index, 0.01, seed=3, position="C", size=5)[1],
            ]
        )

    order = [0, 1, 63, 64, 65, 127, 128, 424]
    forth = {index: values_of(index) for index in order}
    for drawn in DRAWN:
        drawn.cache_clear()  # as a new process would begin
    for index in reversed(order):
        np.testing.assert_array_equal(values_of(index), forth[index])
