"""Added mass of a liquid on one face of a plate: an incompressible layer with a free surface.

The liquid stands on the whole plate, H deep, between side walls over the plate's edges. It has no
viscosity. Its free surface carries no waves worth counting at these frequencies, so the pressure there is
zero, and so it is (our choice) at the side walls. Each term of the plate's motion
``w = sum w_mn sin(m pi x / a) sin(n pi y / b)`` then has a potential of its own, which solves Laplace's
equation with ``sinh(k (H - z)) / cosh(k H)``, and its pressure on the plate is that of the mass per area

    rho_f tanh(k H) / k,    k^2 = (m pi / a)^2 + (n pi / b)^2:

``rho_f H`` for long waves and ``rho_f / k`` in a deep layer, where it no longer matters what closes the
layer at the far end.

The mass matrix couples all nodes, but it is a product of one-dimensional ones, ``Sx' Sy' T Sy Sx``, with
the integrals of shape function times sine in S and ``rho_f tanh(k H) / k`` in the diagonal T.
"""

from __future__ import annotations

import math

import numpy as np
import scipy  # `scipy.sparse.linalg` comes when asked for

from simulator.errors import SpecimenError
from simulator.numerics.arrays import FloatArray, IntArray
from simulator.parameters.plate import LiquidParameters, PlateParameters
from simulator.plate.mindlin.element import DOF_PER_NODE

HALF_WAVE_PER_THICKNESS = 0.375
"""The shortest half wave of the liquid over the plate's thickness; see docs for the convergence."""

FEWEST_TERMS = 64
MOST_TERMS = 4096


def choose_sine_terms(plate: PlateParameters) -> tuple[int, int]:
    """Choose the numbers of sine terms along x and y, 64 to 4,096, that resolve the liquid.

    Raises
    ------
    SpecimenError
        The plate is too large for its thickness.
    """
    longest_m = max(plate.width_m, plate.height_m)
    shortest_wave_m = HALF_WAVE_PER_THICKNESS * plate.thickness_m
    if longest_m / shortest_wave_m > MOST_TERMS:
        raise SpecimenError(
            f"a liquid on a plate {longest_m} m long and {plate.thickness_m} m thick needs "
            f"{longest_m / shortest_wave_m:.0f} sines along an edge, at most {MOST_TERMS} are allowed. "
            f"Make the plate at most {MOST_TERMS * shortest_wave_m:.4g} m long"
        )
    along_x, along_y = (
        max(FEWEST_TERMS, round(edge_m / shortest_wave_m)) for edge_m in (plate.width_m, plate.height_m)
    )
    return along_x, along_y


def layer_mass(
    liquid: LiquidParameters,
    plate: PlateParameters,
    x_m: FloatArray,
    y_m: FloatArray,
    free: IntArray,
    *,
    symmetric: tuple[bool, bool],
    terms: tuple[int, int] | None = None,
) -> scipy.sparse.linalg.LinearOperator:
    """Build the operator of the liquid's mass on the free unknowns of a mesh, without a matrix.

    Without ``terms``, raise SpecimenError as `choose_sine_terms`.

    Parameters
    ----------
    liquid, plate
        Density and depth; edges and place of the contact.
    x_m, y_m
        Grid lines, origin at the contact.
    free
        Number of each free unknown among all ``3 len(x) len(y)``.
    symmetric
        Whether the mesh is the part with x >= 0 (y >= 0) of a plate symmetric in x (y): its matrices are
        the whole plate's, and only odd sines are left.
    terms
        Highest sine along x and y; None takes `choose_sine_terms`.

    Returns
    -------
    Symmetric operator, shape (len(free), len(free)), also for several columns at once.
    """
    highest = choose_sine_terms(plate) if terms is None else terms
    sines, wave_numbers = [], []
    for lines, edge_m, contact_m, half, highest_order in zip(
        (x_m, y_m),
        (plate.width_m, plate.height_m),
        (plate.contact_x_m, plate.contact_y_m),
        symmetric,
        highest,
        strict=True,
    ):
        orders = np.arange(1, highest_order + 1, 2 if half else 1, dtype=np.float64)
        integrals = integrate_hats_times_sines(lines, -0.5 * edge_m - contact_m, edge_m, orders)
        sines.append(2.0 * integrals if half else integrals)
        wave_numbers.append(orders * math.pi / edge_m)
    k = np.hypot(wave_numbers[0][:, None], wave_numbers[1])
    mass = liquid.density_kg_per_m3 * np.tanh(k * liquid.depth_m) / k
    deflected = np.flatnonzero(free % DOF_PER_NODE == 0)
    nodes = free[deflected] // DOF_PER_NODE
    along_x, along_y = sines

    def multiply(values: FloatArray) -> FloatArray:
        """Multiply vectors of the free unknowns by the liquid's mass."""
        columns = values.reshape(len(free), -1)
        product = np.zeros_like(columns)
        for column in range(columns.shape[1]):
            w = np.zeros(len(x_m) * len(y_m))
            w[nodes] = columns[deflected, column]
            terms_mn = along_x @ w.reshape(len(x_m), len(y_m)) @ along_y.T
            pressure = along_x.T @ (mass * terms_mn) @ along_y
            product[deflected, column] = pressure.ravel()[nodes]
        return product.reshape(values.shape)

    return scipy.sparse.linalg.LinearOperator(
        (len(free), len(free)), matvec=multiply, matmat=multiply, dtype=np.float64
    )


def integrate_hats_times_sines(
    lines_m: FloatArray, start_m: float, edge_m: float, orders: FloatArray
) -> FloatArray:
    """Integrate hat functions on `lines_m` times ``sqrt(2 / a) sin(m pi (x - start) / a)``.

    a is ``edge_m``, m one of ``orders``. The integrals are exact for elements of any size.

    Returns
    -------
    float64, shape (len(orders), len(lines_m)).
    """
    k = orders[:, None] * math.pi / edge_m
    # Integrated by parts twice on each element, whose hats have the slopes +-1 / length.
    sine = np.sin(k * (lines_m - start_m)) / k**2
    cosine = np.cos(k * (lines_m - start_m)) / k
    slope = np.diff(sine, axis=1) / np.diff(lines_m)
    integrals = np.zeros_like(sine)
    integrals[:, 1:] += slope - cosine[:, 1:]
    integrals[:, :-1] += cosine[:, :-1] - slope
    return np.asarray(math.sqrt(2.0 / edge_m) * integrals)
