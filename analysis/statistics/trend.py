"""Second-order trend of a feature over the test (the paper's regression lines, figures 8, 9 and 11)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.errors import InvalidInputError, NotEnoughPointsError
from analysis.waves.record_reduction import FloatArray

MINIMUM_POINTS = 4
"""Three coefficients and one degree of freedom for the residual."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """A parabola ``quadratic * t^2 + linear * t + constant`` through a feature, t in hours.

    Attributes
    ----------
    quadratic, linear, constant
        In units of the feature per h^2, per h and 1.
    r_squared
        Coefficient of determination; NaN where the feature is constant.
    residual_sd
        Residual standard deviation with n - 3 degrees of freedom.
    n_points
        Points with a finite value.
    """

    quadratic: float
    linear: float
    constant: float
    r_squared: float
    residual_sd: float
    n_points: int

    def at(self, time_h: ArrayLike) -> FloatArray:
        """Value at the given hours, any shape."""
        t = np.asarray(time_h, dtype=np.float64)
        return (self.quadratic * t + self.linear) * t + self.constant


def fit_trend(time_h: ArrayLike, values: ArrayLike) -> Trend:
    """Least-squares parabola; points whose value is NaN are left out.

    Parameters
    ----------
    time_h, values
        Shape (n,).

    Raises
    ------
    InvalidInputError
        Shapes differ, or a time is not finite.
    NotEnoughPointsError
        Fewer than four points, or fewer than three different times.
    """
    t_all, y_all = np.asarray(time_h, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if t_all.ndim != 1 or t_all.shape != y_all.shape:
        raise InvalidInputError(f"time_h and values need one shape (n,), got {t_all.shape} and {y_all.shape}")
    if not np.isfinite(t_all).all() or np.isinf(y_all).any():
        raise InvalidInputError("time_h must be finite, values finite or NaN")
    present = ~np.isnan(y_all)
    t, y = t_all[present], y_all[present]
    if t.size < MINIMUM_POINTS or np.unique(t).size < 3:
        raise NotEnoughPointsError(
            f"a parabola through {t.size} points at {np.unique(t).size} times; it needs at least "
            f"{MINIMUM_POINTS} points at 3 times: wait for more sets"
        )
    # Centred and scaled time keeps the normal equations well conditioned at any hour.
    centre, scale = t.mean(), np.abs(t - t.mean()).max()
    design = np.vander((t - centre) / scale, 3, increasing=True)
    c, b, a = np.linalg.lstsq(design, y, rcond=None)[0]
    residual = y - design @ np.array([c, b, a])
    spread = float(((y - y.mean()) ** 2).sum())
    return Trend(
        quadratic=float(a / scale**2),
        linear=float(b / scale - 2.0 * a * centre / scale**2),
        constant=float(c - b * centre / scale + a * (centre / scale) ** 2),
        r_squared=1.0 - float(residual @ residual) / spread if spread > 0.0 else math.nan,
        residual_sd=math.sqrt(float(residual @ residual) / (t.size - 3)),
        n_points=int(t.size),
    )
