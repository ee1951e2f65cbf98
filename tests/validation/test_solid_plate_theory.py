"""The solid plate against exact three-dimensional elasticity of the simply supported plate."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from simulator.materials import bending_stiffness_n_m, shear_modulus_pa
from simulator.numerics.tensor_basis import Axis
from simulator.parameters.plate import CorrosionParameters, PlateParameters, SolidMesh
from simulator.plate.solid.contact import (
    exact_contact_compliance_m_per_n,
    half_space_indentation_m_per_n,
    surface_flexibility_m_per_pa,
    transform_hertz_pressure,
)
from simulator.plate.solid.plate import assemble_solid, build_solid_plate
from simulator.plate.solid.reduction import krylov_fields, make_shifted_solver, project_layers

THICK = PlateParameters(
    width_m=0.04,
    height_m=0.04,
    thickness_m=6e-3,
    contact_radius_m=1e-3,
    solid=SolidMesh(degree=6),  # of degree five through the thickness: next to exact
)
"""So thick that shear, rotary inertia and compression through the thickness count."""

PAPER = PlateParameters()


def evenly_meshed(parameters, elements, degree):
    """Pristine quarter; the patch over the whole plate has no edge within it."""
    x, y = (
        Axis(breaks_m=np.linspace(0.0, 0.5 * length, elements + 1), degrees=(degree,) * elements)
        for length in (parameters.width_m, parameters.height_m)
    )
    z = Axis(breaks_m=np.linspace(0.0, parameters.thickness_m, 4), degrees=(parameters.solid.degree - 1,) * 3)
    patch = CorrosionParameters(size_m=parameters.width_m)
    return assemble_solid(parameters, patch, x, y, z, "quarter")


def driven_frequency_hz(plate, expected_hz):
    """Frequency of the mode that the load drives nearest to the expected one."""
    found = project_layers(plate, krylov_fields(plate, 60)).modes(1.0, 0.0).omega_rad_per_s / (2.0 * np.pi)
    return float(found[np.argmin(np.abs(found - expected_hz))])


def exact_frequency_hz(plate, m, n):
    """Lowest frequency of ``u = U(z) cos ax sin by, v = V(z) sin ax cos by, w = W(z) sin ax sin by``.

    Exact for hard simple support (Srinivas, Rao and Rao 1970, doi:10.1016/0022-460X(70)90089-1). U, V, W
    are polynomials of degree 9 here, for Legendre's converge faster than any power.
    """
    h, nu = plate.thickness_m, plate.poisson_ratio
    alpha, beta = m * np.pi / plate.width_m, n * np.pi / plate.height_m
    points, weights = np.polynomial.legendre.leggauss(12)
    value = np.polynomial.legendre.legvander(points, 9)
    slope = np.stack(
        [np.polynomial.legendre.legval(points, np.polynomial.legendre.legder(c)) for c in np.eye(10)], axis=1
    )
    shear = shear_modulus_pa(plate.youngs_modulus_pa, nu)
    law = shear * np.diag([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    law[:3, :3] += 2.0 * shear * nu / (1.0 - 2.0 * nu)
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
        stiffness += weight * strain.T @ law @ strain
        mass += weight * plate.density_kg_per_m3 * np.kron(np.eye(3), np.outer(p, p))
    return float(np.sqrt(linalg.eigh(stiffness, mass, eigvals_only=True)[0]) / (2 * np.pi))


def series_contact_compliance(plate, count):
    """Average deflection of the circle of contact under a unit force: the plain series of sines."""
    odd = np.arange(1, 2 * count, 2)
    m, n = np.meshgrid(odd, odd)
    k = np.hypot(m * np.pi / plate.width_m, n * np.pi / plate.height_m)
    weight = (
        4.0 / (plate.width_m * plate.height_m) * transform_hertz_pressure(k * plate.contact_radius_m) ** 2
    )
    return float(np.sum(weight * surface_flexibility_m_per_pa(plate, plate.thickness_m, k)))


def test_references_agree_with_thin_plate_theory():
    bending = bending_stiffness_n_m(200e9, 0.3, PAPER.thickness_m)
    thin_hz = np.pi * np.sqrt(bending / (7800 * PAPER.thickness_m)) / PAPER.width_m**2
    # Shear and rotary inertia: of the order of (pi h / a)^2 = 1e-3.
    assert 0.999 * thin_hz < exact_frequency_hz(PAPER, 1, 1) < thin_hz
    flexibility = surface_flexibility_m_per_pa(PAPER, PAPER.thickness_m, np.ones(1))[0]
    assert flexibility * bending == pytest.approx(1.0, rel=1e-4)
    thin = 0.0116008 * PAPER.width_m**2 / bending
    net = exact_contact_compliance_m_per_n(PAPER, PAPER.width_m, PAPER.height_m, PAPER.thickness_m)
    net -= half_space_indentation_m_per_n(200e9, 0.3, PAPER.contact_radius_m)
    assert net == pytest.approx(thin, rel=1.5e-3)


def test_quick_compliance_is_that_of_the_plain_series():
    block = replace(THICK, width_m=0.02, height_m=0.03)
    quick = exact_contact_compliance_m_per_n(block, 0.02, 0.03, 6e-3)
    # The plain series ends at k a = 94 and more: what is beyond is 1e-6.
    assert quick == pytest.approx(series_contact_compliance(block, 400), rel=3e-6)


@pytest.mark.parametrize(
    ("degree", "m", "n"),
    [
        (2, 3, 1),
        (3, 1, 1),
        pytest.param(2, 1, 1, marks=pytest.mark.slow),
        pytest.param(3, 3, 1, marks=pytest.mark.slow),
    ],
)
def test_frequencies_converge_to_exact_elasticity_with_twice_the_degree(m, n, degree):
    exact = exact_frequency_hz(THICK, m, n)
    elements = np.array([2, 3, 4]) * (2 if 2 in (degree, m - 1) else 1)
    errors = np.array(
        [driven_frequency_hz(evenly_meshed(THICK, int(k), degree), exact) / exact - 1.0 for k in elements]
    )
    assert np.all(errors > 0.0)
    orders = -np.diff(np.log(errors)) / np.diff(np.log(elements))
    # Coarse meshes start a little off; quadratic elements still lock a bit on them.
    assert np.all(np.abs(orders - 2.0 * degree) < 0.8), (errors, orders)


def test_elements_do_not_lock_however_thin():
    """A thousand times as wide as thick, three elements along half the plate: 170 times as wide as thick."""
    thin = replace(PAPER, thickness_m=6e-4)
    exact = exact_contact_compliance_m_per_n(thin, 0.6096, 0.6096, 6e-4)
    for degree in (3, 4):
        plate = evenly_meshed(thin, 3, degree)
        found = plate.load @ make_shifted_solver(plate, 0.0)(plate.load)
        # The point load's logarithmic curvature is not resolved; locked elements leave a tenth and less.
        assert found == pytest.approx(exact, rel=5e-3)


def test_contact_compliance_converges_to_exact_elasticity():
    """Hertz's pressure over a wide circle on a block hardly wider than thick."""
    block = replace(THICK, width_m=0.02, height_m=0.02, contact_radius_m=3e-3)
    exact = series_contact_compliance(block, 400)
    errors = []
    for elements in (2, 4, 8):
        plate = evenly_meshed(block, elements, 3)
        errors.append(plate.load @ make_shifted_solver(plate, 0.0)(plate.load) / exact - 1.0)
    # The square root at the circle's rim and three layers of cubics limit the speed.
    assert errors[0] < errors[1] < errors[2] < 0.0
    assert abs(errors[2]) < 3e-3


def test_half_space_indentation_is_the_series_limit():
    """``int (1 - nu^2) / (pi E) H(k a)^2 dk`` over all waves of a half-space, H Hertz's transform."""
    q, weight = np.polynomial.legendre.leggauss(500)
    integral = np.sum(100.0 * weight * transform_hertz_pressure(100.0 * (q + 1.0)) ** 2)
    expected = integral * 0.91 / (np.pi * 200e9 * 1e-3)
    # What lies beyond q = 200 is 9 / (6 q^3) = 2e-7 of 0.6 pi.
    assert half_space_indentation_m_per_n(200e9, 0.3, 1e-3) == pytest.approx(expected, rel=3e-7)


def test_the_remainder_after_the_indentation_hardly_depends_on_the_radius():
    """The rest grows with ``(a / h)^2``; without the subtraction the values would differ sixfold."""
    net = [
        exact_contact_compliance_m_per_n(replace(THICK, contact_radius_m=radius), 0.02, 0.02, 6e-3)
        - half_space_indentation_m_per_n(200e9, 0.3, radius)
        for radius in (0.25e-3, 0.5e-3, 1e-3)
    ]
    assert net[2] == pytest.approx(net[0], rel=0.015)
    steps = -np.diff(net)
    assert steps[1] / steps[0] == pytest.approx(4.0, rel=0.02)  # four times as large for twice the radius


def test_first_frequency_of_the_papers_plate():
    exact = exact_frequency_hz(PAPER, 1, 1)
    assert exact == pytest.approx(82.229, abs=1e-3)
    plate = build_solid_plate(PAPER, CorrosionParameters())
    assert driven_frequency_hz(plate, exact) == pytest.approx(exact, rel=1e-6)
