"""Second-order trend."""

import math

import numpy as np
import pytest

from analysis.errors import InvalidInputError, NotEnoughPointsError
from analysis.statistics.trend import build_fit_parts, fit_trend, fit_trend_of_part, join_fit_parts

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


@pytest.mark.parametrize("from_h", [0.0, 499_000.0])
def test_joined_parts_give_the_same_parabola(from_h):
    """However the points are divided, at hour 0 and after half a century; a part may lack its values."""
    rng, hours = np.random.default_rng(3), from_h + TIME_H
    strays = rng.normal(0.0, 1e-9, (TIME_H.size, 2))
    values = 6e-3 - 1e-9 * TIME_H[:, np.newaxis] - 2e-11 * TIME_H[:, np.newaxis] ** 2 + strays
    values[rng.random(values.shape) < 0.2] = np.nan
    values[64:128] = np.nan
    points = build_fit_parts(hours, values)
    joined = join_fit_parts(np.stack([join_fit_parts(some) for some in np.split(points, [1, 64, 128, 300])]))
    for part, column in zip(joined, values.T, strict=True):
        trend, whole = fit_trend_of_part(part), fit_trend(hours, column)
        present = np.isfinite(column)
        assert (part["first_h"], part["last_h"]) == (hours[present][0], hours[present][-1])
        assert trend.n_points == whole.n_points == present.sum()
        # u^2 up to (350 h)^2 loses five digits of sixteen at most, told about hour 0 five more.
        for name in ("quadratic", "linear", "constant") if from_h == 0.0 else ("quadratic",):
            assert getattr(trend, name) == pytest.approx(getattr(whole, name), rel=1e-9), name
        assert trend.r_squared == pytest.approx(whole.r_squared, rel=1e-9)
        assert trend.residual_sd == pytest.approx(whole.residual_sd, rel=1e-9)


def test_parts_of_too_few_points_are_refused():
    points = build_fit_parts([0.0, 1.0, 2.0, 3.0], [[0.0], [1.0], [math.nan], [1.0]])
    with pytest.raises(NotEnoughPointsError, match="3 points at 3 times"):
        fit_trend_of_part(join_fit_parts(points)[0])
