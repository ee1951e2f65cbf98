"""Plate as a three-dimensional solid: bricks that do not lock on a graded tensor grid.

The second model of the paper (section 3). z points along the chain: 0 on the face that the last sphere
touches, h on the other one, from which the patch is thinned. Grid lines lie on the edges of the patch
and on its remaining thickness; the elements below are left out. A round patch leaves an element that
the circle cuts its outer fraction of stiffness and mass.

A point force would press into a solid without limit. The force of the chain is spread as Hertz's
pressure over a circle of radius a, and the deflection is averaged with the same weight. Part of it is
the indentation of a half-space, which Hertz's law of the contact holds already; see
`half_space_indentation_m_per_n`. What is left does not depend on a as long as a is small against the
remaining thickness.

All matrices are those of the whole plate. The quarter model (exact for the centred load and patch)
carries four times its own energy, so both give the same deflection under the same force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray
from scipy import linalg, optimize, sparse

from hardware_drivers.bounds import check_bounds
from simulator.errors import SpecimenError
from simulator.materials import plane_modulus_pa
from simulator.patches import patch_fraction
from simulator.plate_mesh import graded_half_edge
from simulator.plate_parameters import CorrosionParameters, PlateParameters
from simulator.plate_reduction import PlateModes, krylov_vectors
from simulator.solid_element import brick_mass, brick_stiffness

DOF_PER_NODE = 3
FloatArray = NDArray[np.float64]

SOLID_VECTORS = 60
"""Krylov vectors: the plate's response is kept to 1e-5 up to 10 kHz and to 1e-3 at 20 kHz."""

RADIAL_POINTS = 48
ANGULAR_POINTS = 48
"""Points over a quarter of the circle of contact: the nodal loads are sure to about 1e-4 of the largest."""

SHALLOWEST_FRACTION = 1e-5
"""A shallower patch is taken as none: rounding in so thin a layer would change more than the patch."""

LEAST_FRACTION = 1e-6
"""Less than this of an element that a circle cuts is left out: rounding, or too soft for its neighbours."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SolidMesh:
    """Mesh of the solid plate and the circle that its load is spread over."""

    elements_per_edge: Annotated[int, Ge(8), Le(200)] = 64
    """Elements along each edge of the whole plate, an even number."""
    layers: Annotated[int, Ge(1), Le(50)] = 3
    """Elements through the thickness that remains under the contact, growing away from it."""
    layers_below: Annotated[int, Ge(1), Le(50)] = 1
    """Elements through the thickness that the patch has lost, where it is still there."""
    contact_element_m: Annotated[float, Gt(0.0), Le(0.1)] = 2.5e-4
    """Size of the elements at the contact, in all three directions; a single layer is as thick as it is."""
    growth: Annotated[float, Gt(1.0), Le(3.0)] = 1.25
    """Ratio of neighbouring elements near the contact; farther out all are equal, to carry the waves."""
    contact_radius_m: Annotated[float, Gt(0.0), Le(0.1)] = 5e-4
    """Radius a of the circle of contact."""

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.elements_per_edge % 2:
            raise ValueError(f"elements_per_edge is {self.elements_per_edge}; it must be even")
        if self.contact_element_m > self.contact_radius_m:
            raise ValueError(
                f"contact_element_m is {self.contact_element_m} m; to resolve the circle of contact it must "
                f"be at most contact_radius_m, {self.contact_radius_m} m"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SolidPlate:
    """Solid plate at one depth of its patch.

    Attributes
    ----------
    stiffness, mass
        Sparse, shape (n, n) over the free unknowns.
    load
        float64, shape (n,): unit force spread over the circle of contact; also averages its deflection.
    indentation_m_per_n
        Compliance to subtract from the averaged deflection, held by Hertz's law already.
    x_m, y_m, z_m
        Grid lines, origin at the contact, z along the chain.
    free
        int64, shape (n,): number of each free unknown among all ``3 len(x) len(y) len(z)``.
    """

    stiffness: sparse.csc_matrix
    mass: sparse.csc_matrix
    load: FloatArray
    indentation_m_per_n: float
    x_m: FloatArray
    y_m: FloatArray
    z_m: FloatArray
    free: NDArray[np.int64]


def half_space_indentation_m_per_n(
    youngs_modulus_pa: float, poisson_ratio: float, contact_radius_m: float
) -> float:
    """Mean deflection of a half-space under a unit force of Hertz's pressure, ``0.6 (1 - nu^2) / (E a)``.

    Under ``p = p0 sqrt(1 - r^2 / a^2)``, ``p0 = 3 F / (2 pi a^2)``, the surface within the circle sinks by
    ``u(r) = pi p0 (1 - nu^2) (2 a^2 - r^2) / (4 E a)`` (Johnson 1985, Contact Mechanics, equation 3.41a,
    doi:10.1017/CBO9781139171731). The mean of ``r^2 / a^2`` with the weight p is, with t in its place,
    ``int t sqrt(1 - t) dt / int sqrt(1 - t) dt = (4 / 15) / (2 / 3) = 2 / 5``, so the mean of u is

        pi p0 (1 - nu^2) a (2 - 2 / 5) / (4 E) = 0.4 pi p0 a (1 - nu^2) / E = 0.6 (1 - nu^2) F / (E a).

    Another pressure or another weight has another factor.
    """
    return 0.6 / (plane_modulus_pa(youngs_modulus_pa, poisson_ratio) * contact_radius_m)


def build_solid_plate(
    plate: PlateParameters,
    corrosion: CorrosionParameters,
    mesh: SolidMesh | None = None,
    *,
    quarter: bool = True,
) -> SolidPlate:
    """Mesh and assemble the plate of `plate`, thinned by the patch of `corrosion` to its depth.

    Parameters
    ----------
    plate
        Any model; size, material and support are used. Both supports hold the whole edge face: hard
        simple support its two displacements in the face (deflection and along the edge), clamped all three.
    corrosion
        Outline and depth of the patch.
    mesh
        None takes the defaults of `SolidMesh`.
    quarter
        One quarter with two symmetry planes, or the whole plate (for tests).

    Raises
    ------
    SpecimenError
        The patch does not fit on the plate or the mesh, or leaves less than an element under the contact.
    """
    mesh = SolidMesh() if mesh is None else mesh
    _check_sizes(plate, corrosion, mesh)
    x = capped_half_edge(0.5 * plate.width_m, mesh, 0.5 * corrosion.size_m)
    y = capped_half_edge(0.5 * plate.height_m, mesh, 0.5 * corrosion.size_m)
    if not quarter:
        x = np.concatenate((-x[:0:-1], x))
        y = np.concatenate((-y[:0:-1], y))
    lost = corrosion.depth_fraction if corrosion.depth_fraction >= SHALLOWEST_FRACTION else 0.0
    remaining_m = (1.0 - lost) * plate.thickness_m
    z = graded_half_edge(remaining_m, mesh.layers, mesh.contact_element_m, remaining_m)
    if lost > 0.0:
        below_m = np.linspace(remaining_m, plate.thickness_m, mesh.layers_below + 1)
        z = np.concatenate((z, below_m[1:]))
    kept = np.ones((len(x) - 1, len(y) - 1, len(z) - 1))
    below = 0.5 * (z[1:] + z[:-1]) > remaining_m
    kept[:, :, below] -= patch_fraction(x, y, corrosion)[:, :, None]
    kept[kept < LEAST_FRACTION] = 0.0
    return assemble_solid(plate, x, y, z, kept, contact_radius_m=mesh.contact_radius_m, quarter=quarter)


def capped_half_edge(length_m: float, mesh: SolidMesh, edge_m: float) -> FloatArray:
    """Grid lines from 0 to `length_m` that grow from the contact up to one size, with a line at `edge_m`.

    The cap follows from the number of elements: elements that grew to the edge of the plate would be
    too long for the waves that come back from it. The line nearest to `edge_m` is moved there, and the
    lines on either side of it are spread evenly over what it leaves them.

    Returns
    -------
    float64, shape (elements_per_edge / 2 + 1,)

    Raises
    ------
    SpecimenError
        Too few elements for their growth, or a patch smaller than an element.
    """
    first_m, count = mesh.contact_element_m, mesh.elements_per_edge // 2
    if edge_m < first_m:
        raise SpecimenError(
            f"half the patch is {edge_m} m, less than the elements at the contact ({first_m} m); "
            f"make contact_element_m smaller"
        )
    grown = first_m * mesh.growth ** np.arange(count)
    if grown.sum() < length_m:
        raise SpecimenError(
            f"{count} elements that grow by {mesh.growth} from {first_m} m reach {grown.sum():.4g} m of "
            f"{length_m} m; make elements_per_edge, growth or contact_element_m larger"
        )
    cap_m = optimize.brentq(lambda cap: np.minimum(grown, cap).sum() - length_m, 0.0, grown[-1], rtol=1e-14)
    lines = np.concatenate(([0.0], np.cumsum(np.minimum(grown, cap_m))))
    lines *= length_m / lines[-1]
    lines[-1] = length_m
    if edge_m > length_m * (1.0 - 1e-9):
        return np.asarray(lines)
    moved = 1 + int(np.argmin(np.abs(lines[1:-1] - edge_m)))
    inner = lines[:moved] * (edge_m / lines[moved])
    outer = length_m - (length_m - lines[moved + 1 :]) * ((length_m - edge_m) / (length_m - lines[moved]))
    return np.concatenate((inner, [edge_m], outer))


def _check_sizes(plate: PlateParameters, corrosion: CorrosionParameters, mesh: SolidMesh) -> None:
    shorter_m = min(plate.width_m, plate.height_m)
    if corrosion.size_m > shorter_m:
        raise SpecimenError(
            f"the patch is {corrosion.size_m} m wide, the plate only {shorter_m} m; "
            f"make corrosion.size_m smaller"
        )
    if mesh.contact_radius_m > 0.5 * shorter_m:
        raise SpecimenError(
            f"contact_radius_m is {mesh.contact_radius_m} m; the plate leaves {0.5 * shorter_m} m"
        )
    largest_m = shorter_m / mesh.elements_per_edge
    if mesh.contact_element_m > largest_m:
        raise SpecimenError(
            f"contact_element_m is {mesh.contact_element_m} m; with {mesh.elements_per_edge} elements on the "
            f"shorter edge it must be at most {largest_m:.4g} m"
        )
    remaining_m = (1.0 - corrosion.depth_fraction) * plate.thickness_m
    if mesh.contact_element_m > remaining_m:
        raise SpecimenError(
            f"the patch leaves {remaining_m:.4g} m, less than the elements at the contact "
            f"({mesh.contact_element_m} m); make contact_element_m smaller"
        )
    if mesh.contact_radius_m > remaining_m:
        raise SpecimenError(
            f"contact_radius_m is {mesh.contact_radius_m} m, more than the {remaining_m:.4g} m of "
            f"plate under it: no half-space; make contact_radius_m and contact_element_m smaller"
        )


def assemble_solid(
    plate: PlateParameters,
    x_m: FloatArray,
    y_m: FloatArray,
    z_m: FloatArray,
    kept: FloatArray,
    *,
    contact_radius_m: float,
    quarter: bool,
) -> SolidPlate:
    """Sum the elements of any tensor grid with lines at x = 0, y = 0, z = 0 and hold its edges.

    `kept` is the fraction of each element that is there, shape (len(x) - 1, len(y) - 1, len(z) - 1);
    elements with none of it are left out, and so are nodes that belong to no other.
    """
    there = kept.ravel() > 0.0
    nodes = _element_nodes(len(x_m), len(y_m), len(z_m))[there]
    points = np.stack(np.meshgrid(x_m, y_m, z_m, indexing="ij"), axis=3).reshape(-1, 3)
    fraction = kept.ravel()[there][:, None, None] * (4.0 if quarter else 1.0)
    corners = points[nodes]
    stiffness = fraction * brick_stiffness(corners, plate.youngs_modulus_pa, plate.poisson_ratio)
    mass = fraction * brick_mass(corners, plate.density_kg_per_m3)

    used = np.zeros(len(points), dtype=bool)
    used[nodes] = True
    held = _held(plate, x_m, y_m, z_m, quarter) | ~used[:, None]
    free = np.flatnonzero(~held.ravel())
    number = np.full(held.size, -1)
    number[free] = np.arange(len(free))
    index = number.reshape(held.shape)[nodes]

    load = np.zeros(held.shape)
    load[:: len(z_m), 2] = hertz_nodal_weights(x_m, y_m, contact_radius_m, quarter=quarter).ravel()
    # One component after another: the mass does not couple them.
    masses = [_sparse(mass, index[:, :, component], len(free)) for component in range(DOF_PER_NODE)]
    return SolidPlate(
        stiffness=_sparse(stiffness, index.reshape(len(nodes), -1), len(free)),
        mass=(masses[0] + masses[1] + masses[2]).tocsc(),
        load=load.ravel()[free],
        indentation_m_per_n=half_space_indentation_m_per_n(
            plate.youngs_modulus_pa, plate.poisson_ratio, contact_radius_m
        ),
        x_m=x_m,
        y_m=y_m,
        z_m=z_m,
        free=free,
    )


def _sparse(elements: FloatArray, index: NDArray[np.int64], size: int) -> sparse.csc_matrix:
    rows = np.broadcast_to(index[:, :, None], elements.shape)
    columns = np.broadcast_to(index[:, None, :], elements.shape)
    kept = (rows >= 0) & (columns >= 0)
    return sparse.csc_matrix((elements[kept], (rows[kept], columns[kept])), shape=(size, size))


def _element_nodes(n_x: int, n_y: int, n_z: int) -> NDArray[np.int64]:
    """Node numbers of each element in the order of `solid_element.CORNER_SIGNS`, shape (elements, 8)."""
    number = np.arange(n_x * n_y * n_z).reshape(n_x, n_y, n_z)
    steps = number[:2, :2, :2].ravel()
    return np.asarray(number[:-1, :-1, :-1].ravel()[:, None] + steps)


def _held(
    plate: PlateParameters, x_m: FloatArray, y_m: FloatArray, z_m: FloatArray, quarter: bool
) -> NDArray[np.bool_]:
    """Tell which displacements the supports and the symmetry planes hold, shape (nodes, 3)."""
    held = np.zeros((len(x_m), len(y_m), len(z_m), DOF_PER_NODE), dtype=bool)
    clamped = plate.support == "clamped"
    held[-1, :, :, 0] = clamped
    held[-1, :, :, 1:] = True
    held[:, -1, :, 1] |= clamped
    held[:, -1, :, ::2] = True
    if quarter:
        held[0, :, :, 0] = True
        held[:, 0, :, 1] = True
    else:
        held[0] |= held[-1]
        held[:, 0] |= held[:, -1]
    return held.reshape(-1, DOF_PER_NODE)


def hertz_nodal_weights(x_m: FloatArray, y_m: FloatArray, radius_m: float, *, quarter: bool) -> FloatArray:
    """Consistent nodal loads of a unit force of Hertz's pressure about the origin, shape (len(x), len(y)).

    On the surface a brick is bilinear. With ``c = sqrt(1 - r^2 / a^2)`` the force on a ring is
    ``c r dr ~ c^2 dc``, smooth in c: Gauss points in c and in the angle carry the pressure, and each
    gives its share to the four corners around it. The loads add up to one, for a quarter too.
    """
    c, c_weight = _gauss(RADIAL_POINTS, 1.0)
    angle, angle_weight = _gauss(ANGULAR_POINTS, 0.5 * math.pi)
    r = radius_m * np.sqrt(1.0 - c**2)
    share = np.outer(c**2 * c_weight, angle_weight).ravel()
    along_x, along_y = np.outer(r, np.cos(angle)).ravel(), np.outer(r, np.sin(angle)).ravel()
    signs = [(1.0, 1.0)] if quarter else [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]
    weights = np.zeros((len(x_m), len(y_m)))
    for sign_x, sign_y in signs:
        i, right = _cell(x_m, sign_x * along_x)
        j, upper = _cell(y_m, sign_y * along_y)
        np.add.at(weights, (i, j), share * (1.0 - right) * (1.0 - upper))
        np.add.at(weights, (i + 1, j), share * right * (1.0 - upper))
        np.add.at(weights, (i, j + 1), share * (1.0 - right) * upper)
        np.add.at(weights, (i + 1, j + 1), share * right * upper)
    return np.asarray(weights / weights.sum())


def _gauss(count: int, end: float) -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre points and weights on the interval from 0 to `end`."""
    points, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 * end * (points + 1.0), 0.5 * end * weights


def _cell(lines_m: FloatArray, at_m: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Find the element that holds each coordinate and how far along it lies, 0 to 1."""
    cell = np.clip(np.searchsorted(lines_m, at_m, side="right") - 1, 0, len(lines_m) - 2)
    return cell, (at_m - lines_m[cell]) / np.diff(lines_m)[cell]


def solid_modes(plate: SolidPlate, vectors: int = SOLID_VECTORS) -> PlateModes:
    """Modes of the plate as the chain feels them, the half-space indentation taken off.

    The force drives few motions: stiffness and mass are projected onto their Krylov space (Galerkin,
    as in `plate_reduction`). The indentation becomes negative residual compliance. Modes far above
    the chain's frequencies hold most of the dimple under the load; once they are cut into the residual
    compliance as well, the two nearly cancel. A shot needs `passive_modes` of these.

    Parameters
    ----------
    plate
        From `build_solid_plate`.
    vectors
        Dimension of the Krylov space.
    """
    basis = krylov_vectors(plate.stiffness, plate.mass, plate.load, vectors)
    stiffness, mass = (basis @ (matrix @ basis.T) for matrix in (plate.stiffness, plate.mass))
    eigenvalues, shapes = linalg.eigh(stiffness, mass, check_finite=False)
    return PlateModes(
        omega_rad_per_s=np.sqrt(eigenvalues),
        participation=shapes.T @ (basis @ plate.load),
        residual_compliance_m_per_n=-plate.indentation_m_per_n,
    )


def passive_modes(modes: PlateModes) -> PlateModes:
    """Turn the fastest modes into residual compliance until it is no longer negative.

    A negative compliance in series with the contact's dashpot feeds energy in, and the explicit
    integration of a shot diverges with a fine step or a strong dashpot. The fastest modes hold the
    dimple under the load; as many as make up for the half-space's part of it are taken as static.

    Raises
    ------
    SpecimenError
        All modes together yield less than the half-space: the circle of contact is too small for the mesh.
    """
    flexibility = (modes.participation / modes.omega_rad_per_s) ** 2
    residual = modes.residual_compliance_m_per_n + np.append(np.cumsum(flexibility[::-1])[::-1], 0.0)
    passive = np.flatnonzero(residual >= 0.0)
    if len(passive) == 0:
        raise SpecimenError(
            f"the plate yields {-residual[0]:.3g} m/N less than a half-space would at the contact; make "
            f"contact_radius_m larger or contact_element_m smaller"
        )
    count = int(passive[-1])
    return PlateModes(
        omega_rad_per_s=modes.omega_rad_per_s[:count],
        participation=modes.participation[:count],
        residual_compliance_m_per_n=float(residual[count]),
    )
