"""Memory along directions: of mixtures, of slow wander, and none where there is none."""

import numpy as np
import pytest
from support.healthy_sequences import UNEQUAL, remembering

from analysis.statistics.directions import compute_equivalent_phi, find_directions
from analysis.statistics.memory import pooled_phi


def test_directions_of_a_mixture_have_the_mixed_autocorrelations():
    random = np.random.default_rng(0)
    x = remembering(random.standard_normal((20_300, 5)), UNEQUAL)
    found = find_directions(x @ random.standard_normal((5, 5)))
    # An autocorrelation of 20,000 sets is known to .007.
    assert found.phi == pytest.approx(sorted(UNEQUAL, reverse=True), abs=0.02)
    along = (x - x.mean(axis=0)) @ find_directions(x).matrix
    assert np.cov(along, rowvar=False) == pytest.approx(np.eye(5), abs=1e-3)


@pytest.mark.parametrize("phi", [0.0, 0.6])
def test_common_autocorrelation_is_estimated_from_all_features(phi):
    random, found, pooled = np.random.default_rng(1), [], []
    for _ in range(100):
        x = remembering(random.standard_normal((500, 5)), phi)
        found.append(find_directions(x).phi)
        pooled.append(pooled_phi(x))
    # Eigenvalues alone would be .32 apart (200 sets, five directions); some baselines keep some of that.
    assert np.ptp(np.mean(found, axis=0)) < 0.1
    assert np.mean(found) == pytest.approx(np.mean(pooled), abs=0.02)


def test_autocorrelation_uses_neighbouring_sets_only_where_sets_are_missing():
    x = remembering(np.random.default_rng(2).standard_normal((9300, 5)), 0.8)
    x[2::3] = np.nan
    # Of 3,000 neighbours; half as much if sets without one counted.
    assert find_directions(x).phi == pytest.approx(np.full(5, 0.8), abs=0.05)


def test_the_guard_detects_autocorrelation_that_lag_1_hides():
    wander = remembering(np.random.default_rng(3).standard_normal((1300, 5)), 0.95)
    x = wander + 2.0 * np.random.default_rng(4).standard_normal((1000, 5))
    found = find_directions(x)
    assert found.phi.max() < 0.3  # .95 times the wander's fifth of the variance
    assert found.guarded.min() > 0.5


def test_phi_of_averages_is_that_of_first_order_memory():
    lags = np.arange(1, 200)
    # Of so many sets that their mean is known.
    assert compute_equivalent_phi(0.6**lags, 10**6) == pytest.approx(0.6, abs=1e-3)
    assert compute_equivalent_phi(np.full(20, 0.01), 100) == 0.0
