"""Probability of detection: published factors, closed forms, invariance, coverage, refusals."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats
from support.benchmark_modules import benchmark_module

from analysis.errors import InvalidInputError, NotEnoughDataError
from analysis.statistics.detection_probability import (
    PROBABILITIES,
    bound_quantile,
    compute_rate_interval,
    compute_tolerance_factor,
    fit_detection_losses,
    fit_signal_response,
)

# B-basis factors (90 % with 95 % confidence) of CMH-17-1G, as the tests of the R package cmstatr list them.
PUBLISHED = {3: 6.157, 4: 4.163, 5: 3.408, 6: 3.007, 7: 2.756, 10: 2.355, 12: 2.211, 36: 1.725, 108: 1.515}
LOSS_M = np.array([0.31, 0.42, 0.45, 0.58, 0.6, 0.77, 0.9, 1.1]) * 1e-3


def signals(k=8, looks=6, between=0.3, seed=1):
    """Return sensor, loss and signal of looks at losses that all sensors share."""
    random = np.random.default_rng(seed)
    loss_m = np.tile(np.geomspace(0.2e-3, 2e-3, looks), k)
    noise = np.repeat(between * random.standard_normal(k), looks) + 0.1 * random.standard_normal(k * looks)
    return [f"s{i // looks}" for i in range(k * looks)], loss_m, 2e3 * loss_m**1.2 * np.exp(noise)


@pytest.mark.parametrize(("n", "factor"), PUBLISHED.items())
def test_the_factor_is_the_published_one(n, factor):
    """The handbook's own values are up to 0.0017 off the exact ones, see the next test."""
    assert compute_tolerance_factor(n, 0.9) == pytest.approx(factor, abs=2e-3)


@pytest.mark.parametrize("n", [3, 6, 10, 20, 108])
def test_mean_plus_the_factor_is_above_the_quantile_with_95_percent(n):
    """Integrates the probability over the distribution of the standard deviation."""
    factor, z = compute_tolerance_factor(n, 0.9), stats.norm.ppf(0.9)

    def density(sd):
        chi = sd * math.sqrt(n - 1)
        return stats.norm.cdf(math.sqrt(n) * (factor * sd - z)) * stats.chi.pdf(chi, n - 1) * math.sqrt(n - 1)

    assert integrate.quad(density, 0.0, 10.0, points=[1.0])[0] == pytest.approx(0.95, abs=1e-6)


def test_the_factor_of_50_values_at_95_95_is_the_one_of_owens_program():
    assert compute_tolerance_factor(50, 0.95) == pytest.approx(2.064993399768, rel=1e-7)


def test_complete_losses_have_the_exact_bound():
    found, logs = fit_detection_losses(range(8), LOSS_M, np.ones(8)), np.log(LOSS_M)
    assert (found.n_sensors, found.n_detected) == (8, 8)
    assert found.a50_m == pytest.approx(stats.gmean(LOSS_M), rel=1e-9)
    assert found.a90_m == pytest.approx(
        math.exp(logs.mean() + stats.norm.ppf(0.9) * logs.std(ddof=1)), rel=1e-9
    )
    # 2.583: the published factor of eight values (2.5825 rounded).
    assert found.a90_95_m == pytest.approx(math.exp(logs.mean() + 2.583 * logs.std(ddof=1)), rel=5e-4)
    assert np.all(np.diff(found.bound_m) > 0.0)
    assert np.all(found.bound_m > found.loss_m)


def test_censored_losses_have_the_parameters_that_scipy_finds():
    is_seen = LOSS_M <= 0.8e-3
    values = np.log(np.minimum(LOSS_M, 0.8e-3))
    found = fit_detection_losses(range(8), np.exp(values), is_seen)
    mean, sd = stats.norm.fit(stats.CensoredData.right_censored(values, ~is_seen))
    n = is_seen.sum()
    assert math.log(found.a50_m) == pytest.approx(mean, abs=1e-3)
    spread = math.log(found.a90_m / found.a50_m) / stats.norm.ppf(0.9)
    assert spread == pytest.approx(sd * math.sqrt(n / (n - 1)), rel=1e-3)


def test_a_detection_that_is_only_known_to_be_later_raises_the_bound():
    everything, values = np.ones(8, dtype=bool), np.log(LOSS_M)
    seen = everything.copy()
    seen[-1] = False
    assert bound_quantile(values, seen, 0.9) > bound_quantile(values, everything, 0.9)
    # A sensor that was censored before any detection says nothing: the bound is that of the others.
    early = np.append(values, math.log(1e-9))
    bound = bound_quantile(early, np.append(everything, False), 0.9)
    assert bound == pytest.approx(bound_quantile(values, everything, 0.9), abs=1e-4)


@settings(max_examples=20, deadline=None)
@given(factor=st.floats(1e-3, 1e3), n_censored=st.integers(0, 3))
def test_a_factor_on_all_losses_is_a_factor_on_the_result(factor, n_censored):
    is_seen = np.arange(8) < 8 - n_censored
    one, other = (fit_detection_losses(range(8), c * LOSS_M, is_seen) for c in (1.0, factor))
    np.testing.assert_allclose(other.loss_m, factor * one.loss_m, rtol=1e-4)
    np.testing.assert_allclose(other.bound_m, factor * one.bound_m, rtol=1e-4)


@given(factor=st.floats(1e-2, 1e2), gain=st.floats(1e-2, 1e2))
def test_units_of_losses_and_signals_only_scale_the_result(factor, gain):
    sensors, loss_m, signal = signals()
    one = fit_signal_response(sensors, loss_m, signal, 0.3)
    other = fit_signal_response(sensors, factor * loss_m, gain * signal, 0.3 * gain)
    assert other.slope == pytest.approx(one.slope, rel=1e-6)
    np.testing.assert_allclose(other.bound_m, factor * one.bound_m, rtol=1e-4)


def test_equal_losses_at_each_sensor_give_the_estimates_of_the_analysis_of_variance():
    k, looks = 8, 6
    sensors, loss_m, signal = signals(k, looks)
    x, y = np.log(loss_m).reshape(k, looks), np.log(signal).reshape(k, looks)
    slope = stats.linregress(x.ravel(), y.ravel()).slope
    residuals = y - slope * x
    within = ((residuals - residuals.mean(axis=1, keepdims=True)) ** 2).sum() / (k * looks - k - 1)
    between = looks * residuals.mean(axis=1).var(ddof=1)
    found = fit_signal_response(sensors, loss_m, signal, 0.3)
    assert found.slope == pytest.approx(slope, rel=1e-9)
    assert found.sd_looks == pytest.approx(math.sqrt(within), rel=1e-3)
    assert found.sd_sensors == pytest.approx(math.sqrt((between - within) / looks), rel=1e-3)
    scatter = math.hypot(found.sd_looks, found.sd_sensors)
    at_a90 = found.intercept + found.slope * math.log(found.a90_m)
    assert at_a90 == pytest.approx(math.log(0.3) + stats.norm.ppf(0.9) * scatter, rel=1e-9)
    assert found.a90_95_m > found.a90_m


def test_a_signal_that_hardly_rises_has_no_finite_bound():
    random = np.random.default_rng(5)
    sensors, loss_m, _ = signals()
    signal = loss_m**0.05 * np.exp(0.5 * random.standard_normal(loss_m.size))
    found = fit_signal_response(sensors, loss_m, signal, 1.0)
    assert found.slope > 0.0
    assert math.isinf(found.a90_95_m)
    with pytest.raises(InvalidInputError, match="does not rise with the loss: slope -1"):
        fit_signal_response(sensors, loss_m, 1e-3 / loss_m * np.exp(0.1 * random.standard_normal(48)), 1.0)


def test_the_rate_without_an_event_has_the_limit_in_closed_form():
    assert compute_rate_interval(0, 30) == (0.0, pytest.approx(1.0 - 0.025 ** (1 / 30), rel=1e-9))
    low, high = compute_rate_interval(30, 30)
    assert (low, high) == (pytest.approx(0.025 ** (1 / 30), rel=1e-9), 1.0)


@pytest.mark.parametrize(
    ("sensors", "losses", "detected", "error", "reason"),
    [
        (
            "aabcdefg",
            LOSS_M,
            [1] * 8,
            InvalidInputError,
            "sensor 'a' has 2 values, which are not independent",
        ),
        (
            "abcde",
            LOSS_M[:5],
            [1] * 5,
            NotEnoughDataError,
            "5 sensors with a wall loss; a POD needs at least 6",
        ),
        (
            "abcdefgh",
            LOSS_M,
            [1, 1] + 6 * [0],
            NotEnoughDataError,
            "2 sensors with a detection; a POD needs 3",
        ),
        ("abcdefgh", [0.0, *LOSS_M[1:]], [1] * 8, InvalidInputError, "above 0"),
        ("abcdefgh", [math.nan, *LOSS_M[1:]], [1] * 8, InvalidInputError, "finite"),
        ("abcdefgh", [1e-3] * 8, [1] * 8, InvalidInputError, "all losses at detection are 0.001 m"),
        ("abcdefgh", LOSS_M, [1] * 7, InvalidInputError, r"one shape \(n,\), got 8, \(8,\), \(7,\)"),
    ],
    ids=["looks", "sensors", "detections", "sound", "nan", "equal", "shape"],
)
def test_a_study_that_cannot_give_a_bound_is_refused(sensors, losses, detected, error, reason):
    with pytest.raises(error, match=reason):
        fit_detection_losses(sensors, losses, detected)


@pytest.mark.parametrize(
    ("chosen", "threshold", "error", "reason"),
    [
        (slice(0, 30), 0.3, NotEnoughDataError, "5 sensors"),
        (slice(None, None, 6), 0.3, NotEnoughDataError, "8 looks at 8 sensors"),
        (slice(None), 0.0, InvalidInputError, "threshold 0 and each signal must be above 0"),
    ],
    ids=["sensors", "one look", "threshold"],
)
def test_signals_that_cannot_give_a_slope_are_refused(chosen, threshold, error, reason):
    sensors, loss_m, signal = signals()
    with pytest.raises(error, match=reason):
        fit_signal_response(sensors[chosen], loss_m[chosen], signal[chosen], threshold)


@pytest.fixture(scope="module")
def benchmark():
    return benchmark_module("detection_probability")


@pytest.mark.parametrize("censored", [0.0, 0.1, 0.3])
def test_the_bound_covers(benchmark, censored):
    """Of 400 studies 95 % within three standard errors (1.1 %): 2,000 are the benchmark's."""
    random = np.random.default_rng(7)
    covered = [benchmark.cover_losses(random, 10, censored, "random") for _ in range(400)]
    bounds = [one for one in covered if one is not None]
    assert len(bounds) > 390
    assert 0.917 < np.mean(bounds) < 0.983


def test_the_bound_of_signals_covers(benchmark):
    """In 2,000 studies 96.5 % (benchmark): 400 have a standard error of 0.9 %."""
    random = np.random.default_rng(8)
    assert np.mean([benchmark.cover_signals(random, 6, 1.0) for _ in range(400)]) > 0.935


def test_pooled_looks_do_not_cover(benchmark):
    """Pooled looks as independent ones, which the fit refuses, cover in about 61 % of the studies."""
    random = np.random.default_rng(9)
    assert np.mean([benchmark.cover_pooled(random, 10, 0.9) for _ in range(400)]) < 0.75


@pytest.mark.slow
def test_all_bounds_cover_in_2000_studies(benchmark, monkeypatch):
    monkeypatch.setattr("sys.argv", ["detection_probability.py", "--json"])
    assert benchmark.main() == 0


def test_the_curve_has_the_probabilities_of_its_names():
    found = fit_detection_losses(range(8), LOSS_M, np.ones(8))
    assert found.a50_m == found.loss_m[PROBABILITIES == 0.5]
    assert found.a90_m == found.loss_m[PROBABILITIES == 0.9]
    assert found.a90_95_m == found.bound_m[PROBABILITIES == 0.9]
