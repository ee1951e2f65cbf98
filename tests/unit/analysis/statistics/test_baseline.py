"""Baselines, distances and contributions."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.errors import InvalidInputError, NotEnoughSetsError, SingularCovarianceError
from analysis.statistics.baseline import fit_baseline, whitening_matrix
from analysis.statistics.distance import contributions, distance_squared, named_contributions
from analysis.statistics.limits import phase_one_limit
from analysis.waves.features import FEATURE_NAMES

CENTRE = np.array([330e-6, 329e-6, 0.5, 0.4, 1.8e-4])
SPREAD = np.array([1.6e-6, 1.5e-6, 0.0125, 0.006, 9e-6])


def healthy(n, seed=0):
    """Return feature vectors of realistic size, spread and correlation, shape (n, 5)."""
    random = np.random.default_rng(seed)
    common = random.standard_normal((n, 1))
    return CENTRE + SPREAD * (0.8 * common + 0.6 * random.standard_normal((n, 5)))


def fitted(n=48, seed=0):
    return fit_baseline(healthy(n, seed), range(n), name="B first 24 h")


def test_mean_covariance_and_distances_are_their_definitions():
    x = healthy(48)
    baseline = fit_baseline(x, range(48), name="B")
    deviation = x - x.mean(axis=0)
    covariance = deviation.T @ deviation / 47
    assert baseline.mean == pytest.approx(x.mean(axis=0))
    assert baseline.covariance.ravel() == pytest.approx(covariance.ravel(), rel=1e-12)
    # Equation 16 written out with an explicit inverse; features differ by 1e6 in size, so 1e-6 is fair.
    direct = np.einsum("ij,jk,ik->i", deviation, np.linalg.inv(covariance), deviation)
    assert baseline.distances_squared == pytest.approx(direct, rel=1e-6)
    assert distance_squared(x, baseline) == pytest.approx(baseline.distances_squared, rel=1e-12)
    # Own distances always sum to (n - 1) p.
    assert baseline.distances_squared.sum() == pytest.approx(47 * 5, rel=1e-9)
    assert (baseline.n, baseline.p, baseline.feature_names) == (48, 5, FEATURE_NAMES)


def test_contributions_sum_to_the_distance_and_name_the_feature_that_moved():
    baseline = fitted()
    vector = CENTRE + np.array([0.0, 0.0, 0.0, 0.0, 12.0]) * SPREAD
    parts = named_contributions(vector, baseline)
    assert sum(parts.values()) == pytest.approx(float(distance_squared(vector, baseline)), rel=1e-12)
    assert min(parts.values()) >= 0.0
    assert max(parts, key=parts.get) == "psw_area_v_s"


def test_vector_with_a_missing_feature_has_no_distance():
    vector = CENTRE.copy()
    vector[1] = np.nan
    assert np.isnan(distance_squared(vector, fitted()))


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(InvalidInputError, match="last axis"):
        distance_squared(np.zeros(4), fitted())
    with pytest.raises(InvalidInputError, match="must be"):
        named_contributions(np.zeros((2, 5)), fitted())
    with pytest.raises(InvalidInputError, match="need"):
        fit_baseline(np.zeros((48, 4)), range(48), name="B")


def test_contributions_of_many_sets_keep_their_shape():
    baseline = fitted()
    x = healthy(12, seed=3).reshape(3, 4, 5)
    assert contributions(x, baseline).shape == (3, 4, 5)
    assert distance_squared(x, baseline).shape == (3, 4)


@pytest.mark.parametrize("n", [0, 1, 14])
def test_fewer_than_fifteen_sets_are_refused_with_a_reason(n):
    with pytest.raises(NotEnoughSetsError, match=f"baseline of {n} sets; at least 15 are needed"):
        fit_baseline(healthy(n), range(n), name="B")


def test_fewer_than_forty_eight_sets_bring_a_warning():
    assert "24 sets, 48 advised" in " ".join(fitted(24).warnings)
    assert not any("advised" in warning for warning in fitted(48).warnings)


def test_suspect_set_is_named_and_kept():
    x = healthy(48)
    x[17] += 12.0 * SPREAD * np.array([1, -1, 1, -1, 1])
    baseline = fit_baseline(x, range(100, 148), name="B")
    assert baseline.suspects == (117,)
    assert baseline.suspect_limit == phase_one_limit(48, 5)
    assert baseline.n == 48
    assert "[117]" in " ".join(baseline.warnings)


def test_constant_feature_is_refused_by_name():
    x = healthy(48)
    x[:, 2] = 0.5
    with pytest.raises(SingularCovarianceError, match="amplitude_ratio constant"):
        fit_baseline(x, range(48), name="B")


def test_feature_that_copies_another_is_refused():
    x = healthy(48)
    x[:, 1] = 2.0 * x[:, 0] - 1e-5
    with pytest.raises(SingularCovarianceError, match="combination"):
        fit_baseline(x, range(48), name="B")


def test_missing_number_is_refused_with_its_set():
    x = healthy(48)
    x[3, 1] = np.nan
    with pytest.raises(InvalidInputError, match=r"sets \[103\]"):
        fit_baseline(x, range(100, 148), name="B")


def test_a_baseline_whose_shapes_contradict_each_other_is_refused():
    with pytest.raises(InvalidInputError, match="shapes"):
        replace(fitted(), mean=np.zeros(2))


def test_arrays_of_a_baseline_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        fitted().mean[0] = 0.0


def test_whitening_matrix_is_the_symmetric_inverse_root():
    correlation = fitted().correlation
    root = whitening_matrix(correlation)
    assert root == pytest.approx(root.T, abs=1e-12)
    assert root @ correlation @ root == pytest.approx(np.eye(5), abs=1e-12)
