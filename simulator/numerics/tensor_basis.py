"""Piecewise polynomials along one axis, for tensor-product elements.

On each interval the functions are Lagrange's on the Gauss-Lobatto-Legendre points of its degree; the
end points are shared, so that the functions are continuous. All integrals are exact.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import legendre

from simulator.numerics.arrays import FloatArray, IntArray

METRIC_POINTS = 20_001
"""Points of the numerical integral that places graded lines; the lines only need to be smooth."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Axis:
    """Axis of intervals and the degree of each.

    Attributes
    ----------
    breaks_m
        float64, shape (intervals + 1,), rising.
    degrees
        Degree of each interval.
    """

    breaks_m: FloatArray
    degrees: tuple[int, ...]

    @property
    def first(self) -> IntArray:
        """Return the number of the first node of each interval, then that of the last node.

        The shape is (intervals + 1,).
        """
        return np.concatenate(([0], np.cumsum(self.degrees)))

    @property
    def nodes_m(self) -> FloatArray:
        """Return the positions of all nodes in m, rising, shape (nodes,)."""
        pieces = [self.breaks_m[:1]]
        for start, end, degree in zip(self.breaks_m, self.breaks_m[1:], self.degrees, strict=False):
            pieces.append(start + 0.5 * (lobatto_points(degree)[1:] + 1.0) * (end - start))
            pieces[-1][-1] = end
        return np.concatenate(pieces)

    def nodes_of(self, interval: int) -> IntArray:
        """Return the node numbers of one interval, both ends included; shape (degree + 1,)."""
        first = self.first
        return np.arange(first[interval], first[interval + 1] + 1)

    def interval_matrices(self, interval: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute ``int N_i N_j``, ``int N_i' N_j``, ``int N_i' N_j'`` over an interval in m, as [i, j]."""
        length = float(self.breaks_m[interval + 1] - self.breaks_m[interval])
        mass, slope, stiffness = _reference_element_matrices(self.degrees[interval])
        return mass * (0.5 * length), slope, stiffness * (2.0 / length)

    def integrate_intervals(self, intervals: Iterable[int]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Sum the integrals of `interval_matrices` over some intervals; three arrays, (nodes, nodes) each."""
        count = int(self.first[-1]) + 1
        sums = np.zeros((3, count, count))
        for interval in intervals:
            nodes = np.ix_(self.nodes_of(interval), self.nodes_of(interval))
            for total, part in zip(sums, self.interval_matrices(interval), strict=True):
                total[nodes] += part
        return sums[0], sums[1], sums[2]

    def values(self, at_m: FloatArray) -> FloatArray:
        """Evaluate all shape functions at points in m, shape (points, nodes); extrapolate beyond the ends."""
        found = np.zeros((len(at_m), int(self.first[-1]) + 1))
        interval = np.clip(np.searchsorted(self.breaks_m, at_m, side="right") - 1, 0, len(self.degrees) - 1)
        for k in np.unique(interval):
            here = np.flatnonzero(interval == k)
            start, end = self.breaks_m[k], self.breaks_m[k + 1]
            natural = 2.0 * (at_m[here] - start) / (end - start) - 1.0
            found[np.ix_(here, self.nodes_of(int(k)))] = lagrange(self.degrees[k], natural)[0]
        return found


@cache
def lobatto_points(degree: int) -> FloatArray:
    """Compute the degree + 1 Gauss-Lobatto-Legendre points on -1..1, rising, both ends included.

    Cached: callers must not write to the result.
    """
    top = np.zeros(degree + 1)
    top[degree] = 1.0
    inner = np.sort(legendre.legroots(legendre.legder(top)).real)
    return np.concatenate(([-1.0], inner, [1.0]))


def lagrange(degree: int, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Evaluate Lagrange's polynomials on the Lobatto points and their derivatives at points on -1..1.

    Both arrays have the shape (points, degree + 1).
    """
    inverse = np.linalg.inv(legendre.legvander(lobatto_points(degree), degree))
    slopes = [legendre.legval(at, legendre.legder(unit)) for unit in np.eye(degree + 1)]
    return legendre.legvander(at, degree) @ inverse, np.stack(slopes, axis=-1) @ inverse


@cache
def _reference_element_matrices(degree: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compute mass, coupling and stiffness matrices on [-1, 1], shape (degree + 1, degree + 1) each.

    Cached: callers must not write to the results.
    """
    points, weights = legendre.leggauss(degree + 1)
    value, slope = lagrange(degree, points)
    weighted_value, weighted_slope = weights[:, None] * value, weights[:, None] * slope
    return value.T @ weighted_value, slope.T @ weighted_value, slope.T @ weighted_slope


def make_graded_breaks_m(
    length_m: float,
    *,
    features: Sequence[tuple[float, float]],
    growth: float,
    largest_m: float,
    stops_m: Sequence[float],
) -> FloatArray:
    """Return the breaks, rising in m, of intervals on 0 to `length_m` that are small at `features`.

    Parameters
    ----------
    features
        Place and size of an interval there, both in m.
    growth
        Size gained per distance.
    largest_m
        No interval grows beyond this.
    stops_m
        Positions in m that become breaks; those beyond `length_m` are left out.
    """
    lines = [0.0]
    inner = sorted(stop for stop in stops_m if 0.0 < stop < length_m * (1.0 - 1e-9))
    for end in (*inner, length_m):
        # Clustered at both ends, where the features are.
        at = lines[-1] + (end - lines[-1]) * 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, METRIC_POINTS)))
        sizes = [size + growth * np.abs(at - place) for place, size in features]
        per_size = 1.0 / np.minimum(np.min(sizes, axis=0), largest_m)
        passed = np.append(0.0, np.cumsum(np.diff(at) * 0.5 * (per_size[1:] + per_size[:-1])))
        count = max(1, round(float(passed[-1])))
        lines.extend(np.interp(np.linspace(0.0, passed[-1], count + 1)[1:], passed, at))
        lines[-1] = end
    return np.array(lines)
