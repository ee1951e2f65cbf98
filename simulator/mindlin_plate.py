"""Reissner-Mindlin plate with a thinned patch: MITC4 elements on a graded tensor grid (paper, section 3).

Unknowns of a node are ``w, beta_x, beta_y``: the deflection along the chain and the rotations of the
normal in the xz and yz planes (``u = z beta_x``), so that the shear strains are ``w_,x + beta_x`` and
``w_,y + beta_y``. The transverse shear is interpolated from the middles of the edges (MITC4: Bathe and
Dvorkin 1985, doi:10.1002/nme.1620210213), which keeps coarse elements from locking.

Bending stiffness and rotary inertia go with the cube of the thickness, shear stiffness and mass with
the thickness itself. A thickness that is linear in the remaining part s of the patch therefore makes

    K(s) = K0 + s K1 + s^2 K2 + s^3 K3,    M(s) = M0 + s M1 + s^2 M2 + s^3 M3.

A flat patch, ``s h`` thick, has no quadratic part.

The mid-surface stays where it is. A round patch thins an element by the fraction of its area that the
circle covers: its stiffness and mass are that mixture of the thick and the thin element.

All matrices are those of the whole plate. The quarter model (exact for the centred load and patch)
carries four times its own energy, so both give the same deflection under the same force.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, sparse
from scipy.sparse.linalg import LinearOperator

from simulator.errors import SpecimenError
from simulator.materials import plane_modulus_pa, shear_modulus_pa
from simulator.plate_parameters import CorrosionParameters, PlateParameters

SHEAR_CORRECTION = 5.0 / 6.0
"""kappa of equation 3, for a rectangular cross-section."""

DOF_PER_NODE = 3
FloatArray = NDArray[np.float64]
Cubic = tuple[sparse.csc_matrix, sparse.csc_matrix, sparse.csc_matrix, sparse.csc_matrix]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AffinePlate:
    """Plate whose stiffness and mass are known for every remaining thickness of its patch.

    Attributes
    ----------
    stiffness
        (K0, K1, K2, K3), coefficients of 1, s, s^2, s^3: sparse, shape (n, n) over the free unknowns.
    mass
        (M0, M1, M2, M3), same shape.
    load
        float64, shape (n,): unit force at the contact node; also reads its deflection.
    x_m, y_m
        Grid lines, origin at the contact.
    free
        int64, shape (n,): number of each free unknown among all ``3 len(x) len(y)``.
    added_mass
        Mass of a liquid, on top of `mass` at any depth: symmetric, shape (n, n), takes several columns
        at once with ``@``. None without a liquid.
    """

    stiffness: Cubic
    mass: Cubic
    load: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    free: NDArray[np.int64]
    added_mass: LinearOperator | None = None

    def at_depth(self, depth_fraction: float) -> tuple[sparse.csc_matrix, sparse.csc_matrix]:
        """Stiffness and mass, without that of a liquid, with the patch thinned by `depth_fraction`."""
        s = 1.0 - depth_fraction
        return _at(self.stiffness, s), _at(self.mass, s)


def _at(coefficients: Cubic, s: float) -> sparse.csc_matrix:
    c0, c1, c2, c3 = coefficients
    lower = c0 + s * c1
    if c2.nnz:
        lower = lower + s**2 * c2
    return (lower + s**3 * c3).tocsc()


def build_plate(
    plate: PlateParameters, corrosion: CorrosionParameters, *, quarter: bool = True
) -> AffinePlate:
    """Assemble the plate of `plate` with the patch of `corrosion` (its depth is not used).

    Parameters
    ----------
    plate
        Any model; the material, the edges and the mesh are used.
    corrosion
        Outline of the patch.
    quarter
        One quarter with two symmetry planes, or the whole plate (for tests).

    Raises
    ------
    SpecimenError
        The patch does not fit on the plate or is smaller than an element at the contact.
    """
    if corrosion.size_m > min(plate.width_m, plate.height_m):
        raise SpecimenError(
            f"the patch is {corrosion.size_m} m wide, the plate only "
            f"{min(plate.width_m, plate.height_m)} m; make corrosion.size_m smaller"
        )
    lines = plate.elements_per_edge // 2, plate.contact_element_m, 0.5 * corrosion.size_m
    x = graded_half_edge(0.5 * plate.width_m, *lines)
    y = graded_half_edge(0.5 * plate.height_m, *lines)
    if not quarter:
        x = np.concatenate((-x[:0:-1], x))
        y = np.concatenate((-y[:0:-1], y))
    covered = patch_fraction(x, y, corrosion)
    return assemble(plate, x, y, covered, quarter=quarter)


def graded_half_edge(length_m: float, elements: int, first_m: float, edge_m: float) -> FloatArray:
    """Grid lines from 0 to `length_m`: the first element `first_m` long, a line at `edge_m`.

    Two geometric progressions meet at the edge of the patch, the second continuing the sizes of the
    first; their lengths are chosen so that the two growth factors differ least.

    Returns
    -------
    float64, shape (elements + 1,)
    """
    if edge_m < first_m:
        raise SpecimenError(
            f"half the patch is {edge_m} m, less than the elements at the contact ({first_m} m); "
            f"make plate.contact_element_m smaller"
        )
    if edge_m > length_m * (1.0 - 1e-9):
        return _lines(0.0, length_m, first_m, _growth(first_m, elements, length_m), elements)
    best: tuple[float, FloatArray] | None = None
    for inner in range(1, elements):
        growth = _growth(first_m, inner, edge_m)
        left = _lines(0.0, edge_m, first_m, growth, inner)
        last = left[-1] - left[-2]
        outer_growth = _continued_growth(last, elements - inner, length_m - edge_m)
        misfit = abs(math.log(growth / outer_growth))
        if best is None or misfit < best[0]:
            right = _lines(edge_m, length_m, last * outer_growth, outer_growth, elements - inner)
            best = misfit, np.concatenate((left, right[1:]))
    assert best is not None  # elements >= 4
    return best[1]


def _growth(first_m: float, elements: int, length_m: float) -> float:
    """Factor r with ``first (1 + r + ... + r^(n-1)) = length``; a single element takes the whole."""
    if elements == 1:
        return length_m / first_m
    largest = (length_m / first_m) ** (1.0 / (elements - 1))  # the last element alone fills the length
    return _solve_growth(lambda r: first_m * np.sum(r ** np.arange(elements)) - length_m, largest)


def _continued_growth(last_m: float, elements: int, length_m: float) -> float:
    """Factor r with ``last (r + r^2 + ... + r^n) = length``."""
    largest = (length_m / last_m) ** (1.0 / elements)
    return _solve_growth(lambda r: last_m * np.sum(r ** np.arange(1, elements + 1)) - length_m, largest)


def _solve_growth(excess: Callable[[float], float], largest: float) -> float:
    # Rounding must not leave the root of a single element outside.
    return float(optimize.brentq(excess, 0.0, largest * (1.0 + 1e-9), xtol=1e-15, rtol=1e-14))


def _lines(start_m: float, end_m: float, first_m: float, growth: float, elements: int) -> FloatArray:
    lines = start_m + np.concatenate(([0.0], np.cumsum(first_m * growth ** np.arange(elements))))
    lines[-1] = end_m
    return np.asarray(lines)


def patch_fraction(x_m: FloatArray, y_m: FloatArray, corrosion: CorrosionParameters) -> FloatArray:
    """Fraction of each element's area that lies in the centred patch, shape (len(x) - 1, len(y) - 1)."""
    half = 0.5 * corrosion.size_m
    if corrosion.shape == "square":
        tolerance = 1e-9 * half  # the grid line on the edge is exact to rounding
        inside_x = np.maximum(np.abs(x_m[1:]), np.abs(x_m[:-1])) <= half + tolerance
        inside_y = np.maximum(np.abs(y_m[1:]), np.abs(y_m[:-1])) <= half + tolerance
        return np.outer(inside_x, inside_y).astype(np.float64)
    corner = _disk_corner_area(x_m[:, None], y_m[None, :], half)
    covered = corner[1:, 1:] - corner[:-1, 1:] - corner[1:, :-1] + corner[:-1, :-1]
    fraction = covered / np.outer(np.diff(x_m), np.diff(y_m))
    # Differences of nearly equal areas leave rounding where the circle does not reach.
    return np.asarray(np.clip(np.where(fraction < 1e-9, 0.0, fraction), 0.0, 1.0))


def _disk_corner_area(x_m: FloatArray, y_m: FloatArray, radius_m: float) -> FloatArray:
    """Signed area of the disk within the rectangle from the origin to (x, y)."""
    x = np.minimum(np.abs(x_m), radius_m)
    y = np.minimum(np.abs(y_m), radius_m)
    flat = np.minimum(np.sqrt(radius_m**2 - y**2), x)  # up to here the rectangle's top is inside

    def below_arc(t: FloatArray) -> FloatArray:
        arc = t * np.sqrt(np.maximum(radius_m**2 - t**2, 0.0)) + radius_m**2 * np.arcsin(t / radius_m)
        return np.asarray(0.5 * arc)

    area = flat * y + below_arc(x) - below_arc(flat)
    return np.asarray(np.sign(x_m) * np.sign(y_m) * area)


def assemble(
    plate: PlateParameters, x_m: FloatArray, y_m: FloatArray, covered: FloatArray, *, quarter: bool
) -> AffinePlate:
    """Element matrices, their sum and the boundary conditions, for any tensor grid with a line at 0.

    `covered` is the fraction of each element in the patch, shape (len(x) - 1, len(y) - 1).
    """
    bending, shear, translation, rotation = element_matrices(plate, np.diff(x_m), np.diff(y_m))
    alpha = covered.reshape(-1, 1, 1)
    nodes = _element_nodes(len(x_m), len(y_m))
    dof = (nodes[:, :, None] * DOF_PER_NODE + np.arange(DOF_PER_NODE)).reshape(len(nodes), -1)
    free = _free_unknowns(plate, x_m, y_m, quarter)
    scale = 4.0 if quarter else 1.0

    unknowns = DOF_PER_NODE * len(x_m) * len(y_m)
    number = np.full(unknowns, -1)
    number[free] = np.arange(len(free))

    def matrix(elements: FloatArray, touched: NDArray[np.bool_]) -> sparse.csc_matrix:
        index = number[dof[touched]]
        rows = np.broadcast_to(index[:, :, None], elements[touched].shape)
        columns = np.broadcast_to(index[:, None, :], rows.shape)
        held = (rows >= 0) & (columns >= 0)
        entries = scale * elements[touched][held], (rows[held], columns[held])
        return sparse.csc_matrix(entries, shape=(len(free), len(free)))

    everywhere = np.ones(len(nodes), dtype=bool)
    thinned = alpha.ravel() > 0.0
    none = sparse.csc_matrix((len(free), len(free)))
    load = np.zeros(len(free))
    centre = int(np.searchsorted(x_m, 0.0)) * len(y_m) + int(np.searchsorted(y_m, 0.0))
    load[number[DOF_PER_NODE * centre]] = 1.0
    return AffinePlate(
        stiffness=(
            matrix((1.0 - alpha) * (bending + shear), everywhere),
            matrix(alpha * shear, thinned),
            none,
            matrix(alpha * bending, thinned),
        ),
        mass=(
            matrix((1.0 - alpha) * (translation + rotation), everywhere),
            matrix(alpha * translation, thinned),
            none,
            matrix(alpha * rotation, thinned),
        ),
        load=load,
        x_m=x_m,
        y_m=y_m,
        free=free,
    )


def _element_nodes(n_x: int, n_y: int) -> NDArray[np.int64]:
    """Node numbers of each element, counter-clockwise, shape (elements, 4)."""
    first = (np.arange(n_x - 1)[:, None] * n_y + np.arange(n_y - 1)).ravel()
    return np.stack((first, first + n_y, first + n_y + 1, first + 1), axis=1)


def _free_unknowns(
    plate: PlateParameters, x_m: FloatArray, y_m: FloatArray, quarter: bool
) -> NDArray[np.int64]:
    held = np.zeros((len(x_m), len(y_m), DOF_PER_NODE), dtype=bool)
    clamped = plate.support == "clamped"
    held[-1, :, [0, 2]] = True
    held[:, -1, [0, 1]] = True
    held[-1, :, 1] |= clamped
    held[:, -1, 2] |= clamped
    if quarter:
        held[0, :, 1] = True
        held[:, 0, 2] = True
    else:
        held[0, :, :] |= held[-1, :, :]
        held[:, 0, :] |= held[:, -1, :]
    return np.flatnonzero(~held.ravel())


def element_matrices(
    plate: PlateParameters, width_m: FloatArray, height_m: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Bending, shear, translational and rotary matrices of rectangles of pristine thickness.

    Parameters
    ----------
    plate
        Material and thickness h.
    width_m, height_m
        Sizes along x, shape (n_x,), and y, shape (n_y,): the elements are all their pairs.

    Returns
    -------
    Four float64 arrays, shape (n_x n_y, 12, 12). Two Gauss points along each side integrate all four
    exactly on rectangles (equations 3-7, with equation 5 corrected to the shear modulus).
    """
    h, nu = plate.thickness_m, plate.poisson_ratio
    a, b = (side.ravel() for side in np.meshgrid(width_m, height_m, indexing="ij"))
    c = plane_modulus_pa(plate.youngs_modulus_pa, nu) * np.array(
        [[1.0, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, (1.0 - nu) / 2.0]]
    )
    bending_law = h**3 / 12.0 * c
    shear_law = SHEAR_CORRECTION * h * shear_modulus_pa(plate.youngs_modulus_pa, nu) * np.eye(2)
    mass_law = plate.density_kg_per_m3 * np.diag([h, 0.0, 0.0])
    inertia_law = plate.density_kg_per_m3 * h**3 / 12.0 * np.diag([0.0, 1.0, 1.0])

    sums = [np.zeros((len(a), 12, 12)) for _ in range(4)]
    for xi in (-1.0 / math.sqrt(3.0), 1.0 / math.sqrt(3.0)):
        for eta in (-1.0 / math.sqrt(3.0), 1.0 / math.sqrt(3.0)):
            curvature, shear, value = _strain_rows(xi, eta, a, b)
            laws = (bending_law, shear_law, mass_law, inertia_law)
            for k, rows in enumerate((curvature, shear, value, value)):
                weighted = (0.25 * a * b)[:, None, None] * (laws[k] @ rows)
                sums[k] += np.swapaxes(rows, 1, 2) @ weighted
    return sums[0], sums[1], sums[2], sums[3]


def _strain_rows(
    xi: float, eta: float, a: FloatArray, b: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rows that turn the 12 nodal values into curvatures (3), shear strains (2) and values (3)."""
    node_xi = np.array([-1.0, 1.0, 1.0, -1.0])
    node_eta = np.array([-1.0, -1.0, 1.0, 1.0])
    shape = 0.25 * (1.0 + xi * node_xi) * (1.0 + eta * node_eta)
    along_x = 0.5 * node_xi * (1.0 + eta * node_eta) / a[:, None]
    along_y = 0.5 * node_eta * (1.0 + xi * node_xi) / b[:, None]

    w, beta_x, beta_y = (slice(k, None, DOF_PER_NODE) for k in range(DOF_PER_NODE))
    curvature = np.zeros((len(a), 3, 12))
    curvature[:, 0, beta_x] = along_x
    curvature[:, 1, beta_y] = along_y
    curvature[:, 2, beta_x] = along_y
    curvature[:, 2, beta_y] = along_x

    # MITC4: the xz strain is taken at the middles of the two edges along x and varies linearly across
    # (there beta_x is the mean of the edge's two nodes); likewise yz.
    shear = np.zeros((len(a), 2, 12))
    shear[:, 0, w] = along_x
    shear[:, 0, beta_x] = 0.25 * (1.0 + eta * node_eta)
    shear[:, 1, w] = along_y
    shear[:, 1, beta_y] = 0.25 * (1.0 + xi * node_xi)

    value = np.zeros((len(a), 3, 12))
    for row, unknown in enumerate((w, beta_x, beta_y)):
        value[:, row, unknown] = shape
    return curvature, shear, value
