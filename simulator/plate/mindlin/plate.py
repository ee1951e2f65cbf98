"""Reissner-Mindlin plate with thinned patches: MITC4 elements on a graded tensor grid (paper, section 3).

Bending stiffness and rotary inertia go with the cube of the thickness, shear stiffness and mass with
the thickness itself. Where a patch of depth d has the profile p (0 outside, 1 in its middle) the thickness
is ``h (1 - d p) = h ((1 - p) + s p)``, linear in the remaining part ``s = 1 - d``. Therefore

    K(s) = K0 + s K1 + s^2 K2 + s^3 K3,    M(s) = M0 + s M1 + s^2 M2 + s^3 M3.

A flat patch has no quadratic part. The mid-surface stays where it is. A flat round patch thins an element
by the fraction of its area that the circle covers: its stiffness and mass are that mixture of the thick
and the thin element.

All matrices are those of the whole plate. The part with x >= 0 (y >= 0) of a plate that is symmetric in x
(y) carries twice its own energy, so that part and whole give the same deflection under the same force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from simulator.numerics.arrays import FloatArray, IntArray
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.mindlin.element import (
    DOF_PER_NODE,
    GAUSS_POINTS,
    compute_thinned_coefficients,
    element_matrices,
)
from simulator.plate.mindlin.grid import SAME_LINE, make_graded_edge, make_graded_half_edge
from simulator.plate.mindlin.hertz_pressure import hertz_nodal_weights
from simulator.plate.mindlin.liquid_layer import layer_mass
from simulator.plate.mindlin.patches import (
    check_patches,
    evaluate_profile_depth,
    find_symmetric_axes,
    list_patch_lines,
    patch_fraction,
)

_Elements = tuple[IntArray, FloatArray]
"""Numbers of some elements and a matrix of each, shape (number, 12, 12)."""

Cubic = tuple[sparse.csc_matrix, sparse.csc_matrix, sparse.csc_matrix, sparse.csc_matrix]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AffinePlate:
    """Plate whose stiffness and mass are known for every remaining thickness of its patches.

    Attributes
    ----------
    stiffness
        (K0, K1, K2, K3), coefficients of 1, s, s^2, s^3: sparse, shape (n, n) over the free unknowns.
    mass
        (M0, M1, M2, M3), same shape.
    load
        float64, shape (n,): unit force at the contact; also reads (or averages) its deflection.
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
    free: IntArray
    added_mass: sparse.linalg.LinearOperator | None = None

    def evaluate_at_depth(self, depth_fraction: float) -> tuple[sparse.csc_matrix, sparse.csc_matrix]:
        """Compute stiffness and mass, sparse (n, n), at a depth of the patch; without a liquid's mass."""
        s = 1.0 - depth_fraction
        return _evaluate_cubic(self.stiffness, s), _evaluate_cubic(self.mass, s)


def _evaluate_cubic(coefficients: Cubic, s: float) -> sparse.csc_matrix:
    """Evaluate a cubic matrix polynomial at the relative thickness s, sparse (n, n)."""
    c0, c1, c2, c3 = coefficients
    lower = c0 + s * c1
    if c2.nnz:
        lower = lower + s**2 * c2
    return (lower + s**3 * c3).tocsc()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlateThinning:
    """Thinned elements: fully within flat patches, point by point within smooth ones.

    Attributes
    ----------
    covered
        float64, shape (patches, elements): fraction of each element that each flat patch covers.
    depth_factor
        float64, shape (patches,): depth of the flat patches over the depth of the position.
    profile
        float64, shape (Gauss points, elements): depth of the smooth patches over that of the position.
    """

    covered: FloatArray
    depth_factor: FloatArray
    profile: FloatArray

    def coefficients(self, power: int) -> FloatArray:
        """Return coefficients of 1, s, s^2, s^3 in the relative thickness to `power` (1 to 3).

        s is the fraction of the thickness that remains in the middle of a patch. The shape is (4, Gauss
        points, elements).
        """
        rest = 1.0 - self.covered.sum(axis=0)
        total = rest * _binomial_coefficients(self.profile, power)
        for fraction, factor in zip(self.covered, self.depth_factor, strict=True):
            total += fraction * _binomial_coefficients(np.full((1, 1), factor), power)
        return np.asarray(total)


def _binomial_coefficients(p: FloatArray, power: int) -> FloatArray:
    """Expand ``((1 - p) + s p)^power`` in 1, s, s^2, s^3; coefficients along a new first axis.

    ``p`` is the local depth over that in the middle of the patch.
    """
    terms = [math.comb(power, j) * (1.0 - p) ** (power - j) * p**j for j in range(power + 1)]
    return np.stack([*terms, *[np.zeros_like(p)] * (3 - power)])


def build_plate(
    plate: PlateParameters, corrosion: CorrosionParameters, *, whole: bool = False
) -> AffinePlate:
    """Assemble the plate with the patches of `corrosion`; their depth is not used.

    Parameters
    ----------
    plate
        Any model; the material, the edges, the contact, the liquid and the mesh are used.
    corrosion
        Outlines and profiles of the patches.
    whole
        Mesh the whole plate also where a half or a quarter is exact (for tests).

    Raises
    ------
    SpecimenError
        A patch does not fit on the plate, overlaps another one or cannot be meshed.
    """
    check_patches(plate, corrosion)
    symmetric = find_symmetric_axes(plate, corrosion)
    along_x, along_y = zip(
        (plate.width_m, plate.height_m),
        (plate.contact_x_m, plate.contact_y_m),
        list_patch_lines(corrosion, plate.contact_element_m),
        symmetric,
        strict=True,
    )
    x = _make_edge_lines(plate, *along_x)
    y = x.copy() if along_y == along_x else _make_edge_lines(plate, *along_y)
    if whole:
        x, y = (
            np.concatenate((-s[:0:-1], s)) if half else s for s, half in zip((x, y), symmetric, strict=True)
        )
        symmetric = False, False
    return assemble_plate(plate, x, y, evaluate_thinning(x, y, corrosion), symmetric=symmetric)


def _make_edge_lines(
    plate: PlateParameters, edge_m: float, contact_m: float, lines_m: list[float], half: bool
) -> FloatArray:
    """Place grid lines in m along one edge, or along its half with positive coordinates if ``half``.

    The contact is at 0, a line at each of ``lines_m``. Raise SpecimenError if the lines do not fit.
    """
    first_m, elements = plate.contact_element_m, plate.elements_per_edge
    if not half:
        return make_graded_edge(
            -0.5 * edge_m - contact_m, 0.5 * edge_m - contact_m, elements, first_m, lines_m
        )
    beyond = [line for line in lines_m if line > SAME_LINE * edge_m]
    if len(beyond) == 1:
        return make_graded_half_edge(0.5 * edge_m, elements // 2, first_m, beyond[0])
    return make_graded_edge(0.0, 0.5 * edge_m, elements // 2, first_m, beyond)


def evaluate_thinning(x_m: FloatArray, y_m: FloatArray, corrosion: CorrosionParameters) -> PlateThinning:
    """Return the thinning of a grid's elements by flat and by smooth patches, from lines in m.

    The origin of the lines is the contact.
    """
    flat = [patch for patch in corrosion.patches if patch.profile == "flat"]
    elements = (len(x_m) - 1) * (len(y_m) - 1)
    covered = [patch_fraction(x_m, y_m, patch).ravel() for patch in flat]
    profile = np.zeros((len(GAUSS_POINTS), elements))
    for patch in corrosion.patches:
        if patch.profile != "flat":
            for k, (xi, eta) in enumerate(GAUSS_POINTS):
                points_x, points_y = (
                    0.5 * (s[1:] + s[:-1]) + 0.5 * at * np.diff(s) for s, at in ((x_m, xi), (y_m, eta))
                )
                depth = evaluate_profile_depth(points_x[:, None], points_y[None, :], patch)
                profile[k] += patch.depth_factor * depth.ravel()
    return PlateThinning(
        covered=np.array(covered).reshape(len(flat), elements),
        depth_factor=np.array([patch.depth_factor for patch in flat]),
        profile=profile,
    )


def assemble_plate(
    plate: PlateParameters,
    x_m: FloatArray,
    y_m: FloatArray,
    thinning: PlateThinning,
    *,
    symmetric: tuple[bool, bool],
) -> AffinePlate:
    """Assemble stiffness, mass and boundary conditions on any tensor grid with a line at 0.

    Parameters
    ----------
    plate
        Material, edges, contact and liquid.
    x_m, y_m
        Grid lines, origin at the contact.
    thinning
        Where the elements of this grid are thinned.
    symmetric
        Whether the grid is the part with x >= 0 (y >= 0) of a plate symmetric in x (y).

    Raises
    ------
    SpecimenError
        The plate is too large for its thickness to carry a liquid.
    """
    nodes = _number_element_nodes(len(x_m), len(y_m))
    dof = (nodes[:, :, None] * DOF_PER_NODE + np.arange(DOF_PER_NODE)).reshape(len(nodes), -1)
    free = _find_free_unknowns(plate, x_m, y_m, symmetric)
    number = np.full(DOF_PER_NODE * len(x_m) * len(y_m), -1)
    number[free] = np.arange(len(free))
    scale = 2.0 ** sum(symmetric)

    def assemble(elements: _Elements) -> sparse.csc_matrix:
        """Assemble the sparse matrix of the free unknowns from element matrices."""
        order, matrices = elements
        index = number[dof[order]]
        rows = np.broadcast_to(index[:, :, None], matrices.shape)
        columns = np.broadcast_to(index[:, None, :], matrices.shape)
        held = (rows >= 0) & (columns >= 0) & (matrices != 0.0)
        entries = scale * matrices[held], (rows[held], columns[held])
        return sparse.csc_matrix(entries, shape=(len(free), len(free)))

    pristine = element_matrices(plate, np.diff(x_m), np.diff(y_m))
    stiffness, mass = _element_coefficients(plate, x_m, y_m, pristine, thinning)
    k0, k1, k2, k3 = (assemble(elements) for elements in stiffness)
    m0, m1, m2, m3 = (assemble(elements) for elements in mass)
    if plate.support == "free":
        bed = assemble((np.arange(len(nodes)), pristine[2]))
        k0 = k0 + (2.0 * math.pi * plate.suspension_hz) ** 2 * bed
    liquid = plate.liquid
    return AffinePlate(
        stiffness=(k0, k1, k2, k3),
        mass=(m0, m1, m2, m3),
        load=_make_unit_load(plate, x_m, y_m, symmetric)[free],
        x_m=x_m,
        y_m=y_m,
        free=free,
        added_mass=None if liquid is None else layer_mass(liquid, plate, x_m, y_m, free, symmetric=symmetric),
    )


def _element_coefficients(
    plate: PlateParameters,
    x_m: FloatArray,
    y_m: FloatArray,
    pristine: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    thinning: PlateThinning,
) -> tuple[list[_Elements], list[_Elements]]:
    """Compute each element's coefficients of 1, s, s^2, s^3 in stiffness and in mass.

    s is the fraction of the thickness that remains in the middle of a patch. Each coefficient is a pair: the
    numbers of the elements where it acts, and their matrices. ``pristine`` is the result of
    `element_matrices`.
    """
    bending, shear, translation, rotation = pristine
    linear, cubic = thinning.coefficients(1), thinning.coefficients(3)
    is_uneven = thinning.profile.any(axis=0)
    uneven = np.flatnonzero(is_uneven)
    a, b = (s.ravel()[uneven] for s in np.meshgrid(np.diff(x_m), np.diff(y_m), indexing="ij"))
    varied = compute_thinned_coefficients(plate, a, b, linear[:, :, uneven], cubic[:, :, uneven])
    stiffness, mass = [], []
    for j in range(4):
        # An element that is thinned evenly has the same coefficients at all its Gauss points.
        # The first coefficient has entries for every element, so that it alone has the whole pattern.
        there = (linear[j, 0] != 0.0) | (cubic[j, 0] != 0.0) | (j == 0)
        even = np.flatnonzero(~is_uneven & there)
        order = np.concatenate((even, uneven))
        in_thickness, in_cube = linear[j, 0, even, None, None], cubic[j, 0, even, None, None]
        if np.array_equal(in_thickness, in_cube):  # one product less, rounded once
            stiff = in_cube * (bending[even] + shear[even])
        else:
            stiff = in_cube * bending[even] + in_thickness * shear[even]
        inert = in_thickness * translation[even] + in_cube * rotation[even]
        stiffness.append((order, np.concatenate((stiff, varied[0][j]))))
        mass.append((order, np.concatenate((inert, varied[1][j]))))
    return stiffness, mass


def _make_unit_load(
    plate: PlateParameters, x_m: FloatArray, y_m: FloatArray, symmetric: tuple[bool, bool]
) -> FloatArray:
    """Return a unit force on all unknowns, shape (3 nodes,): at the contact's node or over its circle."""
    load = np.zeros((len(x_m), len(y_m), DOF_PER_NODE))
    if plate.contact == "patch":
        load[:, :, 0] = hertz_nodal_weights(x_m, y_m, plate.contact_radius_m, symmetric=symmetric)
    else:
        load[np.searchsorted(x_m, 0.0), np.searchsorted(y_m, 0.0), 0] = 1.0
    return load.ravel()


def _number_element_nodes(n_x: int, n_y: int) -> IntArray:
    """Return the node numbers of each element, counter-clockwise, shape (elements, 4)."""
    first = (np.arange(n_x - 1)[:, None] * n_y + np.arange(n_y - 1)).ravel()
    return np.stack((first, first + n_y, first + n_y + 1, first + 1), axis=1)


def _find_free_unknowns(
    plate: PlateParameters, x_m: FloatArray, y_m: FloatArray, symmetric: tuple[bool, bool]
) -> IntArray:
    """Return the numbers of the unknowns that supports and symmetry leave free, ascending.

    Along an edge, a hard simple support holds w and the tangential rotation, a clamp all three, a free edge
    none; on a symmetry axis the rotation across it is held.
    """
    held = np.zeros((len(x_m), len(y_m), DOF_PER_NODE), dtype=bool)
    clamped = plate.support == "clamped"
    for axis, half in enumerate(symmetric):
        across, along = 1 + axis, 2 - axis
        lines = np.moveaxis(held, axis, 0)
        if half:
            lines[0, :, across] = True
        for edge in (-1,) if half else (0, -1):
            if plate.support != "free":
                lines[edge, :, 0] = True
                lines[edge, :, along] = True
            lines[edge, :, across] |= clamped
    return np.flatnonzero(~held.ravel())
