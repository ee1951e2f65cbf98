"""The solid plate against exact three-dimensional elasticity of the simply supported plate."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg
from scipy.sparse.linalg import LinearOperator, eigsh

from simulator.materials import bending_stiffness_n_m, plane_modulus_pa
from simulator.plate_parameters import CorrosionParameters, PlateParameters
from simulator.solid_element import elasticity_pa
from simulator.solid_plate import (
    SolidMesh,
    SolidPlate,
    assemble_solid,
    build_solid_plate,
    half_space_indentation_m_per_n,
    solid_modes,
)

THICK = PlateParameters(width_m=0.04, height_m=0.05, thickness_m=6e-3)
"""So thick that shear, rotary inertia and compression through the thickness count."""

PAPER = PlateParameters()
PATCH = CorrosionParameters()
MESH = SolidMesh(contact_radius_m=1e-3)

EVEN_MESHES = ((8, 2), (12, 3), (24, 6))
"""Elements along half an edge, layers."""


def meshed(parameters, x, y, z, radius_m=1e-3) -> SolidPlate:
    kept = np.ones((len(x) - 1, len(y) - 1, len(z) - 1))
    return assemble_solid(parameters, x, y, z, kept, contact_radius_m=radius_m, quarter=True)


def evenly_meshed(parameters, elements, layers) -> SolidPlate:
    return meshed(
        parameters,
        np.linspace(0.0, parameters.width_m / 2, elements + 1),
        np.linspace(0.0, parameters.height_m / 2, elements + 1),
        np.linspace(0.0, parameters.thickness_m, layers + 1),
    )


def solver(plate: SolidPlate):
    """Banded Cholesky: the natural numbering of the nodes keeps the band narrow."""
    entries = plate.stiffness.tocoo()
    below = entries.row - entries.col
    lower = below >= 0
    band = np.zeros((below.max() + 1, plate.stiffness.shape[0]))
    band[below[lower], entries.col[lower]] = entries.data[lower]
    factor = linalg.cholesky_banded(band, lower=True, overwrite_ab=True)
    return lambda load: linalg.cho_solve_banded((factor, True), load)


def contact_compliance(plate: SolidPlate) -> float:
    return float(plate.load @ solver(plate)(plate.load))


def deflection_under_uniform_pressure(plate: SolidPlate) -> float:
    """Mean over the face z = 0 at the centre node, pressure 1 Pa."""
    x, y, z = plate.x_m, plate.y_m, plate.z_m
    pressure = np.zeros((len(x), len(y), len(z), 3))
    tributary = [0.5 * (np.diff(s, prepend=0.0) + np.diff(s, append=s[-1])) for s in (x, y)]
    pressure[:, :, 0, 2] = 4.0 * np.outer(*tributary)  # the quarter carries the whole plate's matrices
    centre = int(np.flatnonzero(plate.free == 2)[0])
    return float(solver(plate)(pressure.ravel()[plate.free])[centre])


def flexural_frequency_hz(plate: SolidPlate, m: int, n: int) -> float:
    """Frequency of the mode that moves most like ``w = cos(m pi x / a) cos(n pi y / b)``."""
    x, y, z = plate.x_m, plate.y_m, plate.z_m
    pattern = np.zeros((len(x), len(y), len(z), 3))
    half_waves = (np.cos(k * np.pi * s / (2.0 * s[-1])) for k, s in ((m, x), (n, y)))
    pattern[:, :, :, 2] = np.outer(*half_waves)[:, :, None]
    inverse = LinearOperator(plate.stiffness.shape, matvec=solver(plate), dtype=np.float64)
    values, shapes = eigsh(plate.stiffness, k=12, M=plate.mass, sigma=0.0, OPinv=inverse)
    alike = np.abs(shapes.T @ (plate.mass @ pattern.ravel()[plate.free]))
    return float(np.sqrt(values[np.argmax(alike)]) / (2 * np.pi))


def exact_frequency_hz(plate: PlateParameters, m: int, n: int) -> float:
    """Lowest frequency of ``u = U(z) cos ax sin by, v = V(z) sin ax cos by, w = W(z) sin ax sin by``.

    Exact for hard simple support (Srinivas, Rao and Rao 1970, doi:10.1016/0022-460X(70)90089-1). U, V, W
    are polynomials of degree 9 here, for Legendre's converge faster than any power.
    """
    h = plate.thickness_m
    alpha, beta = m * np.pi / plate.width_m, n * np.pi / plate.height_m
    points, weights = np.polynomial.legendre.leggauss(12)
    value = np.polynomial.legendre.legvander(points, 9)
    slope = np.stack(
        [np.polynomial.legendre.legval(points, np.polynomial.legendre.legder(c)) for c in np.eye(10)], axis=1
    )
    stiffness, mass = np.zeros((30, 30)), np.zeros((30, 30))
    for p, dp, weight in zip(value, slope * 2.0 / h, weights * h / 2.0, strict=True):
        o = np.zeros(10)
        strain = np.array(
            [
                np.r_[-alpha * p, o, o],
                np.r_[o, -beta * p, o],
                np.r_[o, o, dp],
                np.r_[o, dp, beta * p],
                np.r_[dp, o, alpha * p],
                np.r_[beta * p, alpha * p, o],
            ]
        )
        law = elasticity_pa(plate.youngs_modulus_pa, plate.poisson_ratio)
        stiffness += weight * strain.T @ law @ strain
        mass += weight * plate.density_kg_per_m3 * np.kron(np.eye(3), np.outer(p, p))
    return float(np.sqrt(linalg.eigh(stiffness, mass, eigvals_only=True)[0]) / (2 * np.pi))


def surface_flexibility_m_per_pa(plate: PlateParameters, k):
    """Deflection of the loaded face per pressure that varies as ``sin ax sin by``, ``k^2 = a^2 + b^2``.

    Exact: half the load presses both faces against each other, half bends,

        (1 - nu^2) / (E k) [(cosh q - 1) / (sinh q + q) + (cosh q + 1) / (sinh q - q)],  q = k h,

    which is ``1 / (D k^4)`` for small q and a half-space's ``2 (1 - nu^2) / (E k)`` for large.
    """
    q = k * plate.thickness_m
    e = np.exp(-q)
    pressed = (1.0 - e) ** 2 / (1.0 - e**2 + 2.0 * q * e)
    bent = (1.0 + e) ** 2 / (1.0 - e**2 - 2.0 * q * e)
    return (pressed + bent) / (plane_modulus_pa(plate.youngs_modulus_pa, plate.poisson_ratio) * k)


def odd_waves(plate: PlateParameters, count: int):
    odd = np.arange(1, 2 * count, 2)
    m, n = np.meshgrid(odd, odd)
    return m, n, np.hypot(m * np.pi / plate.width_m, n * np.pi / plate.height_m)


def hertz_transform(q):
    """Normalised Fourier transform of Hertz's pressure, ``3 (sin q - q cos q) / q^3`` with q = k a."""
    return 3.0 * (np.sin(q) - q * np.cos(q)) / q**3


def exact_contact_compliance_m_per_n(plate: PlateParameters, radius_m: float, count: int) -> float:
    """Average deflection of the circle of contact under a unit force, with Hertz's weight both times."""
    _, _, k = odd_waves(plate, count)
    weight = 4.0 / (plate.width_m * plate.height_m) * hertz_transform(k * radius_m) ** 2
    return float(np.sum(weight * surface_flexibility_m_per_pa(plate, k)))


def assert_second_order(errors, elements):
    """Trilinear elements: h^2, seen once the mesh resolves the solution."""
    orders = -np.diff(np.log(np.abs(errors))) / np.diff(np.log(elements))
    assert np.all((orders > 1.6) & (orders < 2.3)), (errors, orders)


def test_references_agree_with_thin_plate_theory():
    bending = bending_stiffness_n_m(200e9, 0.3, PAPER.thickness_m)
    thin_hz = np.pi * np.sqrt(bending / (7800 * PAPER.thickness_m)) / PAPER.width_m**2
    # Shear and rotary inertia: of the order of (pi h / a)^2 = 1e-3.
    assert 0.999 * thin_hz < exact_frequency_hz(PAPER, 1, 1) < thin_hz
    k = 1.0
    assert surface_flexibility_m_per_pa(PAPER, k) * bending * k**4 == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize(("m", "n"), [(1, 1), (1, 3), (3, 1)])
def test_frequencies_converge_to_exact_elasticity_with_order_two(m, n):
    exact = exact_frequency_hz(THICK, m, n)
    errors = [
        flexural_frequency_hz(evenly_meshed(THICK, elements, layers), m, n) / exact - 1.0
        for elements, layers in EVEN_MESHES
    ]
    assert 0.0 < errors[-1] < 0.015  # sixteen elements along a half wave of the mode (3, 1)
    assert_second_order(errors, [elements for elements, _ in EVEN_MESHES])


def test_uniform_pressure_converges_to_exact_elasticity_with_order_two():
    m, n, k = odd_waves(THICK, 400)
    sign = (-1.0) ** ((m - 1) // 2 + (n - 1) // 2)
    exact = np.sum(16.0 / (np.pi**2 * m * n) * sign * surface_flexibility_m_per_pa(THICK, k))
    errors = [
        deflection_under_uniform_pressure(evenly_meshed(THICK, elements, layers)) / exact - 1.0
        for elements, layers in EVEN_MESHES
    ]
    assert abs(errors[-1]) < 2e-3
    # On the coarsest mesh errors of either sign still compete.
    assert_second_order(errors[1:], [elements for elements, _ in EVEN_MESHES[1:]])


@pytest.mark.parametrize("layers", [1, 3])
def test_coarse_bricks_do_not_lock_however_thin(layers):
    """Uniform pressure: Navier's series for the thin plate, ``w = 0.0040624 p a^4 / D``."""
    values = []
    for slenderness in (1e2, 3e2, 1e3):
        plate = PlateParameters(width_m=0.6, height_m=0.6, thickness_m=0.6 / slenderness)
        bending = bending_stiffness_n_m(200e9, 0.3, plate.thickness_m)
        values.append(deflection_under_uniform_pressure(evenly_meshed(plate, 8, layers)) * bending / 0.6**4)
    # Discretisation of 16 elements along an edge: per mille. Wilson's modes alone leave 0.0013 for the last,
    # of elements 37 times as wide as thick. (Thinner still, rounding takes over: (a/h)^4 of it.)
    np.testing.assert_allclose(values, 0.0040624, rtol=2e-3)


def test_contact_compliance_converges_to_exact_elasticity_with_order_two():
    """Hertz's pressure over a wide circle on a block hardly wider than thick."""
    block, radius = replace(THICK, width_m=0.02, height_m=0.02), 3e-3
    exact = exact_contact_compliance_m_per_n(block, radius, 400)
    errors = []
    for elements in (5, 10, 20):
        x, z = np.linspace(0.0, 0.01, elements + 1), np.linspace(0.0, 6e-3, 3 * elements // 5 + 1)
        plate = meshed(block, x, x, z, radius)
        errors.append(contact_compliance(plate) / exact - 1.0)
    assert -5e-3 < errors[-1] < 0.0  # six elements over the radius
    assert_second_order(errors, (5, 10, 20))


def test_half_space_indentation_is_the_series_limit():
    """``int (1 - nu^2) / (pi E) H(k a)^2 dk`` over all waves of a half-space, H Hertz's transform."""
    q, weight = np.polynomial.legendre.leggauss(500)
    integral = np.sum(100.0 * weight * hertz_transform(100.0 * (q + 1.0)) ** 2)
    expected = integral / (np.pi * plane_modulus_pa(200e9, 0.3) * 1e-3)
    # What lies beyond q = 200 is 9 / (6 q^3) = 2e-7 of 0.6 pi.
    assert half_space_indentation_m_per_n(200e9, 0.3, 1e-3) == pytest.approx(expected, rel=3e-7)


def test_what_is_left_after_the_indentation_hardly_depends_on_the_radius():
    """The rest grows with ``(a / h)^2``; without the subtraction the values would differ sixfold."""
    block, radii = replace(THICK, width_m=0.02, height_m=0.02), np.array([0.25e-3, 0.5e-3, 1e-3])
    net = [
        exact_contact_compliance_m_per_n(block, radius, 1200)
        - half_space_indentation_m_per_n(200e9, 0.3, radius)
        for radius in radii
    ]
    assert net[2] == pytest.approx(net[0], rel=0.015)
    steps = -np.diff(net)
    # Four times as large a step for twice the radius; the series leaves out waves beyond k a = 94.
    assert steps[1] / steps[0] == pytest.approx(4.0, rel=0.02)


@pytest.fixture(scope="module")
def papers_plate():
    meshes = ((40, 1.5), (64, 1.25), (90, 1.16))  # growth falls with the size of the elements
    return [
        build_solid_plate(PAPER, PATCH, replace(MESH, elements_per_edge=n, growth=growth))
        for n, growth in meshes
    ]


def test_papers_plate_converges_to_the_exact_compliance(papers_plate):
    exact = exact_contact_compliance_m_per_n(PAPER, MESH.contact_radius_m, 1000)
    thin = 0.0116008 * PAPER.width_m**2 / bending_stiffness_n_m(200e9, 0.3, PAPER.thickness_m)
    assert exact - half_space_indentation_m_per_n(200e9, 0.3, MESH.contact_radius_m) == pytest.approx(
        thin, rel=1e-3
    )
    errors = [contact_compliance(plate) / exact - 1.0 for plate in papers_plate]
    # 12,288 unknowns (the second, the usual mesh) leave two parts in ten thousand.
    assert errors[0] < errors[1] < errors[2] < 0.0
    assert abs(errors[1]) < 2.5e-4


def test_first_frequency_of_the_papers_plate(papers_plate):
    exact = exact_frequency_hz(PAPER, 1, 1)
    assert exact == pytest.approx(82.229, abs=1e-3)
    errors = [flexural_frequency_hz(plate, 1, 1) / exact - 1.0 for plate in papers_plate]
    assert 0.0 < errors[2] < errors[1] < errors[0]
    assert errors[1] < 1e-3
    # The element at the contact and the layers stay the same: order two in the number, but roughly.
    assert np.log(errors[0] / errors[2]) / np.log(90 / 40) == pytest.approx(2.0, abs=0.4)


@pytest.mark.parametrize("depth", [0.0, 0.8])
def test_usual_number_of_vectors_keeps_the_response_of_the_papers_plate(depth):
    """Laplace domain: growth rates 1/tau weigh the response over the last tau, as a shot does."""
    plate = build_solid_plate(PAPER, replace(PATCH, depth_fraction=depth))
    usual, more = solid_modes(plate), solid_modes(plate, 90)
    # A tenth of the waveform's allowance, more where the wave holds little.
    for frequency_hz, allowed in ((0.0, 1e-5), (2e3, 1e-5), (1e4, 1e-5), (2e4, 1e-3)):
        s = 1e4 + 2j * np.pi * frequency_hz
        response, exact = (
            np.sum(m.participation**2 / (m.omega_rad_per_s**2 + s**2)) + m.residual_compliance_m_per_n
            for m in (usual, more)
        )
        assert abs(response - exact) <= allowed * abs(exact)
