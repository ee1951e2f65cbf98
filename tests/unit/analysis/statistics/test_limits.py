"""Limits and their names."""

import numpy as np
import pytest
from scipy import stats

from analysis.errors import InvalidInputError, NotEnoughSetsError
from analysis.statistics.limits import (
    F_PREDICTIVE,
    PAPER_MEAN_3SD,
    compute_limit_pair,
    f_predictive_limit,
    false_alarm_rate,
    paper_limit,
    phase_one_limit,
)


@pytest.mark.parametrize(("n", "limit"), [(24, 34.7), (48, 24.3), (200, 19.4)])
def test_predictive_limit_has_its_published_values(n, limit):
    assert f_predictive_limit(n, 5) == pytest.approx(limit, abs=0.05)  # three figures are printed


@pytest.mark.parametrize(("n", "p", "rate"), [(15, 5, 0.0027), (48, 3, 0.01), (500, 5, 1 / 43_830)])
def test_predictive_limit_is_the_scaled_f_quantile(n, p, rate):
    scale = p * (n + 1) * (n - 1) / (n * (n - p))
    expected = scale * stats.f.isf(rate, p, n - p)
    assert f_predictive_limit(n, p, rate) == pytest.approx(expected, rel=1e-9)
    assert false_alarm_rate(expected, n, p) == pytest.approx(rate, rel=1e-9)


def test_predictive_limit_tends_to_chi_square():
    # What is left of the estimated covariance goes with 1 / n.
    assert f_predictive_limit(10**7, 5) == pytest.approx(stats.chi2.isf(0.0027, 5), rel=1e-5)


def test_paper_limit_is_mean_and_three_standard_deviations():
    distances = np.array([1.0, 2.0, 3.0, 10.0])
    assert paper_limit(distances) == pytest.approx(4.0 + 3.0 * np.std(distances, ddof=1))


def test_screen_of_the_baseline_is_the_beta_limit():
    expected = 47**2 / 48 * stats.beta.isf(0.05 / 48, 2.5, 21.0)
    assert phase_one_limit(48, 5) == pytest.approx(expected, rel=1e-9)


def test_both_limits_come_named_with_their_rates():
    distances = np.random.default_rng(0).chisquare(5, 48)
    exact, paper = compute_limit_pair(distances, 5)
    assert (exact.name, paper.name) == (F_PREDICTIVE, PAPER_MEAN_3SD) == ("f_predictive", "paper_mean_3sd")
    assert exact.distance_squared == f_predictive_limit(48, 5)
    assert exact.false_alarm_rate == 0.0027
    assert paper.distance_squared == paper_limit(distances)
    assert paper.false_alarm_rate == false_alarm_rate(paper.distance_squared, 48, 5) > 0.0027


def test_bad_input_is_refused():
    with pytest.raises(NotEnoughSetsError, match="5 sets for 5 features"):
        f_predictive_limit(5, 5)
    with pytest.raises(InvalidInputError, match="rate is 0"):
        f_predictive_limit(48, 5, 0.0)
    with pytest.raises(InvalidInputError, match="p is 0"):
        false_alarm_rate(20.0, 48, 0)
    with pytest.raises(InvalidInputError, match="rate is 2"):
        f_predictive_limit(48, 5, 2.0)
    with pytest.raises(NotEnoughSetsError, match="at least 7"):
        phase_one_limit(6, 5)
    with pytest.raises(InvalidInputError, match="rate is 1"):
        phase_one_limit(48, 5, 1.0)
    with pytest.raises(NotEnoughSetsError, match="at least two"):
        paper_limit([3.0])
