"""Modes of the solid plate at one depth of the patch, or of every depth from one basis.

The force drives few motions, the Krylov space of the load: ``x_0 = (K + sigma^2 M)^-1 b``,
``x_(j+1) = (K + sigma^2 M)^-1 M x_j``. With the grid lines at fixed fractions of the two layers, the
stiffness of the upper one, of thickness s h, is ``s A + B / s + C`` and its mass ``s D``, that of the lower
one the same with 1 - s: once these eight matrices are projected, the projection is known at any depth.

A point force would press into a solid without limit. The force of the chain is spread as Hertz's pressure
over a circle of radius a, and the deflection is averaged with the same weight. Part of it is the
indentation of a half-space, which Hertz's law of the contact holds already; see
`contact.half_space_indentation_m_per_n`. What is left does not depend on a as long as a is small
against the remaining thickness. The mesh does not resolve the circle: what it lacks there is measured on
the plate of the patch's size and remaining thickness, whose exact compliance is known, and added
(`contact_correction_m_per_n`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, sparse

from simulator.errors import SpecimenError
from simulator.numerics.arrays import FloatArray, IntArray
from simulator.numerics.nested_dissection import factorize, order_elimination
from simulator.parameters.plate import CorrosionParameters, PlateParameters
from simulator.plate.reduced import PlateModes
from simulator.plate.solid.contact import exact_contact_compliance_m_per_n, half_space_indentation_m_per_n
from simulator.plate.solid.integrals import COMPONENTS, compute_in_plane_elasticity, integrate_in_plane
from simulator.plate.solid.plate import SolidPlate, build_solid_plate, cut_out_remaining_wall

SOLID_VECTORS = 60
"""Krylov vectors: the plate's response is kept to 1e-5 up to 10 kHz and to 1e-3 at 20 kHz."""

SHIFT_RAD_PER_S = 6e4
"""About the circular frequency of a solitary wave of the paper's chain (10 kHz)."""

SHALLOWEST_FRACTION = 1e-4
"""A shallower patch is taken as none: rounding in so thin a layer would change more than the patch."""


def contact_correction_m_per_n(plate: SolidPlate, corrosion: CorrosionParameters) -> float:
    """Compute the compliance that the mesh lacks under the contact, in m/N, from an exact case.

    The same elements as those within the patch make a plate of its remaining thickness, simply supported at
    the patch's edge: its averaged deflection is too small, by nearly what that of the whole plate is. Raise
    SpecimenError if its stiffness is not positive definite.
    """
    under = cut_out_remaining_wall(plate, corrosion)
    solver = make_shifted_solver(under, 0.0)
    thickness_m = float(under.z.breaks_m[-1])
    width_m, height_m = (2.0 * float(axis.breaks_m[-1]) for axis in (under.x, under.y))
    exact = exact_contact_compliance_m_per_n(plate.parameters, width_m, height_m, thickness_m)
    return exact - float(under.load @ solver(under.load))


Fold = tuple[IntArray, sparse.csr_matrix]


def map_column_unknowns(plate: SolidPlate) -> list[Fold]:
    """Return for each column of elements its sorted unknowns, and the map between them and its displacements.

    The map is a sparse matrix, shape (unknowns, displacements).
    """
    return [_map_one_column(plate, int(ex), int(ey)) for ex, ey in plate.columns]


def _map_one_column(plate: SolidPlate, ex: int, ey: int) -> Fold:
    """Return the sorted unknowns of one column, and the map to its displacements (`map_column_unknowns`).

    ``ex``, ``ey`` are the column's numbers along x and y.
    """
    kind, nodes = _find_column_kind(plate, ex, ey)
    if kind:
        at = np.ix_(plate.x.nodes_of(ex), plate.y.nodes_of(ey))
        numbers = plate.numbers[at][:, :, :nodes].transpose(0, 1, 3, 2).ravel()
        local = np.flatnonzero(numbers >= 0)
        unknowns, row = np.unique(numbers[local], return_inverse=True)
        size = len(unknowns), len(numbers)
        return unknowns, sparse.csr_matrix((np.ones(len(local)), (row, local)), shape=size)
    lifted = plate.lift[plate.find_displacement_numbers(ex, ey)[:, :, :nodes].ravel()].tocoo()
    unknowns, row = np.unique(lifted.col, return_inverse=True)
    size = len(unknowns), lifted.shape[0]
    return unknowns, sparse.csr_matrix((lifted.data, (row, lifted.row)), shape=size)


def _find_column_kind(plate: SolidPlate, ex: int, ey: int) -> tuple[int, int]:
    """Return the kind of a column's nodes, 0 if they differ, and the number of unknowns or nodes along z.

    Kinds are those of `SolidPlate.kinds`; a column of one kind has unknowns along z, another one nodes.
    """
    kinds = plate.kinds[np.ix_(plate.x.nodes_of(ex), plate.y.nodes_of(ey))]
    if kinds.flat[0] and np.all(kinds == kinds.flat[0]):
        kind = int(kinds.flat[0])
        return kind, plate.shapes[kind - 1].shape[1]
    return 0, plate.upper_nodes if plate.inside[ex, ey] == 1.0 else plate.numbers.shape[2]


def compute_column_matrix(
    plate: SolidPlate, column: int, fold: sparse.csr_matrix, stiffness: float, mass: float
) -> FloatArray:
    """Compute a sum of stiffness and mass of one column, each with its factor, times its symmetric copies.

    The shape is (unknowns, unknowns). ``column`` is a row of ``plate.columns``, ``fold`` its map: see
    `map_column_unknowns`.
    """
    ex, ey = (int(e) for e in plate.columns[column])
    stiffness, mass = (factor * plate.repeats[column] for factor in (stiffness, mass))
    kind, nodes = _find_column_kind(plate, ex, ey)
    whole = integrate_in_plane(plate.x, plate.y, ex, ey)
    upper, lower = (
        tuple(matrix[:nodes, :nodes] for matrix in plate.layer_matrices(kind, upper=u)) for u in (True, False)
    )
    if plate.inside[ex, ey] == 1.0:
        parts = [(whole, upper)]
    elif (ex, ey) in plate.cut:
        parts = [(whole, upper), (plate.cut[ex, ey], lower)]
    else:
        parts = [(whole, tuple(a + b for a, b in zip(upper, lower, strict=True)))]
    in_plane, through = [], []
    for integrals, (through_mass, through_slope, through_stiffness) in parts:
        a, b, c, d = compute_in_plane_elasticity(plate.parameters, integrals)
        a, b, c = stiffness * a + mass * d, stiffness * b, stiffness * c
        in_plane += [a, b, c, c.T]
        through += [through_mass, through_stiffness, through_slope, through_slope.T]
    # The sum of the Kronecker products, in one pass over the result.
    factors = np.transpose(in_plane, (1, 2, 0))[:, None], np.transpose(through, (1, 0, 2))
    total = np.matmul(*factors).reshape(fold.shape[1], -1)
    if fold.nnz == fold.shape[0]:  # each unknown is a displacement
        return np.asarray(total[np.ix_(fold.indices, fold.indices)])
    return np.asarray(fold @ np.ascontiguousarray((fold @ total).T))


def make_shifted_solver(plate: SolidPlate, shift_rad_per_s: float) -> Callable[[FloatArray], FloatArray]:
    """Factorize ``K + sigma^2 M``, sigma the shift; return a function that solves for one vector, shape (n,).

    K and M are stiffness and mass over the n unknowns. Raise SpecimenError if the sum is not positive
    definite.
    """
    folds = map_column_unknowns(plate)

    def cell(column: int, order: IntArray) -> FloatArray:
        """Compute the shifted matrix of one column of elements over its unknowns in an order."""
        unknowns, fold = folds[column]
        ordered = fold[np.searchsorted(unknowns, order)]
        return compute_column_matrix(plate, column, ordered, 1.0, shift_rad_per_s**2)

    return factorize(order_elimination(plate.columns, [unknowns for unknowns, _ in folds]), cell).solve


def make_mass_product(plate: SolidPlate) -> Callable[[FloatArray], FloatArray]:
    """Return a function that multiplies a vector of the unknowns by the mass matrix, never assembled.

    Each layer has an in-plane matrix and one through the thickness.
    """
    shape = int(plate.x.first[-1]) + 1, int(plate.y.first[-1]) + 1
    scale = float(plate.repeats.min()) * plate.parameters.density_kg_per_m3
    layers = []
    for upper in (True, False):
        through = scale * plate.layer_matrices(0, upper=upper)[0]
        rows, columns, values = [], [], []
        for ex, ey in np.ndindex(plate.inside.shape):
            if not upper and plate.inside[ex, ey] == 1.0:
                continue
            integrals = None if upper else plate.cut.get((ex, ey))
            part = (integrate_in_plane(plate.x, plate.y, ex, ey) if integrals is None else integrals)[0]
            at = (plate.x.nodes_of(ex)[:, None] * shape[1] + plate.y.nodes_of(ey)).ravel()
            rows.append(np.repeat(at, len(at)))
            columns.append(np.tile(at, len(at)))
            values.append(part.ravel())
        if rows:
            entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
            layers.append((sparse.csr_matrix(entries, shape=(shape[0] * shape[1],) * 2), through))
    lift, lower = plate.lift, plate.lift.T.tocsr()

    def multiply(x: FloatArray) -> FloatArray:
        """Multiply a vector of the unknowns by the mass matrix."""
        field = (lift @ x).reshape(shape[0] * shape[1], -1)
        total = np.zeros((len(field) * COMPONENTS, len(layers[0][1])))
        for in_plane, through in layers:
            total += (in_plane @ field).reshape(-1, len(through)) @ through
        return np.asarray(lower @ total.ravel())

    return multiply


def krylov_fields(plate: SolidPlate, vectors: int) -> FloatArray:
    """Build the load's mass-orthonormal Krylov space as displacements `plate.modelled`, shape (n, vectors).

    Raise SpecimenError if the shifted stiffness is not positive definite.
    """
    solve, mass = make_shifted_solver(plate, SHIFT_RAD_PER_S), make_mass_product(plate)
    basis = np.empty((vectors, len(plate.load)))
    mass_basis = np.empty_like(basis)
    right = plate.load
    for j in range(vectors):
        x = solve(right)
        for _ in range(2):  # again takes away what rounding left
            x -= basis[:j].T @ (mass_basis[:j] @ x)
        mass_x = mass(x)
        norm = math.sqrt(x @ mass_x)
        np.divide(x, norm, out=basis[j])
        np.divide(mass_x, norm, out=mass_basis[j])
        right = mass_basis[j]
    return np.asarray(plate.lift[plate.modelled] @ basis.T)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProjectedSolid:
    """Solid plate projected onto a basis, for any remaining thickness.

    Attributes
    ----------
    stiffness
        float64, shape (6, r, r): of the upper layer, its displacements taken as they are, their slopes
        through the thickness and the products of both, for a layer as thick as the plate; then of the lower.
    mass
        float64, shape (2, r, r): of both layers, each as thick as the plate.
    load
        float64, shape (r,).
    """

    stiffness: FloatArray
    mass: FloatArray
    load: FloatArray

    def modes(self, remaining: float, residual_compliance_m_per_n: float) -> PlateModes:
        """Compute modes with the fraction `remaining` of the thickness left within the patch.

        The given residual compliance becomes that of the result, and may be negative. Raise LinAlgError if
        the mass is not positive definite.
        """
        s, lost = remaining, 1.0 - remaining
        factors = np.array([s, 1.0 / s, 1.0, lost, 1.0 / lost if lost else 0.0, 1.0 if lost else 0.0])
        stiffness = np.tensordot(factors, self.stiffness, 1)
        mass = s * self.mass[0] + lost * self.mass[1]
        eigenvalues, shapes = linalg.eigh(stiffness, mass, check_finite=False)
        return PlateModes(
            omega_rad_per_s=np.sqrt(eigenvalues),
            participation=shapes.T @ self.load,
            residual_compliance_m_per_n=residual_compliance_m_per_n,
        )


def project_layers(plate: SolidPlate, fields: FloatArray) -> ProjectedSolid:
    """Project each layer onto `fields` (Galerkin): displacements `plate.modelled`, shape (n, r)."""
    modelled = plate.modelled
    count = fields.shape[1]
    stiffness, mass = np.zeros((6, count, count)), np.zeros((2, count, count))
    h = plate.parameters.thickness_m
    upper_m = float(plate.z.breaks_m[plate.upper])
    for column, (ex, ey) in enumerate(plate.columns):
        numbers = np.searchsorted(modelled, plate.find_displacement_numbers(ex, ey))
        whole = integrate_in_plane(plate.x, plate.y, ex, ey)
        layers = [(0, whole, upper_m)]
        if plate.upper < len(plate.z.degrees) and plate.inside[ex, ey] < 1.0:
            layers.append((1, plate.cut.get((ex, ey), whole), h - upper_m))
        for layer, integrals, thickness_m in layers:
            nodes = slice(plate.upper_nodes) if layer == 0 else slice(plate.upper_nodes - 1, None)
            field = fields[numbers[:, :, nodes]]
            through_mass, through_slope, through_stiffness = (
                matrix[nodes, nodes] for matrix in plate.layer_matrices(0, upper=layer == 0)
            )
            a, b, c, d = (
                plate.repeats[column] * term
                for term in compute_in_plane_elasticity(plate.parameters, integrals)
            )
            displaced = _multiply_field(through_mass * (h / thickness_m), field)
            stiffness[3 * layer] += _energy_products(field, a, displaced)
            mass[layer] += _energy_products(field, d, displaced)
            steep = _multiply_field(through_stiffness * (thickness_m / h), field)
            stiffness[3 * layer + 1] += _energy_products(field, b, steep)
            mixed = _energy_products(field, c, _multiply_field(through_slope, field))
            stiffness[3 * layer + 2] += mixed + mixed.T
    return ProjectedSolid(stiffness=stiffness, mass=mass, load=fields.T @ plate.force[modelled])


def _multiply_field(matrix: FloatArray, field: FloatArray) -> FloatArray:
    """Multiply a field, shape (..., nodes of z, r), by a matrix through the thickness; same shape."""
    return np.asarray(np.matmul(matrix, field))


def _energy_products(field: FloatArray, in_plane: FloatArray, through: FloatArray) -> FloatArray:
    """Compute the energy products of r fields, shape (r, r), from in-plane and through-thickness factors."""
    count = field.shape[-1]
    product = in_plane @ through.reshape(len(in_plane), -1)
    return np.asarray(field.reshape(-1, count).T @ product.reshape(-1, count))


def find_solid_modes(
    plate: PlateParameters, corrosion: CorrosionParameters, vectors: int = SOLID_VECTORS
) -> PlateModes:
    """Compute modes of the solid plate at the depth of `corrosion`; the residual compliance is not negative.

    Raises
    ------
    SpecimenError
        The model does not know such a plate or patch (`build_solid_plate`), or the circle of contact is too
        small for the mesh.
    """
    corrosion = _remove_shallow_patch(corrosion)
    built = build_solid_plate(plate, corrosion)
    projected = project_layers(built, krylov_fields(built, vectors))
    remaining = 1.0 - corrosion.depth_fraction * corrosion.depth_factor
    return make_modes_passive(projected.modes(remaining, contact_residual_m_per_n(built, corrosion)))


def contact_residual_m_per_n(plate: SolidPlate, corrosion: CorrosionParameters) -> float:
    """Return the compliance to add to the modes in m/N: the mesh's missing part less the half-space's.

    Raise SpecimenError as `contact_correction_m_per_n`.
    """
    indentation = half_space_indentation_m_per_n(
        plate.parameters.warm_youngs_modulus_pa,
        plate.parameters.poisson_ratio,
        plate.parameters.contact_radius_m,
    )
    return contact_correction_m_per_n(plate, corrosion) - indentation


def _remove_shallow_patch(corrosion: CorrosionParameters) -> CorrosionParameters:
    """Return the patch with depth 0 if it is shallower than 1e-4 of the thickness; others as they are."""
    if corrosion.depth_fraction * corrosion.depth_factor < SHALLOWEST_FRACTION:
        return replace(corrosion, depth_fraction=0.0)
    return corrosion


def make_modes_passive(modes: PlateModes) -> PlateModes:
    """Convert the fastest modes to residual compliance until it is no longer negative.

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
            f"plate.contact_radius_m larger"
        )
    count = int(passive[-1])
    return PlateModes(
        omega_rad_per_s=modes.omega_rad_per_s[:count],
        participation=modes.participation[:count],
        residual_compliance_m_per_n=float(residual[count]),
    )
