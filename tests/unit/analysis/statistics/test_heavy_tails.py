"""The limit that allows for a baseline's tails, on tails of two kinds, and on none."""

import numpy as np
import pytest
from scipy.stats import f

from analysis.statistics.heavy_tails import HEAVY, left_out_distances, tail_limit
from analysis.statistics.limits import f_predictive_limit, predictive_scale

NEW = 1000


def rate_and_heavy(kind, n, p, runs=150):
    """Percent of new sets beyond the limit that the data choose, and how often it is the tails'."""
    random, beyond, heavy = np.random.default_rng([n, p]), [], 0
    for _ in range(runs):
        x = random.standard_normal((n + NEW, p))
        if kind == "each feature":
            x = random.standard_t(5, (n + NEW, p))
        elif kind == "whole sets":
            x /= np.sqrt(random.chisquare(5, (n + NEW, 1)))
        z = x - x[:n].mean(axis=0)
        covariance = np.atleast_2d(np.cov(x[:n], rowvar=False))
        distances = np.einsum("ij,jk,ik->i", z, np.linalg.inv(covariance), z)
        plain, allowing = f_predictive_limit(n, p), tail_limit(distances[:n], p)
        heavy += allowing > HEAVY * plain
        beyond.append(np.mean(distances[n:] > (allowing if allowing > HEAVY * plain else plain)))
    return 100.0 * np.mean(beyond), heavy / runs


@pytest.mark.parametrize("kind", ["each feature", "whole sets"])
@pytest.mark.parametrize(("n", "most_percent"), [(48, 0.75), (200, 0.45)])
def test_the_rate_is_kept_with_heavy_tails_of_both_kinds(kind, n, most_percent):
    rate, heavy = rate_and_heavy(kind, n, 5)
    assert 0.1 < rate < most_percent  # the mean of 150 baselines has an SD of some .03 %
    assert heavy > 0.8


@pytest.mark.parametrize(("p", "most"), [(2, 0.3), (5, 0.08)])
def test_small_distances_of_few_normal_features_make_no_heavy_tail(p, most):
    rate, heavy = rate_and_heavy("none", 200, p)
    assert 0.15 < rate < 0.35
    assert heavy < most


def test_one_gross_set_does_not_carry_the_fit_away():
    n, p = 100, 4
    scale = (n / (n - 1)) ** 2 * (n - 2)
    quantiles = predictive_scale(n - 1, p) * f.ppf((np.arange(n) + 0.5) / n, p, n - 1 - p)
    limits = []
    for farthest in (quantiles[-1], 150.0):
        quantiles[-1] = farthest  # 150: more than 12 standard deviations off
        distances = (n - 1) * quantiles / (scale + quantiles * n / (n - 1))
        assert left_out_distances(distances) == pytest.approx(quantiles)
        limits.append(tail_limit(distances, p) / f_predictive_limit(n, p))
    assert 1.0 < limits[0] < 1.15  # half a standard error of caution
    assert limits[0] < limits[1] < 1.6  # the set itself lies at 8 times the limit
