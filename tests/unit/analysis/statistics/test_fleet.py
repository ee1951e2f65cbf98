"""Many sensors: the chance of a chart's highest value, whom to raise, what all share."""

import numpy as np
import pytest
from scipy.stats import kstest
from support.healthy_sequences import UNEQUAL, healthy, remembering

from analysis.errors import InvalidInputError
from analysis.statistics.design import Budget
from analysis.statistics.fleet import (
    FEWEST_SENSORS,
    SHARED_SD,
    SharedChange,
    compute_running_p_values,
    estimate_gain,
    find_alarm_rows,
    find_shared_changes,
    mean_squared_correlation,
    residual_shift,
    shared_deviation,
    standardize_by_baseline,
    typical_autocorrelation,
    typical_kurtosis,
)
from analysis.statistics.mewma import compute_averages, estimated_limit
from analysis.statistics.sequence import assess_sequence

P = 5
NAMES = list("abcde")


def test_a_chart_at_its_limit_has_the_rate_of_its_run_length():
    limit = estimated_limit(200, P, 1000.0)
    chance = compute_running_p_values(np.array([np.nan, 1.0, limit, 2.0, np.nan]), 200, P, 250)
    # Between the table's run lengths the limit is nearly linear in their logarithm.
    assert chance == pytest.approx([1.0, 1.0, *3 * [1.0 - np.exp(-0.25)]], rel=0.01)


def test_chances_of_healthy_sensors_are_even():
    """With a baseline that is known nearly; the chance is exact for a run length that is geometric."""
    random = np.random.default_rng(3)
    sets, last = 400, []
    for _ in range(300):
        z = compute_averages(random.standard_normal((sets, P)), np.zeros(P))
        last.append(compute_running_p_values(19.0 * (z**2).sum(axis=1), 100_000, P, sets)[-1])
    small = np.array(last)[np.array(last) < 0.5]
    # Where it decides; near one the first sets after a zero start make a difference.
    assert kstest(small / 0.5, "uniform").pvalue > 0.01
    assert small.size / len(last) == pytest.approx(0.5, abs=0.1)  # three standard errors of 300


def test_raised_are_those_of_benjamini_and_hochberg_and_stay_raised():
    chances = np.array([[1.0, 0.04, 0.024], [1.0, 1.0, 0.5], [0.9, 0.03, 0.001], [0.2, 0.11, 0.11]])
    # Second set: .03 > .1/4 and .04 > .2/4 - no. 2nd of 4: .05 holds both; third: .001 and .024.
    assert find_alarm_rows(chances, 0.1) == [1, None, 1, None]
    assert find_alarm_rows(chances, 0.05) == [2, None, 2, None]
    assert find_alarm_rows(np.ones((3, 0))) == [None] * 3
    with pytest.raises(InvalidInputError, match="false discovery rate is 1"):
        find_alarm_rows(chances, 1.0)


def test_standardized_by_the_baseline_alone():
    vectors = np.array([[1.0, 7.0, np.nan], [3.0, 7.0, np.nan], [np.nan, 7.0, np.nan], [6.0, 8.0, 1.0]])
    z, sd = standardize_by_baseline(vectors, np.array([True, True, True, False]))
    assert sd.tolist() == [np.sqrt(2.0), 1.0, 1.0]
    assert z[:, 0] == pytest.approx([-(0.5**0.5), 0.5**0.5, np.nan, 4.0 / 2**0.5], nan_ok=True)
    assert np.isnan(z[:, 1:]).all()


def test_the_common_deviation_is_the_median_over_sensors():
    x = np.tile(np.array([2.0, -1.0]), (30, 3, 1))
    x[:5] += 50.0
    x[:12, 1] = np.nan  # 18 of 30 are left: too few
    x[:9, 2, 0] = np.nan
    assert shared_deviation(x).tolist() == [[2.0, -1.0], [0.0, 0.0], [2.0, -1.0]]
    assert not shared_deviation(x[: FEWEST_SENSORS - 1]).any()


def test_autocorrelation_and_tails_of_the_fleet_are_those_of_its_sensors():
    random = np.random.default_rng(9)

    def baselines(name):
        return [healthy(name, 100, random) for _ in range(60)]

    # A tenth of an SD is 1/sqrt(100); the median of 60 knows them to a fifth of it. Largest and least are
    # taken nearer to each other than they are, by up to another tenth.
    random_numbers = [random.standard_normal((400, P)) for _ in range(60)]
    unequal = [remembering(one, UNEQUAL) for one in random_numbers]
    assert typical_autocorrelation(unequal) == pytest.approx(sorted(UNEQUAL, reverse=True), abs=0.1)
    assert typical_autocorrelation(baselines("independent")) == pytest.approx(np.zeros(P), abs=0.06)
    normal, heavy = typical_kurtosis(baselines("independent")), typical_kurtosis(baselines("t5"))
    assert normal == 1.0  # Mardia's (n - 1)/(n + 1) of normal sets is below 1
    assert 1.5 < heavy < 3.0  # 3 of endless sets: (5 - 2)/(5 - 4); a hundred seldom hold the far ones
    empty = np.full((40, P), np.nan)
    assert typical_kurtosis([empty]) == 1.0
    assert not typical_autocorrelation([empty]).any()


def test_a_shared_shift_is_named_with_its_rows_and_size():
    shared = np.zeros((300, P))
    shared[100:160, 2] = -2.0
    (cause,) = find_shared_changes(shared, 100, 0.0, 50)
    # The average reaches .3 of -2 after two sets, and is below it 18 after the last.
    assert (cause.first_row, cause.last_row) == (101, 176)
    assert cause.largest_sd == pytest.approx((0.0, 0.0, -2.0, 0.0, 0.0), abs=0.01)
    assert find_shared_changes(shared, 100, 0.0, 120)[0].first_row == 120
    assert find_shared_changes(shared, FEWEST_SENSORS - 1, 0.0, 50) == ()


def test_one_changed_sensor_in_twenty_moves_the_median_little():
    random = np.random.default_rng(5)
    z = random.standard_normal((20, 2000, P))
    z[0, 500:] += 6.0
    shared = shared_deviation(z)
    assert find_shared_changes(shared, 20, 0.0, 0) == ()


def test_the_continuous_chart_equals_the_chart_until_its_first_alarm():
    random = np.random.default_rng(6)
    x = random.standard_normal((260, P))
    x[230:] += 5.0
    found = assess_sequence(x, np.arange(260) < 200, NAMES, Budget())
    first = found.onsets[0]
    assert np.array_equal(found.unbroken[: first + 1], found.chart[: first + 1], equal_nan=True)
    assert found.unbroken[-1] > found.chart_limit > found.chart[first + 1]


def test_features_that_move_together_have_correlated_errors():
    one = np.random.default_rng(2).standard_normal((500, 1))
    both = np.hstack([one, -one, np.random.default_rng(3).standard_normal((500, 1))])
    # An unrelated feature: squared correlations of 1/500 on average, five standard errors.
    np.testing.assert_allclose(
        mean_squared_correlation([both, both]), [[1, 1, 0], [1, 1, 0], [0, 0, 1]], rtol=0, atol=0.02
    )
    short = mean_squared_correlation([both[:5]])
    np.testing.assert_array_equal(short, np.eye(3))


def test_residual_weather_effects_of_unlike_sensors_are_detected():
    """A season of 2 SD; gains that scatter by a fifth leave three fifths of 2 SD with some sensors."""
    random = np.random.default_rng(5)
    shared = 2.0 * np.sin(np.arange(500) / 80.0)[:, None] * np.linspace(1.0, 0.2, P)
    causes = (SharedChange(first_row=0, last_row=499, largest_sd=(2.0, 0.4)),)
    usual = {"phi": 0.0, "n": 100, "tails": 1.0}

    def kept(scatter):
        gains = []
        for g in 1.0 + scatter * random.standard_normal(200):
            sd = random.standard_normal((usual["n"], P)).std(axis=0, ddof=1)  # as a baseline shows it
            gains.append(
                estimate_gain((g * shared + random.standard_normal(shared.shape)) / sd, shared, np.eye(P))
            )
        return residual_shift(gains, causes, **usual)

    # The scatter of 200 gains is known to 6 %, by their median deviation to about twice that.
    assert kept(0.2) == pytest.approx(3 * 0.2 * 2.0, rel=0.25)
    # Without taking off what chance makes: 3 x 2 SD x .045, which is .27.
    assert kept(0.0) < SHARED_SD / 2
    assert residual_shift([estimate_gain(shared, 0.0 * shared, np.eye(P))], causes, **usual) == 0.0
    assert residual_shift([(1.0, 0.1, 0.3), (3.0, 0.1, 0.3)], (), **usual) == 0.0
