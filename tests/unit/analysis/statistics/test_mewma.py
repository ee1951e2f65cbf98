import numpy as np
import pytest
from scipy.stats import chi2

from analysis.errors import InvalidInputError
from analysis.statistics.limits import f_predictive_limit
from analysis.statistics.mewma import average_run_length, estimated_limit, known_limit, mcusum, mewma


@pytest.mark.parametrize(
    # Prabhu and Runger (1997), Journal of Quality Technology 29, table 1 and text; told to .01 of the limit.
    ("p", "weight", "run_length", "limit"),
    [(4, 0.25, 500.0, 16.38), (4, 0.1, 200.0, 12.73), (2, 0.1, 200.0, 8.64)],
)
def test_limits_are_the_published_ones(p, weight, run_length, limit):
    assert known_limit(p, run_length, weight) == pytest.approx(limit, abs=0.015)
    assert average_run_length(known_limit(p, run_length, weight), p, weight) == pytest.approx(run_length)


@pytest.mark.parametrize(
    # Rigdon's equation with 300 nodes and another program's non-central chi-square.
    ("p", "limit"),
    [(1, 17.029972), (10, 38.385367), (48, 97.650261), (100, 167.070536)],
)
def test_limits_of_few_and_of_many_features(p, limit):
    assert known_limit(p, 43830.0) == pytest.approx(limit, rel=1e-6)


def test_with_a_thousand_features_the_equation_still_has_an_answer():
    # By the law of large numbers the statistic nears its mean, p (1 - .9^(2t)): passed at once below it.
    assert average_run_length(0.1 * 1500, 1500) == pytest.approx(1.0, abs=1e-6)
    assert 1500 < known_limit(1500, 500.0) < known_limit(1500, 43830.0) < 2000


def test_without_autocorrelation_it_is_the_chi_square_chart():
    # weight 1: the statistic is the set's own squared distance, 9.488 its 5 % point at p = 4.
    assert average_run_length(9.487729, 4, 1.0) == pytest.approx(20.0, rel=1e-4)


def test_simulated_run_length_is_that_of_the_equation():
    random, limit = np.random.default_rng(0), known_limit(5, 100.0)
    lengths = []
    for _ in range(400):
        statistic = mewma(random.standard_normal((1500, 5)))
        beyond = np.flatnonzero(statistic > limit)
        assert beyond.size  # 15 mean lengths
        lengths.append(beyond[0] + 1)
    # Lengths are nearly exponential: the mean of 400 has an SD of 5 %.
    assert np.mean(lengths) == pytest.approx(100.0, rel=0.2)


def test_an_estimated_baseline_widens_the_limit():
    narrow, wide = known_limit(5, 43830.0), estimated_limit(48, 5, 43830.0)
    chi_square = chi2.isf(1 / 43830.0, 5)
    expected = narrow * f_predictive_limit(48, 5, 1 / 43830.0) / chi_square * (1 + 1.9 / (0.1 * 48))
    assert wide == pytest.approx(expected, rel=1e-3)
    assert estimated_limit(10**6, 5, 43830.0) == pytest.approx(narrow, rel=1e-3)


def test_statistics_step_by_step_and_a_gap_leaves_them():
    w = np.random.default_rng(1).standard_normal((30, 3)) + 1.5
    w[7] = np.nan
    z, s = np.zeros(3), np.zeros(3)
    for row, averaged, summed in zip(w, mewma(w), mcusum(w), strict=True):
        if np.isnan(row).any():
            assert np.isnan(averaged)
            assert np.isnan(summed)
            continue
        z = 0.1 * row + 0.9 * z
        length = np.linalg.norm(s + row)
        s = (s + row) * max(0.0, 1.0 - 1.0 / length)
        assert averaged == pytest.approx(19.0 * z @ z)
        assert summed == pytest.approx(max(0.0, length - 1.0))
        assert summed == pytest.approx(np.linalg.norm(s))


@pytest.mark.parametrize("bad", [{"limit": 0.0, "p": 5}, {"limit": 1.0, "p": 0}])
def test_invalid_chart_parameters_are_refused(bad):
    with pytest.raises(InvalidInputError):
        average_run_length(**bad)
    with pytest.raises(InvalidInputError, match="more than 1 set"):
        known_limit(5, 1.0)
