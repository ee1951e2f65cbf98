"""Plate as a three-dimensional solid: tensor-product elements of high degree, thinned from below.

The second model of the paper (section 3). z points along the chain: 0 on the face that the last sphere
touches, h on the other one, from which the patch is thinned. All elements are boxes between grid lines;
lines lie on the patch's edge and on its remaining thickness, and grow finer towards that re-entrant edge,
where stresses are singular. Polynomials of degree three and more neither lock nor need a shear correction.

Through the thickness the many layers are wanted near the edge of the patch only. Farther away the
unknowns of a node are polynomials over the whole thickness there (`_classify_nodes`), a subspace, so that the
solution stays continuous.

A round patch cuts elements: what the circle takes away of the lower layer is left out of their integrals
(finite cell method: Parvizian, Duester and Rank 2007, doi:10.1007/s00466-007-0173-y).

All matrices are those of the whole plate: with both symmetry planes four times a quarter's, and with the
diagonal of a square plate as well eight times an eighth's (exact for the centred load and patch).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from simulator.errors import SpecimenError
from simulator.numerics.arrays import FloatArray, IntArray
from simulator.numerics.tensor_basis import Axis, lagrange, make_graded_breaks_m
from simulator.parameters.plate import CorrosionParameters, PlateParameters, SolidMesh
from simulator.plate.solid.integrals import COMPONENTS, hertz_nodal_weights, integrate_over_patch

Symmetry = Literal["eighth", "quarter", "none"]

MOST_DISPLACEMENTS = 3_000_000
"""Displacements of all nodes of a mesh; more take minutes and tens of gigabytes."""

UPPER_LINES = (0.0, 0.7, 0.93, 1.0)
"""Grid lines through the thickness that the patch leaves, as fractions: finer towards its lower face."""

LOWER_LINES = (0.0, 0.03, 0.15, 1.0)
"""Grid lines through the thickness that the patch has lost, finer towards the re-entrant edge."""

EDGE_STRIP = 0.4
"""Within so many thicknesses of the patch's edge every layer keeps its own unknowns."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolidPlate:
    """Solid plate at one depth of its patch.

    Attributes
    ----------
    parameters
        Material and support.
    x, y, z
        Axes, origin at the contact.
    upper
        Number of intervals of z above the patch's face; the others are lost within the patch.
    inside
        Whether the lower layer is lost, 1, or there, 0, in each element; between if a circle cuts it.
    cut
        In-plane integrals over what is left of the elements that a circle cuts.
    kinds
        Unknowns of each node: 0 its own in every layer, 1 a polynomial over the upper layer, 2 a polynomial
        over both.
    shapes
        These two polynomials at the nodes of z.
    numbers
        int64, shape (nodes of x, of y, of z, 3): number of each unknown, -1 where there is none.
    columns
        Elements by x and y, shape (columns, 2): each goes through the whole thickness.
    repeats
        How many times each column is there in the whole plate.
    lift
        Sparse: from the unknowns to the displacements of all nodes, numbered (x, y, component, z).
    force
        float64: unit force spread over the circle of contact, on the displacements of all nodes; also
        averages the deflection.
    load
        float64, shape (unknowns,): the same on the unknowns.
    """

    parameters: PlateParameters
    x: Axis
    y: Axis
    z: Axis
    upper: int
    inside: FloatArray
    cut: Mapping[tuple[int, int], tuple[FloatArray, ...]]
    kinds: IntArray
    shapes: tuple[FloatArray, FloatArray]
    numbers: IntArray
    columns: IntArray
    repeats: FloatArray
    lift: sparse.csr_matrix
    force: FloatArray
    load: FloatArray

    @property
    def upper_nodes(self) -> int:
        """Return the number of nodes of z in the upper layer, those on its lower face included."""
        return int(self.z.first[self.upper]) + 1

    @property
    def modelled(self) -> IntArray:
        """Return the sorted displacement numbers of all columns and of the load; others mirror them."""
        columns = [self.find_displacement_numbers(int(ex), int(ey)).ravel() for ex, ey in self.columns]
        return np.unique(np.concatenate((np.flatnonzero(self.force), *columns)))

    def find_displacement_numbers(self, ex: int, ey: int) -> IntArray:
        """Return the displacement numbers of one column of elements.

        The shape is (nodes in the plane, 3, nodes of z).
        """
        nodes_y, nodes_z = self.kinds.shape[1], self.numbers.shape[2]
        nodes = (self.x.nodes_of(ex)[:, None] * nodes_y + self.y.nodes_of(ey)).ravel()
        components = nodes[:, None] * COMPONENTS + np.arange(COMPONENTS)
        return np.asarray(components[:, :, None] * nodes_z + np.arange(nodes_z))

    def layer_matrices(self, kind: int, *, upper: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Integrate over z of one layer for nodes of `kind`; return the three of `Axis.interval_matrices`."""
        layer = range(self.upper) if upper else range(self.upper, len(self.z.degrees))
        integrals = self.z.integrate_intervals(layer)
        if kind == 0:
            return integrals
        shape = self.shapes[kind - 1]
        nodes = len(shape)
        mass, slope, stiffness = (shape.T @ matrix[:nodes, :nodes] @ shape for matrix in integrals)
        return mass, slope, stiffness


def build_solid_plate(
    plate: PlateParameters, corrosion: CorrosionParameters, *, symmetry: Symmetry | None = None
) -> SolidPlate:
    """Mesh the plate of `plate`, thinned by the patch of `corrosion` to its depth.

    Parameters
    ----------
    plate
        Any model; size, material, support, circle of contact and the mesh `plate.solid` are used. Both
        supports hold the whole edge face: hard simple support its two displacements in the face (deflection
        and along the edge), clamped all three.
    corrosion
        Outline and depth of the patch.
    symmetry
        Part of the plate that is modelled; None takes the smallest that is exact. For tests.

    Raises
    ------
    SpecimenError
        The model does not know such a plate or patch, or the mesh grows too large.
    """
    check_solid_parameters(plate, corrosion)
    half_x, half_y = corrosion.half_sizes_m
    if symmetry is None:
        symmetry = "eighth" if plate.width_m == plate.height_m and half_x == half_y else "quarter"
    mesh, h = plate.solid, plate.thickness_m
    x, y = (
        _mesh_in_plane_axis(0.5 * length, half, mesh, h, round_patch=corrosion.shape == "round")
        for length, half in ((plate.width_m, half_x), (plate.height_m, half_y))
    )
    if symmetry == "none":
        x, y = (
            Axis(breaks_m=np.concatenate((-a.breaks_m[:0:-1], a.breaks_m)), degrees=a.degrees * 2)
            for a in (x, y)
        )
    lost = corrosion.depth_fraction * corrosion.depth_factor
    return assemble_solid(plate, corrosion, x, y, _mesh_thickness_axis(lost, mesh, h), symmetry)


def cut_out_remaining_wall(plate: SolidPlate, corrosion: CorrosionParameters) -> SolidPlate:
    """Cut the remaining wall within the patch out of `plate`: same elements, edges simply supported."""
    half_x, half_y = corrosion.half_sizes_m
    x, y = (
        Axis(breaks_m=a.breaks_m[: count + 1], degrees=a.degrees[:count])
        for a, count in (
            (plate.x, int(np.argmin(np.abs(plate.x.breaks_m - half_x)))),
            (plate.y, int(np.argmin(np.abs(plate.y.breaks_m - half_y)))),
        )
    )
    z = Axis(breaks_m=plate.z.breaks_m[: plate.upper + 1], degrees=plate.z.degrees[: plate.upper])
    symmetry: Symmetry = "eighth" if len(x.degrees) == len(y.degrees) and half_x == half_y else "quarter"
    return assemble_solid(plate.parameters, corrosion, x, y, z, symmetry, support="simply_supported")


def check_solid_parameters(plate: PlateParameters, corrosion: CorrosionParameters) -> None:
    """Raise SpecimenError for a plate or patch that the solid model does not cover."""
    remedy = "use plate.model = 'mindlin'"
    if plate.support == "free":
        raise SpecimenError(f"plate.support is 'free'; the solid plate is held at its edges: {remedy}")
    for name, value in (("plate.contact_x_m", plate.contact_x_m), ("plate.contact_y_m", plate.contact_y_m)):
        if value != 0.0:
            raise SpecimenError(f"{name} is {value}; on the solid plate the chain is at the centre: {remedy}")
    if corrosion.further:
        raise SpecimenError(
            f"corrosion.further has {len(corrosion.further)} patches; the solid plate has one: {remedy}"
        )
    for name, offset in (
        ("corrosion.offset_x_m", corrosion.offset_x_m),
        ("corrosion.offset_y_m", corrosion.offset_y_m),
    ):
        if offset != 0.0:
            raise SpecimenError(f"{name} is {offset}; the solid plate's patch is centred: {remedy}")
    if corrosion.profile != "flat":
        raise SpecimenError(
            f"corrosion.profile is {corrosion.profile!r}; the solid plate's patch is 'flat': {remedy}"
        )
    for name, half, length in (
        ("corrosion.size_m", corrosion.half_sizes_m[0], plate.width_m),
        ("corrosion.size_y_m", corrosion.half_sizes_m[1], plate.height_m),
    ):
        if 2.0 * half > length:
            raise SpecimenError(
                f"the patch is {2.0 * half} m wide, the plate only {length} m; make {name} smaller"
            )
        if plate.contact_radius_m > half:
            raise SpecimenError(
                f"plate.contact_radius_m is {plate.contact_radius_m} m, half the patch only {half} m; make "
                f"contact_radius_m smaller or {name} larger"
            )
    remaining_m = (1.0 - corrosion.depth_fraction * corrosion.depth_factor) * plate.thickness_m
    if plate.contact_radius_m > remaining_m:
        raise SpecimenError(
            f"plate.contact_radius_m is {plate.contact_radius_m} m, more than the {remaining_m:.4g} m of "
            f"plate under it: no half-space; make contact_radius_m smaller"
        )


def _mesh_in_plane_axis(
    length_m: float, half_m: float, mesh: SolidMesh, h: float, *, round_patch: bool
) -> Axis:
    """Mesh an axis in the plane from 0 to `length_m`, refined at the contact and at the patch's edge.

    ``half_m`` is half the patch, ``h`` the thickness of the plate, in m.
    """
    features = [(0.0, mesh.contact_element * h), (half_m, mesh.edge_element * h)]
    if round_patch:  # the circle crosses every line up to half_m
        features += [(half_m * t, max(mesh.edge_element, 0.25) * h) for t in np.linspace(0.5, 1.0, 9)]
    breaks = make_graded_breaks_m(
        length_m,
        features=features,
        growth=mesh.growth,
        largest_m=mesh.largest_element * h,
        stops_m=[half_m],
    )
    return Axis(breaks_m=breaks, degrees=(mesh.degree,) * (len(breaks) - 1))


def _mesh_thickness_axis(lost: float, mesh: SolidMesh, h: float) -> Axis:
    """Mesh the thickness in m, with grid lines at fixed fractions of the remaining and the lost layer.

    So results change smoothly with the depth. ``lost`` is the fraction of the thickness ``h`` that is lost.
    """
    graded = mesh.degree - 2
    breaks = (1.0 - lost) * h * np.array(UPPER_LINES)
    degrees: tuple[int, ...] = (graded + 1, graded, graded)
    if lost > 0.0:
        below = (1.0 - lost) * h + lost * h * np.array(LOWER_LINES[1:])
        below[-1] = h
        breaks, degrees = np.concatenate((breaks, below)), (*degrees, graded, graded, graded)
    return Axis(breaks_m=breaks, degrees=degrees)


def assemble_solid(
    plate: PlateParameters,
    corrosion: CorrosionParameters,
    x: Axis,
    y: Axis,
    z: Axis,
    symmetry: Symmetry,
    support: str | None = None,
) -> SolidPlate:
    """Assemble the plate on any axes from the contact on, the first three intervals of z above the patch.

    `support` replaces that of `plate`; see `build_solid_plate` for the rest.
    Raise SpecimenError for more than 3,000,000 displacements.
    """
    count = COMPONENTS * math.prod(int(axis.first[-1]) + 1 for axis in (x, y, z))
    if count > MOST_DISPLACEMENTS:
        raise SpecimenError(
            f"the mesh of the solid plate has {count} displacements; at most {MOST_DISPLACEMENTS} are "
            f"possible: make plate.solid.largest_element or edge_element larger or degree smaller"
        )
    upper = len(UPPER_LINES) - 1
    upper_nodes = int(z.first[upper]) + 1
    inside, cut = integrate_over_patch(x, y, corrosion)
    kinds = _classify_nodes(x, y, inside, corrosion, EDGE_STRIP * plate.thickness_m)
    q = plate.solid.degree - 1
    z_m = z.nodes_m
    shapes = (
        lagrange(q, 2.0 * z_m[:upper_nodes] / z_m[upper_nodes - 1] - 1.0)[0],
        lagrange(q, 2.0 * z_m / z_m[-1] - 1.0)[0],
    )
    existing = _find_existing_nodes(x, y, len(z_m), upper_nodes, inside)
    for kind in (1, 2):
        existing[kinds == kind] = np.arange(len(z_m)) < q + 1
    fixed = _find_fixed_displacements(plate.support if support is None else support, existing.shape, symmetry)
    numbers = _number_free_displacements(existing[..., None] & ~fixed, symmetry)
    lift = _build_lift_matrix(numbers, kinds, shapes)
    weights = hertz_nodal_weights(x, y, plate.contact_radius_m, whole=symmetry == "none")
    force = np.zeros((*kinds.shape, COMPONENTS, len(z_m)))
    force[:, :, 2, 0] = weights
    columns = np.argwhere(np.ones((len(x.degrees), len(y.degrees)), dtype=bool))
    repeats = np.full(len(columns), 1.0 if symmetry == "none" else 4.0)
    if symmetry == "eighth":
        columns = columns[columns[:, 0] >= columns[:, 1]]
        repeats = np.where(columns[:, 0] > columns[:, 1], 8.0, 4.0)
    return SolidPlate(
        parameters=plate,
        x=x,
        y=y,
        z=z,
        upper=upper,
        inside=inside,
        cut=cut,
        kinds=kinds,
        shapes=shapes,
        numbers=numbers,
        columns=columns,
        repeats=repeats,
        lift=lift,
        force=force.ravel(),
        load=lift.T @ force.ravel(),
    )


def _classify_nodes(
    x: Axis, y: Axis, inside: FloatArray, corrosion: CorrosionParameters, strip_m: float
) -> IntArray:
    """Classify the unknowns of each node as `SolidPlate.kinds`, shape (nodes of x, nodes of y).

    Within ``strip_m`` of the patch's edge, and in elements that a circle cuts, every layer keeps its own.
    """
    half_x, half_y = corrosion.half_sizes_m
    at_x, at_y = np.abs(x.nodes_m)[:, None], np.abs(y.nodes_m)[None, :]
    if corrosion.shape == "round":
        outside_m = np.hypot(at_x, at_y) - half_x
        inside_m = -outside_m
    else:
        outside_m = np.hypot(np.maximum(at_x - half_x, 0.0), np.maximum(at_y - half_y, 0.0))
        inside_m = np.minimum(half_x - at_x, half_y - at_y)
    kinds = np.where(inside_m > strip_m, 1, np.where(outside_m > strip_m, 2, 0))
    for ex, ey in np.argwhere((inside > 0.0) & (inside < 1.0)):
        kinds[np.ix_(x.nodes_of(ex), y.nodes_of(ey))] = 0
    return np.asarray(kinds)


def _find_existing_nodes(
    x: Axis, y: Axis, z_nodes: int, upper_nodes: int, inside: FloatArray
) -> NDArray[np.bool_]:
    """Mark the nodes that belong to an element; Boolean, shape (nodes of x, of y, of z)."""
    existing = np.zeros((int(x.first[-1]) + 1, int(y.first[-1]) + 1, z_nodes), dtype=bool)
    existing[:, :, :upper_nodes] = True
    for ex, ey in np.argwhere(inside < 1.0):
        existing[np.ix_(x.nodes_of(ex), y.nodes_of(ey))] = True
    return existing


def _find_fixed_displacements(support: str, shape: tuple[int, ...], symmetry: Symmetry) -> NDArray[np.bool_]:
    """Mark the displacements that the supports and the symmetry planes fix; Boolean, shape (*shape, 3)."""
    fixed = np.zeros((*shape, COMPONENTS), dtype=bool)
    clamped = support == "clamped"
    fixed[-1, :, :, 0] = clamped
    fixed[-1, :, :, 1:] = True
    fixed[:, -1, :, 1] |= clamped
    fixed[:, -1, :, ::2] = True
    if symmetry == "none":
        fixed[0] |= fixed[-1]
        fixed[:, 0] |= fixed[:, -1]
    else:
        fixed[0, :, :, 0] = True
        fixed[:, 0, :, 1] = True
    return fixed


def _number_free_displacements(free: NDArray[np.bool_], symmetry: Symmetry) -> IntArray:
    """Return a number for each free displacement, shape as `free`; -1 for a fixed one.

    Across the diagonal of an eighth u and v change places.
    """
    own = np.ones(free.shape, dtype=bool)
    diagonal = np.arange(min(free.shape[:2]))
    if symmetry == "eighth":
        own &= np.tri(free.shape[0], dtype=bool)[:, :, None, None]
        own[diagonal, diagonal, :, 1] = False
    numbers = np.full(free.shape, -1)
    chosen = own & free
    numbers[chosen] = np.arange(int(chosen.sum()))
    if symmetry == "eighth":
        mirrored = numbers.transpose(1, 0, 2, 3)[..., [1, 0, 2]]
        numbers = np.where(np.tri(free.shape[0], dtype=bool)[:, :, None, None], numbers, mirrored)
        numbers[diagonal, diagonal, :, 1] = numbers[diagonal, diagonal, :, 0]
    return numbers


def _build_lift_matrix(
    numbers: IntArray, kinds: IntArray, shapes: tuple[FloatArray, FloatArray]
) -> sparse.csr_matrix:
    """Build the sparse map, shape (displacements, unknowns), from unknowns to displacements of all nodes."""
    z_nodes = numbers.shape[2]
    flat = numbers.reshape(-1, z_nodes, COMPONENTS)
    rows, columns, values = [], [], []
    for kind, shape in enumerate((np.eye(z_nodes), *shapes)):
        nodes = np.flatnonzero(kinds.ravel() == kind)
        at, of = np.nonzero(shape)
        for component in range(COMPONENTS):
            number = flat[nodes][:, of, component]
            row = (nodes[:, None] * COMPONENTS + component) * z_nodes + at
            rows.append(row[number >= 0])
            columns.append(number[number >= 0])
            values.append(np.broadcast_to(shape[at, of], number.shape)[number >= 0])
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return sparse.csr_matrix(entries, shape=(numbers.size, int(numbers.max()) + 1))
