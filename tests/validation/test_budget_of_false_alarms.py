"""Alarms of the default limit and chart on healthy sequences (at length: `benchmarks/false_alarms.py`)."""

import numpy as np
import pytest
from support.healthy_sequences import healthy

from analysis.statistics.baseline import fit_baseline
from analysis.statistics.default_limit import default_limit
from analysis.statistics.sequence import assess_sequence

NEW_SETS = 3000


def assessment_of(name, n, seed):
    x = healthy(name, n + NEW_SETS, np.random.default_rng([seed, n]))
    return assess_sequence(x, np.arange(len(x)) < n, list("abcde"), textbooks=False)


@pytest.mark.parametrize(
    ("name", "n", "most_percent"),
    [("independent", 48, 0.4), ("AR .6", 48, 0.4), ("t5", 200, 0.6)],
)
def test_the_default_limit_keeps_its_rate_with_memory_and_tails(name, n, most_percent):
    rates, plain, alarms = [], [], 0
    for seed in range(25):
        found = assessment_of(name, n, seed)
        rates.append(100.0 * found.count["default"] / NEW_SETS)
        plain.append(100.0 * found.count["f_predictive"] / NEW_SETS)
        alarms += len(found.onsets)
    # One baseline's rate has an SD of some .2 to .3 %: .06 % of the mean of 25, and .27 % is the nominal one.
    assert 0.08 < np.mean(rates) < most_percent
    if name != "independent":
        assert np.mean(plain) > 3.0 * np.mean(rates)
    # 25 x 3,000 sets are 1.7 times five years: a budget of one each; six or more have a chance of 1 %.
    assert alarms < 6


@pytest.mark.parametrize("n_features", [5, 10])
def test_the_default_limit_allows_for_features_that_jump_each_by_itself(n_features):
    n, rates = 200, []
    names = [f"feature {k}" for k in range(n_features)]
    for seed in range(200):
        x = np.random.default_rng([seed, n_features]).standard_t(5, (n + NEW_SETS, n_features))
        limit = default_limit(x[:n], fit_baseline(x[:n], range(n), name="t5", feature_names=names))
        rates.append(100.0 * np.mean(limit.distances_squared(x)[n:] > limit.limit))
    # One baseline's rate has an SD of some .5 %: .035 % of the mean of 200, and .45 % is allowed.
    assert 0.2 < np.mean(rates) < 0.45
