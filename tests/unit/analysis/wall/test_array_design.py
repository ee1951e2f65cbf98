"""Information of an array: covariance of a set, d', detectable loss, and the law of the amplitude ratio."""

import math

import numpy as np
import pytest

from analysis.errors import InvalidInputError
from analysis.statistics.limits import f_predictive_limit
from analysis.wall import array_design

SHOTS = 10
SET_SD, SHOT_SD = np.array([0.03, 0.0, 0.02]), np.array([0.02, 0.05, 0.0])
SLOPES = np.array([[1.0, -0.5], [0.3, 0.8], [0.0, 0.4]])
BENDS = np.array([[12.0, 0.0], [0.0, -9.0], [8.0, 5.0]])


def features(sources):
    """Return two features that are parabolas in three sources, shape (..., 3) to (..., 2)."""
    return 7.0 + sources @ SLOPES + sources**2 @ BENDS


def moved(sign):
    total = np.hypot(SET_SD, SHOT_SD)
    return features(sign * array_design.QUADRATURE_SD * np.diag(total))


def test_the_covariance_of_a_set_is_that_of_drawn_sets():
    random = np.random.default_rng(3)
    of_set = SET_SD * random.standard_normal((60_000, 1, 3))
    of_shot = SHOT_SD * random.standard_normal((60_000, SHOTS, 3))
    drawn = np.cov(features(of_set + of_shot).mean(axis=1).T)
    found = array_design.compute_set_covariance(
        moved(-1.0), features(np.zeros(3)), moved(1.0), set_sd=SET_SD, shot_sd=SHOT_SD, shots=SHOTS
    )
    # A variance of 60,000 draws has a standard error of 0.6 %, somewhat more with the tails of squares.
    np.testing.assert_allclose(found, drawn, rtol=0.03)


def test_the_distance_is_that_of_mahalanobis_in_any_units():
    covariance = np.array([[4.0, 1.0], [1.0, 9.0]])
    change = np.array([2.0, -3.0])
    expected = math.sqrt(change @ np.linalg.inv(covariance) @ change)
    units = np.diag([1e-6, 1e3])
    for scale in (np.eye(2), units):
        found = array_design.compute_distances([scale @ change], scale @ covariance @ scale)
        assert found == pytest.approx([expected], rel=1e-12)


@pytest.mark.parametrize(
    ("covariance", "reason"),
    [
        (np.ones((2, 2)), "singular"),
        (np.diag([1.0, 0.0]), "missing or does not scatter"),
        (np.full((2, 2), math.nan), "missing or does not scatter"),
    ],
)
def test_a_covariance_without_an_inverse_is_refused(covariance, reason):
    with pytest.raises(InvalidInputError, match=reason):
        array_design.compute_distances([[1.0, 1.0]], covariance)


def test_a_change_that_is_not_known_has_no_distance():
    found = array_design.compute_distances([[3.0, 4.0], [math.nan, 1.0]], np.eye(2))
    np.testing.assert_allclose(found, [5.0, math.nan])


def test_the_distance_of_simulated_sets_is_unbiased_and_free_of_the_sensors_offsets():
    random, shift = np.random.default_rng(5), np.array([1.5, 0.0, 0.0, 0.0, 0.0])
    offsets = 100.0 * random.standard_normal((400, 2, 1, 5))
    sound = offsets + random.standard_normal((400, 2, 12, 5))
    squared = [
        array_design.estimate_distances(sets, [sets + shift, sets + 2.0 * shift])[:2] ** 2 for sets in sound
    ]
    # 400 studies, each with a relative SD of d' squared of sqrt(2 / 16) = 0.35.
    np.testing.assert_allclose(np.mean(squared, axis=0), [2.25, 9.0], rtol=0.07)


def test_sets_without_features_are_left_out_and_too_few_are_refused():
    sound = np.random.default_rng(6).standard_normal((1, 40, 2))
    thinned = sound[None] + 1.0
    usual = array_design.estimate_distances(sound[:, :30], thinned[:, :, :30])
    thinned[0, 0, 30:, 1] = math.nan
    assert array_design.estimate_distances(sound, thinned) == pytest.approx(usual)
    thinned[0, 0, 3:] = math.nan
    with pytest.raises(InvalidInputError, match="3 complete sets of a sensor; d' needs 4"):
        array_design.estimate_distances(sound, thinned)


def test_the_required_distance_is_detected_in_nine_of_ten_sets():
    sets, features, rate, runs = 14, 5, 1e-3, 6000
    required = array_design.compute_detectable_distance(sets, features, rate)
    random, detected = np.random.default_rng(7), 0
    limit = f_predictive_limit(sets, features, rate)
    for _ in range(runs):
        baseline = random.standard_normal((sets, features))
        one = random.standard_normal(features) + required * np.eye(features)[0] - baseline.mean(axis=0)
        detected += one @ np.linalg.solve(np.cov(baseline.T), one) > limit
    assert detected / runs == pytest.approx(array_design.POWER, abs=0.015)  # three standard errors


def test_the_detectable_loss_is_interpolated_and_infinite_outside():
    losses, distances = [1.0, 2.0, 4.0], [2.0, 6.0, 5.0]
    assert array_design.find_detectable_loss(losses, distances, 1.0) == pytest.approx(0.5)
    assert array_design.find_detectable_loss(losses, distances, 4.0) == pytest.approx(1.5)
    assert array_design.find_detectable_loss(losses, distances, 5.5) == pytest.approx(1.875)
    assert array_design.find_detectable_loss(losses, distances, 6.1) == math.inf
    assert array_design.find_detectable_loss([], [], 1.0) == math.inf


def test_the_law_saturates_with_the_patch_and_grows_with_its_area_at_first():
    large = array_design.predict_ratio_slope(0.3, 0.03, 1e3)
    assert large == pytest.approx(-2.95 * 0.3)
    small = array_design.predict_ratio_slope(0.3, 0.03, 1e-6)
    assert small == pytest.approx(-2.95 * 2.9 * 0.3**2 * 1e-6 / 0.03, rel=1e-4)
    # The paper's array on its patch: lambda 0.258, 28.2 g, 7,800 kg/m3 x 6.35 mm x (25.4 mm)^2.
    assert array_design.predict_ratio_slope(0.2583, 0.0282, 0.03196) == pytest.approx(-0.436, abs=0.001)
