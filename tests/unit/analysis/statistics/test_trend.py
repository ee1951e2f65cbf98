"""Second-order trend."""

import math

import numpy as np
import pytest

from analysis.errors import InvalidInputError, NotEnoughPointsError
from analysis.statistics.trend import fit_trend

TIME_H = np.linspace(0.5, 350.0, 425)


def test_parabola_is_recovered():
    trend = fit_trend(TIME_H, 2e-4 * TIME_H**2 - 0.03 * TIME_H + 325.0)
    # Rounding grows with (350 h)^2 / 1: 1e-10 leaves room over 1e-16 * 1e5.
    assert trend.quadratic == pytest.approx(2e-4, rel=1e-10)
    assert trend.linear == pytest.approx(-0.03, rel=1e-9)
    assert trend.constant == pytest.approx(325.0, rel=1e-10)
    assert trend.r_squared == pytest.approx(1.0, abs=1e-12)
    assert trend.residual_sd == pytest.approx(0.0, abs=1e-10)
    assert trend.at([0.0, 100.0]) == pytest.approx([325.0, 324.0], rel=1e-10)


def test_noise_and_goodness_of_fit_match_their_definitions():
    values = 1e-4 * TIME_H**2 + np.random.default_rng(1).normal(0.0, 2.0, TIME_H.size)
    trend = fit_trend(TIME_H, values)
    residual = values - np.polyval(np.polyfit(TIME_H, values, 2), TIME_H)
    assert trend.residual_sd == pytest.approx(math.sqrt(residual @ residual / 422), rel=1e-9)
    assert trend.r_squared == pytest.approx(1 - residual.var() / values.var(), rel=1e-9)


def test_missing_values_are_left_out():
    values = 3.0 * TIME_H
    holed = values.copy()
    holed[::3] = np.nan
    assert fit_trend(TIME_H, holed).linear == pytest.approx(3.0, rel=1e-9)
    assert fit_trend(TIME_H, holed).n_points == np.isfinite(holed).sum()


def test_constant_feature_has_no_goodness_of_fit():
    assert math.isnan(fit_trend(TIME_H, np.full(TIME_H.size, 4.0)).r_squared)


@pytest.mark.parametrize("time_h", [[0, 1, 2], [0, 0, 1, 1, 1], []])
def test_too_few_points_are_refused(time_h):
    with pytest.raises(NotEnoughPointsError, match="wait for more sets"):
        fit_trend(time_h, np.zeros(len(time_h)))


def test_bad_input_is_refused():
    with pytest.raises(InvalidInputError, match="shape"):
        fit_trend([0, 1, 2, 3], [0, 1, 2])
    with pytest.raises(InvalidInputError, match="finite"):
        fit_trend([0, 1, 2, math.inf], [0, 1, 2, 3])
    with pytest.raises(InvalidInputError, match="finite"):
        fit_trend([0, 1, 2, 3], [0, 1, 2, math.inf])
