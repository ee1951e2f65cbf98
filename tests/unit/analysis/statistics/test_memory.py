import numpy as np
import pytest
from support.healthy_sequences import remembering

from analysis.errors import InvalidInputError
from analysis.statistics.memory import (
    autocorrelation,
    corrected_autocorrelation,
    effective_sets,
    pooled_phi,
    prewhiten_sets,
    significant_phi,
)


def test_autocorrelation_is_that_of_numpy_and_gaps_keep_their_place():
    x = np.random.default_rng(0).standard_normal((40, 2))
    z = x - x.mean(axis=0)
    expected = [np.correlate(z[2:, k], z[:-2, k])[0] / np.correlate(z[:, k], z[:, k])[0] for k in range(2)]
    assert autocorrelation(x, 2) == pytest.approx(expected)
    gap = np.insert(x, 20, np.nan, axis=0)
    # Pairs over the gap are no neighbours: the mean of the others stands for them.
    z1 = z[1:] * z[:-1]
    without = np.delete(z1, 19, axis=0).mean(axis=0) * 39 / 40
    # One more row lies between first and last, with nothing in it.
    assert autocorrelation(gap, 1) == pytest.approx(without / (z**2).mean(axis=0))


def test_a_constant_feature_has_no_autocorrelation():
    x = np.random.default_rng(0).standard_normal((20, 2))
    x[:, 1] = 3.0
    assert autocorrelation(x, 1)[1] == 0.0
    with pytest.raises(InvalidInputError, match="lag 20"):
        autocorrelation(x, 20)


@pytest.mark.parametrize("phi", [0.0, 0.3, 0.6])
def test_pooled_phi_has_a_negligible_bias(phi):
    found = [
        pooled_phi(remembering(np.random.default_rng(seed).standard_normal((348, 5)), phi))
        for seed in range(200)
    ]
    # SD of one estimate about .07 (five features of 48 sets): .005 of the mean. Clipping lifts 0 by .03.
    assert np.mean(found) == pytest.approx(phi, abs=0.045 if phi == 0.0 else 0.025)


def test_corrected_autocorrelation_is_clipped_and_small_values_are_zero():
    assert corrected_autocorrelation([-0.5, 0.9999], 48).tolist() == [0.0, 0.95]
    assert significant_phi(0.2, 48) == 0.0  # 1.64/sqrt(48) = .237
    assert significant_phi(0.3, 48) == 0.3
    assert effective_sets(48, 0.5) == pytest.approx(16.0)


@pytest.mark.parametrize("phi", [0.0, 0.6])
def test_prewhitened_sets_are_alike_over_any_gap(phi):
    x = remembering(np.random.default_rng(5).standard_normal((20300, 5)), phi)
    gaps = np.random.default_rng(6).random(20000) < 0.3
    x[gaps] = np.nan
    e = prewhiten_sets(x, np.zeros(5), phi)
    assert np.isnan(e[gaps]).all()
    after_gap = ~gaps & np.roll(gaps, 1)
    after_none = ~gaps & ~np.roll(gaps, 1)
    for rows in (after_gap, after_none):
        # Variance of n normal values has a relative SD of sqrt(2/n): below .008 of some 20,000 values.
        assert e[rows].var() == pytest.approx(1.0 - phi**2, rel=0.035)
    kept = e[~gaps]
    assert abs(np.mean(kept[1:] * kept[:-1])) < 0.02
