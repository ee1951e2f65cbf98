"""Second-order trend of a feature over the test (the paper's regression lines, figures 8, 9 and 11)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.errors import InvalidInputError, NotEnoughPointsError
from analysis.waves.record_reduction import FloatArray

MINIMUM_POINTS = 4
"""Three coefficients and one degree of freedom for the residual."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """Parabola ``quadratic * t^2 + linear * t + constant`` through a feature, t in hours.

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
        """Return the parabola's values at the given hours, any shape, in the unit of the feature."""
        t = np.asarray(time_h, dtype=np.float64)
        return (self.quadratic * t + self.linear) * t + self.constant


def _too_few_points_error(n_points: int, n_times: int) -> NotEnoughPointsError:
    """Build (without raising) the error for too few points or times of a parabola."""
    return NotEnoughPointsError(
        f"a parabola through {n_points} points at {n_times} times; it needs at least "
        f"{MINIMUM_POINTS} points at 3 times: wait for more sets"
    )


def fit_trend(time_h: ArrayLike, values: ArrayLike) -> Trend:
    """Fit a least-squares parabola; points whose value is NaN are left out.

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
        raise _too_few_points_error(t.size, np.unique(t).size)
    origin_h, mean = float(t.mean()), float(y.mean())
    u = t - origin_h
    return _trend_from_factor(
        _triangular_factors(np.stack([np.ones_like(u), u, u * u, y - mean], axis=-1)), origin_h, mean, t.size
    )


def _triangular_factors(rows: FloatArray) -> FloatArray:
    """Return the triangular QR factors of matrices, shape (..., n, 4), as (..., min(n, 4), 4)."""
    triangle: FloatArray = np.linalg.qr(rows, mode="r")  # type: ignore[assignment] # declared for one mode only
    return triangle


def _trend_from_factor(triangle: FloatArray, origin_h: float, mean: float, n_points: int) -> Trend:
    """Compute a parabola from the triangular factor of ``[1, u, u^2, y - mean]``, shape (4, 4).

    u = t - origin_h in hours; the residual SD has n_points - 3 degrees of freedom.
    """
    c, b, a = np.linalg.solve(triangle[:3, :3], triangle[:3, 3])
    # The columns of the orthogonal factor: the first is the mean, the last what no parabola reaches.
    spread, residual = float((triangle[1:, 3] ** 2).sum()), float(triangle[3, 3] ** 2)
    return Trend(
        quadratic=float(a),
        linear=float(b - 2.0 * a * origin_h),
        constant=float(mean + c - b * origin_h + a * origin_h**2),
        r_squared=1.0 - residual / spread if spread > 0.0 else math.nan,
        residual_sd=math.sqrt(residual / (n_points - 3)),
        n_points=n_points,
    )


PART = np.dtype(
    [("n", "<f8"), ("first_h", "<f8"), ("last_h", "<f8"), ("mean", "<f8"), ("triangle", "<f8", (4, 4))]
)
"""All that a fit needs of some points: their number, first and last hour, mean, and the triangular factor
of ``[1, u, u^2, y - mean]``, u in hours since ``first_h``. Of no points the hours are infinite."""


def build_fit_parts(time_h: ArrayLike, values: ArrayLike) -> NDArray[np.void]:
    """Convert each point to a part of a least-squares fit, which `join_fit_parts` can join with others.

    Parameters
    ----------
    time_h, values
        Shapes (n,) and (n, n_values); NaN is no point.

    Returns
    -------
    NDArray
        Of `PART`, shape (n, n_values).
    """
    t, y = np.asarray(time_h, dtype=np.float64)[:, np.newaxis], np.asarray(values, dtype=np.float64)
    parts, present = np.zeros(y.shape, PART), np.isfinite(y)
    parts["n"] = parts["triangle"][..., 0, 0] = present
    parts["first_h"], parts["last_h"] = np.where(present, t, np.inf), np.where(present, t, -np.inf)
    parts["mean"] = np.where(present, y, 0.0)
    return parts


def join_fit_parts(parts: NDArray[np.void]) -> NDArray[np.void]:
    """Join parts of a fit along the first axis: equal to one part of all points up to rounding.

    Parameters
    ----------
    parts
        Of `PART`, shape (n_parts, n_values).

    Returns
    -------
    NDArray
        Of `PART`, shape (n_values,).
    """
    joined = np.zeros(parts.shape[1:], PART)
    some = parts["n"] > 0.0
    joined["n"] = parts["n"].sum(axis=0)
    joined["first_h"], joined["last_h"] = parts["first_h"].min(axis=0), parts["last_h"].max(axis=0)
    joined["mean"] = (parts["n"] * parts["mean"]).sum(axis=0) / np.maximum(joined["n"], 1.0)
    # [1, u + d, (u + d)^2, y - mean] as a matrix times the columns that a part was made of.
    moved = np.zeros((*parts.shape, 4, 4))
    moved[..., range(4), range(4)] = 1.0
    later_h = np.where(some, parts["first_h"], 0.0) - np.where(some, joined["first_h"], 0.0)
    moved[..., 0, 1], moved[..., 0, 2], moved[..., 1, 2] = later_h, later_h**2, 2.0 * later_h
    moved[..., 0, 3] = parts["mean"] - joined["mean"]
    rows = np.moveaxis(parts["triangle"] @ moved, 0, 1).reshape(parts.shape[1], -1, 4)
    joined["triangle"] = _triangular_factors(rows)
    return joined


def fit_trend_of_part(part: np.void) -> Trend:
    """Fit a least-squares parabola through the points of one part, as `fit_trend` does.

    ``part`` is one element of the dtype `PART`. The points are due times of sets, which all differ.

    Raises
    ------
    NotEnoughPointsError
        Fewer than four points.
    """
    n_points = int(part["n"])
    if n_points < MINIMUM_POINTS:
        raise _too_few_points_error(n_points, n_points)
    return _trend_from_factor(part["triangle"], float(part["first_h"]), float(part["mean"]), n_points)
