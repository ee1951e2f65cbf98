"""Grid lines along one edge of a plate: fine at the contact, on the edges of the patches, coarse far away."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import scipy  # `scipy.optimize` comes when asked for

from simulator.errors import SpecimenError
from simulator.numerics.arrays import FloatArray, IntArray

SAME_LINE = 1e-9
"""Lines nearer to each other than this part of the edge are one: rounding of offset and size."""


def make_graded_half_edge(length_m: float, elements: int, first_m: float, edge_m: float) -> FloatArray:
    """Place grid lines from 0 to `length_m`, the first at `first_m`, one at `edge_m`.

    Two geometric progressions meet at the edge of the patch, the second continuing the sizes of the
    first; their lengths are chosen so that the two growth factors differ least.
    Raise SpecimenError if ``edge_m`` is below ``first_m``.

    Returns
    -------
    float64, shape (elements + 1,)
    """
    if edge_m < first_m:
        raise SpecimenError(
            f"half the patch is {edge_m} m, less than the elements at the contact ({first_m} m); "
            f"make plate.contact_element_m smaller"
        )
    if edge_m > length_m * (1.0 - SAME_LINE):
        return _grow_lines(0.0, length_m, first_m, _find_growth_of_sum(first_m, elements, length_m), elements)
    best: tuple[float, FloatArray] | None = None
    for inner in range(1, elements):
        growth = _find_growth_of_sum(first_m, inner, edge_m)
        left = _grow_lines(0.0, edge_m, first_m, growth, inner)
        last = left[-1] - left[-2]
        outer_growth = _find_outer_growth(last, elements - inner, length_m - edge_m)
        misfit = abs(math.log(growth / outer_growth))
        if best is None or misfit < best[0]:
            right = _grow_lines(edge_m, length_m, last * outer_growth, outer_growth, elements - inner)
            best = misfit, np.concatenate((left, right[1:]))
    assert best is not None  # elements >= 4
    return best[1]


def _find_growth_of_sum(first_m: float, elements: int, length_m: float) -> float:
    """Find the growth factor r with ``first (1 + r + ... + r^(n-1)) = length``.

    A single element takes the complete length.
    """
    if elements == 1:
        return length_m / first_m
    largest = (length_m / first_m) ** (1.0 / (elements - 1))  # the last element alone fills the length
    return _solve_growth(lambda r: first_m * np.sum(r ** np.arange(elements)) - length_m, largest)


def _find_outer_growth(last_m: float, elements: int, length_m: float) -> float:
    """Find the growth factor r with ``last (r + r^2 + ... + r^n) = length``."""
    largest = (length_m / last_m) ** (1.0 / elements)
    return _solve_growth(lambda r: last_m * np.sum(r ** np.arange(1, elements + 1)) - length_m, largest)


def _solve_growth(excess: Callable[[float], float], largest: float) -> float:
    """Find the root between 0 and ``largest`` of the excess length over the growth factor."""
    # Rounding must not leave the root of a single element outside.
    return float(scipy.optimize.brentq(excess, 0.0, largest * (1.0 + 1e-9), xtol=1e-15, rtol=1e-14))


def _grow_lines(start_m: float, end_m: float, first_m: float, growth: float, elements: int) -> FloatArray:
    """Place grid lines from `start_m` to `end_m` whose distances grow by a constant factor."""
    lines = start_m + np.concatenate(([0.0], np.cumsum(first_m * growth ** np.arange(elements))))
    lines[-1] = end_m
    return np.asarray(lines)


def make_graded_edge(
    start_m: float, end_m: float, elements: int, first_m: float, lines_m: Sequence[float]
) -> FloatArray:
    """Place grid lines from `start_m` <= 0 to `end_m`, the contact at 0, one at each of `lines_m`.

    On either side of the contact the first element is `first_m` long. Beyond, the size grows in
    proportion to the distance, ``first + g (|x| - first)``; g follows from the number of elements, which
    are then shared out among the intervals between the given lines as evenly as whole numbers allow.

    Returns
    -------
    float64, shape (elements + 1,), rising, with 0.0 among them.

    Raises
    ------
    SpecimenError
        A line crosses the elements at the contact, or there are more lines than elements.
    """
    corners = _list_needed_lines(start_m, end_m, first_m, lines_m)
    left, right = corners[:-1], corners[1:]
    graded = ~((np.minimum(np.abs(left), np.abs(right)) == 0.0) & (right - left <= 1.5 * first_m))
    spare = elements - int(np.sum(~graded))
    if np.sum(graded) > spare:
        raise SpecimenError(
            f"{elements} elements along an edge cannot have the {len(corners)} lines that contact and "
            f"patches need; make plate.elements_per_edge at least {len(left) + len(left) % 2}"
        )
    near = np.minimum(np.abs(left), np.abs(right))[graded] - first_m
    far = np.maximum(np.abs(left), np.abs(right))[graded] - first_m
    growth = _solve_shared_growth(near / first_m, far / first_m, spare)
    steps = np.log1p(growth * far / first_m) - np.log1p(growth * near / first_m)
    counts = np.ones(len(left), dtype=np.int64)
    counts[graded] = _distribute_elements(steps * (spare / steps.sum()), spare)
    pieces = [
        _divide_graded_piece(float(a), float(b), int(n), first_m, growth)
        for a, b, n in zip(left, right, counts, strict=True)
    ]
    return np.concatenate([*pieces, corners[-1:]])


def _list_needed_lines(start_m: float, end_m: float, first_m: float, lines_m: Sequence[float]) -> FloatArray:
    """Return the grid lines that contact, edges and patches require, rising and each once.

    Raise SpecimenError for a patch's edge within the contact's elements.
    """
    near = SAME_LINE * (end_m - start_m)
    fixed = sorted({start_m, 0.0, end_m})
    for line in (-first_m, first_m, *sorted(lines_m)):
        if not start_m + near < line < end_m - near or min(abs(line - other) for other in fixed) <= near:
            continue
        if abs(line) < first_m - near:
            raise SpecimenError(
                f"the edge of a patch lies {abs(line):.4g} m from the contact, within its elements of "
                f"{first_m} m; make plate.contact_element_m smaller or move the patch"
            )
        fixed.append(line)
    return np.array(sorted(fixed))


def _solve_shared_growth(near: FloatArray, far: FloatArray, elements: int) -> float:
    """Find the growth g at which the graded pieces need the given number of elements.

    It solves ``sum ln((1 + g far) / (1 + g near)) / g = elements``; ``near`` and ``far`` are the distances of
    the pieces' ends from the elements at the contact, in sizes of these.
    """

    def excess(g: float) -> float:
        """Return how many elements the growth g needs beyond the given number."""
        return float(np.sum(np.log1p(g * far) - np.log1p(g * near))) / g - elements

    smallest, largest = 1e-9, 1.0
    if excess(smallest) <= 0.0:  # even elements of the first size would be too few: nothing grows
        return smallest
    while excess(largest) > 0.0:
        largest *= 2.0
    return float(scipy.optimize.brentq(excess, smallest, largest, rtol=1e-12))


def _distribute_elements(wanted: FloatArray, total: int) -> IntArray:
    """Round positive numbers to integers of at least 1 that add up to `total`, keeping their ratios.

    ``total`` must not be less than their count.
    """
    counts = np.maximum(1, np.floor(wanted)).astype(np.int64)
    while counts.sum() < total:
        counts[np.argmax(wanted / counts)] += 1
    while counts.sum() > total:
        spare = np.where(counts > 1, wanted / counts, np.inf)
        counts[np.argmin(spare)] -= 1
    return counts


def _divide_graded_piece(a_m: float, b_m: float, count: int, first_m: float, growth: float) -> FloatArray:
    """Divide [a, b] into `count` elements whose sizes grow with the distance from 0.

    Return the lines without b.
    """
    if count == 1:
        return np.array([a_m])
    sign = -1.0 if a_m < 0.0 else 1.0
    steps = np.log1p(growth * (np.abs([a_m, b_m]) - first_m) / first_m)
    distance = first_m + first_m * np.expm1(np.linspace(steps[0], steps[1], count + 1)) / growth
    points = sign * distance
    points[0] = a_m
    return np.asarray(points[:-1])
